"""Grid: the axes of a sweep, cut into blocks of one fixed shape.

Each combination of the outer axes (methods, robots, all that is compiled in) is one program, traced once. It runs every
block of the inner, numeric axes. Each block is computed alone, so its numbers do not depend on other blocks or
processes.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cnclik import errors

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
