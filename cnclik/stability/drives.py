"""Drives of joints that differ: each as one for all joints, one by one or side by side."""

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import MOST, Drive
from cnclik.record import replace

SPARE = 1.0  # samples of dead time beyond the known ones under which a recommended gain still has no overshoot
_OF_JOINTS = "lag", "natural_frequency", "damping_ratio"  # what may be another of each joint's drive


def own_drives(drive) -> bool:
    """Whether joints differ in their drives."""
    return any(np.ndim(getattr(drive, name)) == 1 for name in _OF_JOINTS)


def side_by_side(drive) -> Drive:
    """The drives of the joints that differ, d of them, each as one for all joints: arrays (d, 1), beside which are
    modes. One for all as it is."""
    if not own_drives(drive):
        return drive
    names = ("natural_frequency", "damping_ratio") if drive.order == 2 else ("lag",)
    values = np.broadcast_arrays(*(np.asarray(getattr(drive, name), float) for name in names))
    found = np.unique(np.stack(values), axis=1)
    return replace(drive, **{name: v[:, None] for name, v in zip(names, found, strict=True)})


def each_drive(drive) -> list:
    """The drives of the joints that differ, each as one for all joints."""
    found = side_by_side(drive)
    names = [name for name in _OF_JOINTS if np.ndim(getattr(found, name)) == 2]
    count = len(getattr(found, names[0])) if names else 0
    return [replace(drive, **{n: getattr(found, n)[i, 0] for n in names}) for i in range(count)] or [drive]


def several(drive) -> bool:
    """Whether it is several side by side."""
    return any(np.ndim(getattr(drive, name)) == 2 for name in _OF_JOINTS)


def longer(drive) -> Drive:
    """The drive with the dead time that a recommended gain is safe for."""
    if drive.feedback == "commanded":  # the loop itself has none
        return Drive(delay=SPARE)
    if (late := drive.lumped.delay) > MOST - SPARE:
        raise errors.fail("delay", f"be at most {MOST - SPARE:g} samples where a gain is recommended", f"is {late:g}")
    return replace(drive, delay=drive.delay + SPARE)
