"""Program: a study compiled for one combination of the outer axes, and its blocks run side by side.

Everything here traces and runs in float64, whatever JAX's setting is. This includes the threads of the pool, as a
thread does not inherit the context of the one that started it.
"""

import collections
import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import give_back
from cnclik.engine.plan import as_here
from cnclik.integrate.lanes import lanes
from cnclik.measure.metrics import METRICS, Metrics
from cnclik.sweeps.grid import UNITS, Grid
from cnclik.threads import cores, shares_threads, side_by_side

MEMORY = 2**30  # bytes, at most, of one block while it runs


class Output(NamedTuple):
    """One variable of a study's result, for one lane."""

    name: str
    shape: tuple
    dtype: np.dtype
    about: dict  # attributes: units, and long_name if there is one

    @property
    def dims(self) -> tuple:
        return tuple(f"{self.name}_{i}" for i in range(len(self.shape)))


class StudyProgram(NamedTuple):
    """A study compiled for one combination of the outer axes and one block shape."""

    run: Callable  # {name: values per lane} -> {name: results per lane}
    outputs: tuple
    memory: int  # bytes it needs while it runs
    alone: bool  # whether its blocks must run one after the other, see `shares_threads`


def compile_program(study, of: Grid, number=0) -> StudyProgram:
    """Trace and compile the study once, for blocks of one of the grid's programs."""
    outputs: tuple = ()
    fixed = of.programs[number]

    def lane(values):
        nonlocal outputs
        result = study(**fixed, **values)
        if dataclasses.is_dataclass(result):
            result = vars(result)
        named = result if isinstance(result, Mapping) else {"value": result}
        named = {name: jnp.asarray(v) for name, v in named.items()}
        about = {name: {"units": UNITS.get(name, "")} for name in named}
        if isinstance(result, Metrics):
            about = {name: {"units": unit, "long_name": METRICS[name].label} for name, unit in result.units.items()}
        outputs = tuple(Output(name, v.shape, np.dtype(v.dtype), about[name]) for name, v in named.items())
        taken = {*named, *(dim for o in outputs for dim in o.dims)}
        if both := [a.name for a in of.axes if a.name in taken]:
            raise errors.fail("axes", "have names of their own", f"{both[0]!r} is in the results too")
        return named

    def alone(values):  # one lane, as all axes are outer
        return jax.tree.map(lambda v: v[None], lane(values))

    with jax.enable_x64(True):
        first = {a.name: a.values[:1] for a in of.inner}
        first |= of.more(fixed, first)
        shapes = {k: jax.ShapeDtypeStruct((math.prod(of.block), *v.shape[1:]), v.dtype) for k, v in first.items()}
        traced = jax.jit(lanes(lane) if shapes else alone).trace(shapes)
        compiled = traced.lower().compile()
    give_back()  # compiling uses some hundred megabytes
    analysis = compiled.memory_analysis()
    memory = getattr(analysis, "temp_size_in_bytes", 0) + getattr(analysis, "output_size_in_bytes", 0)

    def run(values):
        with jax.enable_x64(True):
            return compiled({name: jnp.asarray(v) for name, v in values.items()})

    return StudyProgram(run, outputs, memory, shares_threads(traced.jaxpr))


def fit(study, of: Grid, memory=MEMORY):
    """Return the grid cut so that a block needs at most `memory` bytes, and its first program."""
    program = compile_program(study, of)
    while program.memory > memory and math.prod(of.block) > 1:
        of = dataclasses.replace(of, lanes=max(1, int(math.prod(of.block) * memory / program.memory)))
        program = compile_program(study, of)
    return of, program


def run_blocks(study, of: Grid, blocks, first: StudyProgram | None = None):
    """Compute blocks: yield (block, {name: piece of the grid}) in their order.

    Each core runs its own block. The next ones already run while the caller handles one, so writing takes no extra
    time; and the next programs compile.
    """

    def compiled(number):
        return first if first is not None and number == 0 else compile_program(study, of, number)

    def computed(block):
        results = program.run(of.lane_values(block))
        return block, {name: of.cut(block, np.asarray(v)) for name, v in results.items()}

    groups = [(number, list(group)) for number, group in itertools.groupby(blocks, key=lambda b: b.program)]
    programs = _ahead(as_here(compiled), [number for number, _ in groups], cores())
    for (number, group), program in zip(groups, programs, strict=True):
        if first is not None and [o[:3] for o in program.outputs] != [o[:3] for o in first.outputs]:
            raise errors.fail("study", "return the same names and shapes everywhere", f"not at {of.programs[number]}")
        # An accelerator is kept busy by one block.
        yield from _ahead(computed, group, cores() if jax.default_backend() == "cpu" and not program.alone else 1)


def _ahead(fn, items, count):
    """Yield fn(item) of items in order, `count` of them side by side, and the next ones while one is in use."""
    waiting = collections.deque()
    with side_by_side(count) as pool:
        for item in items:
            waiting.append(pool.submit(fn, item))
            if len(waiting) > count + 1:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
