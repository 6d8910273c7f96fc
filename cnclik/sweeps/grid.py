"""Grid: the axes of a sweep, cut into blocks of one fixed shape.

Each combination of the outer axes (methods, robots, all that is compiled in) is one program, traced once. It runs every
block of the inner, numeric axes. Each block is computed alone, so its numbers do not depend on other blocks or
processes. Everything here traces and runs in float64, whatever JAX's setting is. This includes the threads of the pool,
as a thread does not inherit the context of the one that started it.
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
from cnclik.record import fields_of
from cnclik.threads import cores, shares_threads, side_by_side

SYMBOLS = {"alpha": "α", "z": "z = α·Ts", "damping": "λ", "M": "passes M"}
UNITS = {"alpha": "1/s"} | dict.fromkeys(("Ts", "t", "horizon", "duration", "period"), "s")  # of axes and results
UNITS |= dict.fromkeys(("z", "M", "N", "step", "seed", "method", "stage", "robot"), "1")
MOST = {"points": 10**9, "programs, one for each combination of what is compiled in": 1000}


class Block(NamedTuple):
    """A piece of the grid that is computed at once."""

    program: int  # index of the combination of the outer axes
    region: tuple  # a slice per axis of the grid

    @property
    def size(self) -> int:
        return math.prod(cut.stop - cut.start for cut in self.region)


@dataclasses.dataclass(frozen=True)
class Grid:
    """The axes, in the given order, cut into blocks of at most `lanes` points.

    `more` gives a study further values of each lane, {name: array}, from the program's values of the outer axes and
    those of the lanes.
    """

    axes: tuple  # of `Axis`
    lanes: int = MOST["points"]
    more: Callable = dataclasses.field(default=lambda program, lanes: {}, compare=False, repr=False)

    def __post_init__(self):
        if not self.axes:
            raise errors.fail("axes", "hold at least one axis, such as alpha = [1, 5, 10]", "holds none")
        for count, (what, most) in zip((self.size, math.prod(map(len, self.outer))), MOST.items(), strict=True):
            if count > most:
                axes = " × ".join(f"{len(a):,} of {a.name}" for a in self.axes)
                raise errors.fail("axes", f"span at most {most:,} {what}", f"span {count:,}: {axes}")

    @property
    def shape(self) -> tuple:
        return tuple(map(len, self.axes))

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def inner(self) -> tuple:
        return tuple(a for a in self.axes if a.inner)

    @property
    def outer(self) -> tuple:
        return tuple(a for a in self.axes if not a.inner)

    @property
    def block(self) -> tuple:
        """Extent of a block along each axis: all of the last axes, a cut of the one before, single values of others."""
        left, extents = self.lanes, []
        for a in reversed(self.axes):
            # Even cuts, so that the last block needs little padding.
            pieces = -(-len(a) // max(left, 1)) if a.inner else len(a)
            extents.append(-(-len(a) // pieces))
            if a.inner:
                left = left // extents[-1] if pieces == 1 else 0
        return tuple(reversed(extents))

    @property
    def programs(self) -> list:
        """The combinations of the outer axes, as {name: value}."""
        names = [a.name for a in self.outer]
        return [dict(zip(names, values, strict=True)) for values in itertools.product(*(a.values for a in self.outer))]

    def blocks(self) -> list:
        """Return all blocks, program by program."""
        cuts = [
            [slice(first, min(first + step, n)) for first in range(0, n, step)]
            for n, step in zip(self.shape, self.block, strict=True)
        ]
        outer = [i for i, a in enumerate(self.axes) if not a.inner]
        places = itertools.product(*(range(self.shape[i]) for i in outer))
        number = {place: k for k, place in enumerate(places)}  # of the program at a place on the outer axes
        blocks = [Block(number[tuple(region[i].start for i in outer)], region) for region in itertools.product(*cuts)]
        return sorted(blocks, key=lambda block: block.program)

    def lane_values(self, block: Block) -> dict:
        """Return the values of the inner axes, and `more`, in each lane; lanes beyond the grid repeat the last one."""
        steps = [
            np.minimum(np.arange(cut.start, cut.start + extent), len(a) - 1)
            for a, cut, extent in zip(self.axes, block.region, self.block, strict=True)
            if a.inner
        ]
        places = np.meshgrid(*steps, indexing="ij") if steps else []
        lanes = {a.name: a.values[p.ravel()] for a, p in zip(self.inner, places, strict=True)}
        return lanes | self.more(self.programs[block.program], lanes)

    def cut(self, block: Block, lanes):
        """Return the results of all lanes of a block as its piece of the grid."""
        full = lanes.reshape(*self.block, *lanes.shape[1:])
        return full[tuple(slice(0, cut.stop - cut.start) for cut in block.region)]

    def coordinates(self, units) -> dict:
        """Return the coordinates of all axes, {name: (dimensions, values, attributes)}: for an axis of vectors their
        numbers, with the values beside them."""
        coords = {}
        for name, values, labels in self.axes:
            about = {"units": units.get(name, ""), "long_name": SYMBOLS.get(name, name.replace("_", " "))}
            if labels is not None:
                values = np.asarray(labels)
                if values.dtype.kind == "U":  # such as "8ms", which have their own unit
                    about["units"] = "1"
            elif values.ndim > 1:
                parts = (f"{name}_{i}" for i in range(values.ndim - 1))
                coords[f"{name}_value"] = ((name, *parts), values, about)
                values, about = np.arange(len(values)), about | {"units": "1"}
            coords[name] = (name, values, about)
        return coords

    def __str__(self):
        return " × ".join(f"{a.name} {len(a)}" for a in self.axes)


# --- programs and blocks ------------------------------------------------------------------------------

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
            result = fields_of(result)
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
        for o, its in zip(first.outputs if first is not None else (), program.outputs, strict=False):
            units = [unit for one in (o, its) for unit in one.about["units"].split(" or ")]
            o.about["units"] = " or ".join(dict.fromkeys(units))  # where programs differ in them, all of these
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
