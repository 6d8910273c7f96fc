"""The one-step map at any instant of a run: a loop's eigenvalues where it is, the error being what it is there."""

from typing import NamedTuple

import jax
import numpy as np

from cnclik.integrate.drive import Drive
from cnclik.law import reference as ref
from cnclik.law.law import Law
from cnclik.robot.model import one_off
from cnclik.stability.driven import looked_at, modes_of, radius
from cnclik.stability.rates import rates_of
from cnclik.stability.spectrum import at_rest, directions, step_maps, task_radius

GAINS = 256  # looked at together
LEAST = 1e-15  # share of the gain down to which a stable one is looked for
_NOISE = 1e-6  # of eigenvalues: one that is 1 may come out larger by less


class Instant(NamedTuple):
    """Where a loop is at an instant, and what it is to do: a held reference that has the path's velocity."""

    q: np.ndarray  # (n,)
    reference: ref.Reference | None


def resting(law, at: Instant) -> tuple[Law, Instant]:
    """The law and the instant as they would be at rest there, see `at_rest`."""
    law, held = at_rest(law, None, at.q)
    return law, Instant(at.q, held)


@one_off
def targets(reference, task, t):
    """Position, rotation and task velocity of a reference at times t (k,), each None or an array (k, ...); the first
    two are known of a task of one tip's pose.
    """

    def one(t):
        aims, velocity = ref.sample(reference, task, t)
        found = {part.turns: aim for part, aim in zip(task.parts, aims, strict=True)} if task.of_one_tip else {}
        return found.get(False), found.get(True), velocity

    return jax.vmap(one)(t)


def maps(law, at: Instant, scale, Ts, method, stage):
    """∂q[k+1]/∂q[k] at rest at an instant for gains scale·alpha (k, n, n), and J (m, n)."""
    Ts = np.full(len(scale), float(Ts))
    if (rates := rates_of(law, at.reference, at.q)) is not None:  # compiled in a fraction of the time
        return rates.maps(scale, Ts, method, stage)
    return step_maps(law, at.reference, at.q, scale, Ts, method, stage)


def radii(law, at: Instant, scale, Ts, method, stage, drive=Drive()):
    """Spectral radius over the task's directions at an instant for gains scale·alpha (k,)."""
    moved, rows = maps(law, at, scale, Ts, method, stage)
    if drive.prompt:
        return task_radius(moved, rows)
    return radius(modes_of(moved, directions(rows)[2], drive), drive, float(Ts))


def stable_share(law, at: Instant, Ts, method, stage, drive=Drive()) -> float:
    """Share of the gain up to which the loop is stable at an instant, to 1 %: 1 if all of it is, 0 below LEAST.

    All of it counts, too, where only smaller gains are not: those that don't outweigh what else moves the task.
    """
    count = GAINS if drive.prompt else looked_at(drive, 3)

    def bad(scale):
        return ~(radii(law, at, scale, Ts, method, stage, drive) <= 1 + _NOISE)

    least, whole = bad(np.array([LEAST, 1.0]))
    if least and not whole:
        return 1.0
    for top in np.geomspace(1, LEAST, 6)[:-1]:  # three decades at a time
        grid = np.geomspace(top * 1e-3, top, count)
        unstable = bad(grid)
        first = int(np.argmax(unstable))
        if not unstable.any():
            return float(top)
        if first > 0:
            grid = np.linspace(grid[first - 1], grid[first], count)
            return float(grid[max(int(np.argmax(bad(grid))) - 1, 0)])
    return 0.0


def fastest_share(law, at: Instant, Ts, method, stage, drive=Drive()) -> float:
    """Share of the gain, at most 1, with which the loop settles soonest at an instant."""
    count = GAINS if drive.prompt else 2 * (looked_at(drive, 3) // 2)
    grid = np.linspace(0, 1, count + 1)[1:]
    for _ in range(2):
        best = grid[np.argmin(radii(law, at, grid, Ts, method, stage, drive))]
        grid = np.clip(best + (np.arange(count) - count // 2) / (count // 2) / count, 1e-9, 1.0)
    return float(best)
