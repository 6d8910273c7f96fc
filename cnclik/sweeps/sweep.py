"""sweep: one study over a labelled grid, as an xarray.Dataset.

The grid is cut into blocks of one fixed shape. Each combination of the outer axes (methods, robots, whatever
is compiled in) is one program, traced once; it runs every block of the inner, numeric axes. A block is
computed alone, so its numbers don't depend on which blocks ran before it, here or in another process.
"""

import collections
import dataclasses
import itertools
import json
import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np

from cnclik import errors
from cnclik.hints import cores
from cnclik.integrate.lanes import lanes, options
from cnclik.measure.metrics import Metrics

UNITS = {
    **{"alpha": "1/s", "Ts": "s", "t": "s", "horizon": "s", "duration": "s", "period": "s"},
    **{"z": "1", "M": "1", "N": "1", "step": "1", "seed": "1", "method": "1", "stage": "1", "robot": "1"},
}
LANES = 16384  # in one block: enough to keep the processor busy, few enough to stay near its cache
MEMORY = 2**30  # bytes that one block may need while it runs


# --- axes ---------------------------------------------------------------------------------------------


class Axis(NamedTuple):
    """One dimension of the grid."""

    name: str
    values: object  # inner: an array, the first dimension runs along the axis; outer: a tuple of objects
    labels: tuple | None  # of an outer axis; None marks an inner one

    def __len__(self):
        return len(self.values)

    @property
    def inner(self) -> bool:
        return self.labels is None


def axis(name: str, values) -> Axis:
    """Read one axis. By the rule of records: arrays and floats run inside a program, Python ints, names and
    objects are compiled in, one program each."""
    if isinstance(values, Axis):
        return values
    if isinstance(values, Mapping):
        return _filled(Axis(name, tuple(values.values()), tuple(values)))
    if isinstance(values, (np.ndarray, jax.Array)) and values.ndim and values.dtype.kind in "fiub":
        return _filled(Axis(name, np.asarray(values), None))
    if not isinstance(values, (list, tuple, range, np.ndarray)):
        raise errors.fail(name, "be an axis: an array, a list, or a dict of labelled values", f"is {values!r}")
    values = tuple(values)
    numbers = [isinstance(v, (float, int, np.number)) and not isinstance(v, bool) for v in values]
    if all(numbers) and any(isinstance(v, (float, np.floating)) for v in values):
        return _filled(Axis(name, np.asarray(values, float), None))
    if values and all(isinstance(v, (list, tuple, np.ndarray, jax.Array)) for v in values):
        shapes = {np.shape(v) for v in values}
        if len(shapes) != 1:
            raise errors.fail(name, "hold values of one shape", f"holds shapes {sorted(shapes)}")
        return _filled(Axis(name, np.asarray(values, float), None))
    labels = tuple(v if isinstance(v, (int, str, bool)) else getattr(v, "name", None) for v in values)
    if any(v is None for v in labels):
        raise errors.fail(name, "hold numbers, names or named objects, or be a dict {label: value}", f"is {values!r}")
    return _filled(Axis(name, values, labels))


def _filled(found: Axis) -> Axis:
    if not len(found):
        raise errors.fail(found.name, "hold at least one value", "is empty")
    if found.inner and not np.all(np.isfinite(found.values)):
        raise errors.fail(found.name, "hold finite values", "does not")
    return found


# --- the grid and its blocks --------------------------------------------------------------------------


class Block(NamedTuple):
    """A piece of the grid that is computed at once."""

    number: int
    program: int  # which combination of the outer axes
    region: tuple  # a slice per axis of the grid


@dataclasses.dataclass(frozen=True)
class Grid:
    """The axes, in the order given, and how they are cut: `block` lanes along each inner axis."""

    axes: tuple
    lanes: int

    @property
    def shape(self) -> tuple:
        return tuple(len(a) for a in self.axes)

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
        """Extent of a block along each axis: whole trailing axes, a cut of one, single values before it."""
        left, extents = self.lanes, []
        for one in reversed(self.axes):
            if not one.inner:
                extents.append(1)
                continue
            # The cut is as even as it can be, so that the last block is padded little.
            pieces = -(-len(one) // max(left, 1))
            extents.append(-(-len(one) // pieces))
            left = left // extents[-1] if pieces == 1 else 0
        return tuple(reversed(extents))

    @property
    def programs(self) -> list:
        """The combinations of the outer axes, as {name: value}."""
        names = [a.name for a in self.outer]
        return [dict(zip(names, values, strict=True)) for values in itertools.product(*(a.values for a in self.outer))]

    def blocks(self) -> list:
        """All blocks, program by program."""
        counts = [range(-(-n // b)) for n, b in zip(self.shape, self.block, strict=True)]
        outer = [i for i, a in enumerate(self.axes) if not a.inner]
        inner = [i for i, a in enumerate(self.axes) if a.inner]
        out = []
        for program, fixed in enumerate(itertools.product(*(counts[i] for i in outer))):
            for moving in itertools.product(*(counts[i] for i in inner)):
                place = dict(zip(outer + inner, fixed + moving, strict=True))
                region = tuple(
                    slice(place[i] * b, min((place[i] + 1) * b, n))
                    for i, (b, n) in enumerate(zip(self.block, self.shape, strict=True))
                )
                out.append(Block(len(out), program, region))
        return out

    def lane_values(self, block: Block) -> dict:
        """Values of the inner axes in every lane of a block; lanes beyond the grid repeat its last value."""
        steps = [
            np.minimum(np.arange(cut.start, cut.start + extent), len(a) - 1)
            for a, cut, extent in zip(self.axes, block.region, self.block, strict=True)
            if a.inner
        ]
        places = np.meshgrid(*steps, indexing="ij") if steps else []
        return {a.name: a.values[p.ravel()] for a, p in zip(self.inner, places, strict=True)}

    def cut(self, block: Block, lanes):
        """The result of all lanes of a block as its piece of the grid."""
        full = lanes.reshape(*self.block, *lanes.shape[1:])
        return full[tuple(slice(0, cut.stop - cut.start) for cut in block.region)]


def grid(axes: Mapping, lanes=None) -> Grid:
    """The grid of some named axes."""
    if not axes:
        raise errors.fail("axes", "name at least one axis, such as alpha=jnp.linspace(1, 40, 200)", "is empty")
    lanes = LANES if lanes is None else errors.integer("lanes", lanes, at_least=1)
    return Grid(tuple(axis(name, values) for name, values in axes.items()), lanes)


# --- programs -----------------------------------------------------------------------------------------


class Output(NamedTuple):
    """One variable that a study returns, for one lane."""

    name: str
    shape: tuple
    dtype: np.dtype
    dims: tuple
    unit: str


class Program(NamedTuple):
    """A study compiled for one combination of the outer axes and one block shape."""

    run: Callable  # {name: values per lane} -> {name: results per lane}
    outputs: tuple
    memory: int  # bytes it needs while it runs


def _named(result) -> dict:
    """What a study may return, as {name: array}."""
    if isinstance(result, (Metrics, Mapping)):
        return dict(result.items())
    if dataclasses.is_dataclass(result):
        return {f.name: getattr(result, f.name) for f in dataclasses.fields(result)}
    return {"value": result}


# Dimensions of what `solve` returns, for a study that returns whole trajectories.
_DIMS = {
    "t": ("time",),
    "q": ("time", "joint"),
    "x": ("time", "axis"),
    "e": ("time", "axis"),
    "qdot": ("step", "joint"),
} | {name: ("step",) for name in ("residual", "contraction", "status")}


def compile_program(study, fixed: dict, of: Grid) -> Program:
    """Trace and compile the study once, for blocks of the grid."""
    found = {}

    def lane(values):
        result = study(**fixed, **values)
        named = {name: jax.numpy.asarray(v) for name, v in _named(result).items()}
        units, dims = getattr(result, "units", {}), getattr(result, "dims", {})
        found["outputs"] = tuple(
            Output(
                name,
                v.shape,
                np.dtype(v.dtype),
                _dims(name, v.shape, dims.get(name) or _DIMS.get(name, ())),
                units.get(name, UNITS.get(name, "")),
            )
            for name, v in named.items()
        )
        return named

    count = math.prod(of.block)
    example = {a.name: _typed(np.zeros((count, *a.values.shape[1:]), a.values.dtype)) for a in of.inner}
    shapes = jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype), example)
    if not example:  # all axes are outer: one lane
        batched = lambda values: jax.tree.map(lambda v: v[None], lane(values))  # noqa: E731
        compiled = jax.jit(batched).lower(shapes).compile()
    else:
        traced = jax.jit(lanes(lane)).trace(shapes)
        compiled = traced.lower().compile(options(traced))
    analysis = compiled.memory_analysis()
    memory = getattr(analysis, "temp_size_in_bytes", 0) + getattr(analysis, "output_size_in_bytes", 0)

    def run(values):
        return compiled({name: _typed(v) for name, v in values.items()})

    return Program(run, found["outputs"], memory)


def _typed(values):
    return jax.numpy.asarray(values)


def _dims(name, shape, dims):
    return tuple(dims) if len(dims) == len(shape) else tuple(f"{name}_{i}" for i in range(len(shape)))


def fit(study, of: Grid, memory=MEMORY):
    """The grid with blocks cut so that one needs no more than `memory`, and its first program."""
    program = compile_program(study, of.programs[0], of)
    while program.memory > memory and math.prod(of.block) > 1:
        of = dataclasses.replace(of, lanes=max(1, int(of.lanes * memory / program.memory)))
        program = compile_program(study, of.programs[0], of)
    return of, program


def run_blocks(study, of: Grid, blocks, first: Program | None = None, workers=None):
    """Compute blocks: yields (block, {name: piece of the grid}) in their order.

    Each core runs a block of its own, and the next ones are running while one is handed out, so that writing
    takes no time of its own.
    """
    workers = workers or available_cores()
    waiting = collections.deque()
    for number, group in itertools.groupby(blocks, key=lambda b: b.program):
        program = first if first is not None and number == 0 else compile_program(study, of.programs[number], of)
        if first is not None and _layout(program.outputs) != _layout(first.outputs):
            raise errors.fail("study", "return the same names and shapes everywhere", f"not at {of.programs[number]}")
        with ThreadPoolExecutor(workers) as pool:
            for block in group:
                waiting.append((block, pool.submit(_compute, program, of, block)))
                if len(waiting) > workers + 1:
                    yield _done(waiting.popleft())
            while waiting:
                yield _done(waiting.popleft())


def _compute(program, of, block):
    results = program.run(of.lane_values(block))
    return {name: of.cut(block, np.asarray(v)) for name, v in results.items()}


def _done(pair):
    block, future = pair
    return block, future.result()


def available_cores() -> int:
    """Cores this process may use; one on an accelerator, which is busy with a single block."""
    return cores() if jax.default_backend() == "cpu" else 1


def _layout(outputs):
    return [(o.name, o.shape, o.dtype) for o in outputs]


# --- public -------------------------------------------------------------------------------------------


def sweep(study, *, units=None, attrs=None, lanes=None, progress=None, **axes):
    """Run a study over the grid of some axes.

    Args:
      study: a pure function of the named values, returning a record, a dict or `Metrics` of scalars (or of
        arrays: further dimensions), such as a function that calls `solve` and `measure`.
      axes: name=values, in the order of the dimensions wanted. Arrays and lists of floats run inside one
        compiled program, an array of shape (S, ...) as S values of shape (...); Python ints, strings, objects
        with a name (methods) and dicts {label: value} are compiled in, one program each.
      units: {name: unit} of axes and results that don't bring their own.
      attrs: further attributes of the dataset.
      lanes: most points in one block; by default as many as fit.
      progress: called with (points done, points in all).

    Returns: `xarray.Dataset` with the axes as dimensions, `units` on every variable, the configuration in attrs.
    Raises: ArgumentError for an axis that can't be read.
    """
    if not callable(study):
        raise errors.fail("study", "be a function of named values", f"is {study!r}")
    of, first = fit(study, grid(axes, lanes))
    arrays = {o.name: np.empty((*of.shape, *o.shape), o.dtype) for o in first.outputs}
    done = 0
    for block, piece in run_blocks(study, of, of.blocks(), first):
        for name, values in piece.items():
            arrays[name][block.region] = values
        done += math.prod(cut.stop - cut.start for cut in block.region)
        if progress is not None:
            progress(done, of.size)
    return dataset(of, first.outputs, arrays, units=units, attrs={"config": _described(study, of)} | (attrs or {}))


def dataset(of: Grid, outputs, arrays, *, units=None, attrs=None, labels=None):
    """Arrays over the grid as a labelled `xarray.Dataset`.

    Args:
      labels: {name: long name} of variables.
    """
    import xarray

    units, labels = {**UNITS, **(units or {})}, labels or {}
    names = tuple(a.name for a in of.axes)
    coords = {}
    for one in of.axes:
        coords |= coordinates(one, units)
    data = {}
    for o in outputs:
        about = {
            "units": (units or {}).get(o.name, o.unit),
            **({"long_name": labels[o.name]} if o.name in labels else {}),
        }
        data[o.name] = (names + o.dims, arrays[o.name], about)
    return xarray.Dataset(data, coords, attrs=environment() | {"lanes": of.lanes} | (attrs or {}))


def coordinates(one: Axis, units) -> dict:
    """Coordinates of an axis: its values; for an axis of vectors its numbers, and the values beside them."""
    about = {"units": units.get(one.name, "")}
    if not one.inner:
        return {one.name: (one.name, np.asarray(one.labels), about | {"units": units.get(one.name, "1")})}
    if one.values.ndim == 1:
        return {one.name: (one.name, one.values, about)}
    parts = tuple(f"{one.name}_{i}" for i in range(one.values.ndim - 1))
    value = f"{one.name}_value"
    return {
        one.name: (one.name, np.arange(len(one)), {"units": "1"}),
        value: ((one.name, *parts), one.values, {"units": units.get(one.name, "")}),
    }


def environment() -> dict:
    """What the numbers depend on beside the configuration: versions, dtype, device."""
    from cnclik.measure.dataset import provenance

    found = provenance(np.float64 if jax.config.jax_enable_x64 else np.float32)
    return {name: value for name, value in found.items() if name != "commit"}


def _described(study, of: Grid) -> str:
    name = getattr(study, "__qualname__", type(study).__name__)
    axes = {a.name: a.values.tolist() if a.inner else [str(v) for v in a.labels] for a in of.axes}
    return json.dumps({"study": name, "axes": axes})
