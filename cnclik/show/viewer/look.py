"""Look: a loop run anew for other numbers, and its factors; what the sliders of a live view ask for.

Gain and sampling time are arrays: all their values share a program. There is one for each method, and for each dead
time that is looked at, as theirs are different loops.
"""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np

from cnclik.integrate.drive import Drive
from cnclik.integrate.method import named
from cnclik.integrate.trajectory import Trajectory
from cnclik.precision import in_float64
from cnclik.record import replace
from cnclik.stability.case import WILD
from cnclik.stability.driven import driven_factors, looked_at_drive, modes_of, radius
from cnclik.stability.drives import own_drives
from cnclik.stability.loop import resting
from cnclik.stability.spectrum import directions, largest_rate, spectrum_of


class Sliders(NamedTuple):
    """The numbers that sliders set: the gain's largest |eigenvalue| [1/s], [s], a method's name, and [samples]."""

    alpha: float
    Ts: float
    method: str
    delay: float

    @property
    def program(self) -> tuple:
        """The values that a program is compiled for."""
        return self.method, self.delay


class Observation(NamedTuple):
    """A run, and the factors by which its loop multiplies small errors where it ended."""

    loop: Sliders
    run: Trajectory
    factors: np.ndarray | None  # complex; None where joints have drives of their own
    radius: float  # their largest absolute value; below 1 is stable


def loop_of(problem) -> Sliders:
    """The numbers that a problem has."""
    delay = 0.0 if problem.drive is None else float(problem.drive.delay)
    return Sliders(largest_rate(problem.law.alpha), float(problem.Ts), str(problem.method), delay)


def with_loop(problem, loop: Sliders):
    """The problem with other numbers; a gain per axis, or a matrix, keeps its ratios."""
    alpha = np.asarray(problem.law.alpha, float)
    drive = problem.drive
    if drive is not None or loop.delay:
        drive = replace(drive or Drive(), delay=float(loop.delay))
    law = replace(problem.law, alpha=alpha * (loop.alpha / largest_rate(alpha)))
    return dataclasses.replace(problem, law=law, Ts=float(loop.Ts), method=named(loop.method), drive=drive)


def look(problem, loop: Sliders) -> Observation:
    """Run the loop with these numbers."""
    made = with_loop(problem, loop)
    run = jax.tree.map(np.asarray, made.run())
    return Observation(loop, run, *factors_of(made, run.q))


@in_float64
def factors_of(made, q):
    """The loop's factors over the task's directions at rest where a run ended; where it began if it went astray."""
    rests = np.isfinite(q[-1]).all() and np.abs(q[-1]).max() <= WILD
    q = np.asarray(q[-1] if rests else made.q0, float)
    drive = made.drive or Drive()
    moved, rows = resting(made.law, q, made.method, made.stage, drive).maps(np.ones(1), np.full(1, made.Ts))
    if not np.isfinite(moved).all():
        return np.zeros(0, complex), np.inf
    if drive.prompt:
        found = spectrum_of(moved[0], rows)
        return found.task, found.radius
    modes = modes_of(moved, directions(rows)[2], drive)
    size = float(radius(modes, drive, made.Ts)[0])
    return (None if own_drives(drive) else driven_factors(modes, looked_at_drive(drive), made.Ts).ravel()), size
