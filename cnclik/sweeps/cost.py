"""Cost: an estimate of a spec's run, from its first program and one measured block."""

import dataclasses
import math
import time

import jax
import numpy as np

from cnclik.sweeps.program import blocks_at_once, fit
from cnclik.sweeps.spec import Spec, read

_REST = 2**28  # bytes of the interpreter, JAX and the store


@dataclasses.dataclass(frozen=True, kw_only=True)
class Estimate:
    """What a sweep will take."""

    loops: int  # points of the grid
    axes: dict  # number of points along each axis
    programs: int  # number of compiled programs
    blocks: int  # number of blocks
    block: int  # loops of each block
    cores: int  # blocks that run side by side
    memory: int  # while it runs [bytes]
    block_memory: int  # part of it for blocks [bytes]
    disk: int  # of the store, before compression [bytes]
    compile_time: float  # of one program [s]
    run_time: float  # all blocks, without compilation [s]

    @property
    def time(self) -> float:
        """All of it [s]."""
        return self.compile_time * self.programs + self.run_time


def estimate(spec, *, set=()) -> Estimate:
    """Size, memory and time of a sweep: its first program is compiled, and one block of it is run twice.

    Args:
      spec: a `Spec`, or the path of its TOML file.
      set: strings "name=value" that replace values of the file.
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
    # The cost of other programs is proportional to their evaluations of f.
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
