"""What the text of Drexler (2016) leaves open: a `Reading` settles it. Read without loading JAX."""

import itertools
from typing import NamedTuple

from cnclik import errors


class Reading(NamedTuple):
    """One way to read the paper where its text leaves a choice."""

    rotation: str
    """"on-path": positive angles turn clockwise, and Case II starts on its path; "printed": right-handed about +z."""
    Ts: str
    """"once": as eqs. 2-5 have it; "twice": eq. 7 as printed multiplies by Ts what eq. 6 already did."""
    feedforward: str
    """"consistent": the path's own velocity −1/(N·Ts); "printed": −1, as eqs. 16 and 19."""

    def __str__(self):
        return "/".join(self)


_CHOICES = (("on-path", "printed"), ("once", "twice"), ("consistent", "printed"))
READINGS = {str(r): r for r in itertools.starmap(Reading, itertools.product(*_CHOICES))}
DEFAULT = READINGS["on-path/once/consistent"]
FIGURES = (*(f"fig{k:02d}.png" for k in range(1, 16)), "overview.png")  # what `figures.figures` draws


def reading(name) -> Reading:
    """The reading of that name, such as "on-path/once/consistent"; ArgumentError suggests the nearest."""
    return READINGS[errors.one_of("reading", str(name), READINGS)]
