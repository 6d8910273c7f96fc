"""Grid: the axes of a sweep, cut into blocks of one fixed shape.

Each combination of the outer axes (methods, robots, all that is compiled in) is one program, traced once. It runs every
block of the inner, numeric axes. Each block is computed alone, so its numbers do not depend on other blocks or
processes.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from cnclik import errors

MOST = {"points": 10**10, "programs, one for each combination of what is compiled in": 1000, "blocks": 10**6}
LANES = 16384  # lanes in a block: enough to keep the processor busy, few enough for its cache
COMPILED_IN = ("N", "delay", "measurement_delay")  # numbers that change a program's shape


class Axis(NamedTuple):
    """One dimension of the grid."""

    name: str
    values: Any  # inner: an array whose first dimension is the axis; outer: a tuple of objects
    labels: tuple | None = None  # labels of an outer axis; None for an inner one

    def __len__(self):
        return len(self.values)

    @property
    def inner(self) -> bool:
        return self.labels is None


def axis(name: str, values, where=None) -> Axis:
    """Return an axis of Python values, as `sweep` takes them.

    Args: where: its name in messages; default: `name`.
    Raises: ArgumentError for other values, none, or values that are not finite.
    """
    where = where or name
    if isinstance(values, Mapping):
        made = Axis(name, tuple(values.values()), tuple(values))
    elif not isinstance(values, (list, tuple, range, np.ndarray, jax.Array)) or getattr(values, "ndim", 1) == 0:
        raise errors.fail(where, "be an axis: an array, a list, or a dict of labelled values", f"is {values!r}")
    elif (numbers := _numbers(name, where, values)) is not None:
        made = Axis(name, numbers)
    else:
        labels = tuple(v if isinstance(v, (str, bool)) else getattr(v, "name", None) for v in values)
        if None in labels:
            must = "hold numbers, names or named objects, or be a dict {label: value}"
            raise errors.fail(where, must, f"is {values!r}")
        made = Axis(name, tuple(values), labels)
    if not len(made):
        raise errors.fail(where, "hold at least one value", "is empty")
    if made.inner and not np.all(np.isfinite(made.values)):
        raise errors.fail(where, "hold finite values", "does not")
    return compiled_in(made, where) if name in COMPILED_IN else made


def compiled_in(of: Axis, where: str) -> Axis:
    """Return an axis of numbers as an outer one; whole numbers are integers."""
    if not of.inner:
        return of
    if of.values.ndim != 1:
        raise errors.fail(where, "hold single numbers, as each is compiled in", "holds vectors")
    numbers = tuple(int(v) if float(v).is_integer() and of.name in COMPILED_IN else v.item() for v in of.values)
    return Axis(of.name, numbers, numbers)


def _numbers(name, where, values):
    """Return the numbers or vectors of an axis as one array; None if they are something else."""
    typed = isinstance(values, (range, np.ndarray, jax.Array))
    if not typed and any(isinstance(v, (str, bool)) for v in values):
        return None
    try:
        array = np.asarray(values)
    except ValueError:
        raise errors.fail(where, "hold values of one shape", f"is {values!r}") from None
    if array.dtype.kind not in "fiub":
        return None
    whole = array.dtype.kind in "iub" and (typed or name == "M")
    return array if whole else np.asarray(values, float)


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

    axes: tuple
    lanes: int
    more: Callable = dataclasses.field(default=lambda program, lanes: {}, compare=False, repr=False)

    def __post_init__(self):
        pieces = math.prod(-(-n // step) for n, step in zip(self.shape, self.block, strict=True))
        programs = math.prod(len(a) for a in self.axes if not a.inner)
        for count, (what, most) in zip((self.size, programs, pieces), MOST.items(), strict=True):
            if count > most:
                axes = " × ".join(f"{len(a):,} of {a.name}" for a in self.axes)
                raise errors.fail("axes", f"span at most {most:,} {what}", f"span {count:,}: {axes}")

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
        outer = [a for a in self.axes if not a.inner]
        combinations = itertools.product(*(a.values for a in outer))
        return [dict(zip([a.name for a in outer], values, strict=True)) for values in combinations]

    def blocks(self) -> list:
        """Return all blocks, program by program."""
        cuts = [
            [slice(first, min(first + step, n)) for first in range(0, n, step)]
            for n, step in zip(self.shape, self.block, strict=True)
        ]
        outer = [i for i, a in enumerate(self.axes) if not a.inner]

        def places(region):  # on the outer axes: those of a program
            return [region[i].start for i in outer]

        groups = itertools.groupby(sorted(itertools.product(*cuts), key=places), key=places)
        return [Block(number, region) for number, (_, regions) in enumerate(groups) for region in regions]

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

    def __str__(self):
        return " × ".join(f"{a.name} {len(a)}" for a in self.axes)


def grid(axes: Mapping, lanes=None) -> Grid:
    """Return the grid of {name: Python values}."""
    if not axes:
        raise errors.fail("axes", "name at least one axis, such as alpha=jnp.linspace(1, 40, 200)", "is empty")
    lanes = LANES if lanes is None else errors.integer("lanes", lanes, at_least=1)
    return Grid(tuple(axis(name, values) for name, values in axes.items()), lanes)
