"""Cost: what a spec will take to run, from its first program and one measured block."""

import dataclasses
import math
import time

import jax
import numpy as np

from cnclik.sweeps.program import blocks_at_once, fit
from cnclik.sweeps.spec import Spec, read

_REST = 2**28  # bytes that the interpreter, JAX and the store take


@dataclasses.dataclass(frozen=True, kw_only=True)
class Estimate:
    """What a sweep will take.

    Attributes:
      loops: points of the grid; `axes` their number along each axis.
      programs: how many are compiled, `compile_time` each [s].
      blocks: pieces in which the grid is computed, of `block` loops each.
      cores: blocks that run side by side.
      memory: while it runs [bytes]; `block_memory` of them for blocks.
      disk: of the store, before compression [bytes].
      run_time: all blocks, compilation not counted [s].
      time: all of it [s].
    """

    loops: int
    axes: dict
    programs: int
    blocks: int
    block: int
    cores: int
    memory: int
    block_memory: int
    disk: int
    compile_time: float
    run_time: float

    @property
    def time(self) -> float:
        return self.compile_time * self.programs + self.run_time


def estimate(spec, *, set=()) -> Estimate:
    """Size, memory and time of a sweep: its first program is compiled, and one block of it run twice.

    Args:
      spec: a `Spec`, or the path of its TOML file.
      set: strings "name=value" that override what the file says.
    """
    spec = spec if isinstance(spec, Spec) else read(spec, set)
    begun = time.perf_counter()
    of, program = fit(spec.study, spec.grid())
    compile_time = time.perf_counter() - begun
    blocks = of.blocks()
    values = of.lane_values(blocks[0])
    jax.block_until_ready(program.run(values))
    begun = time.perf_counter()
    jax.block_until_ready(program.run(values))
    block_time = time.perf_counter() - begun
    # Other programs cost as many times more as they take more evaluations of f.
    costs = np.array([spec.evaluations(p) for p in of.programs])
    cores = blocks_at_once()
    block_memory = program.memory * cores
    return Estimate(
        loops=of.size,
        axes={a.name: len(a) for a in of.axes},
        programs=len(costs),
        blocks=len(blocks),
        block=math.prod(of.block),
        cores=cores,
        memory=block_memory + _REST,
        block_memory=block_memory,
        disk=of.size * sum(o.dtype.itemsize * math.prod(o.shape) for o in program.outputs),
        compile_time=compile_time,
        run_time=block_time * len(blocks) * float(np.mean(costs / costs[0])) / cores,
    )
