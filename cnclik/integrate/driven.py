"""Driven: drives and filters within the loop that `solve` runs: their state, and one sample of it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, Sampled
from cnclik.record import Array, Float
from cnclik.robot import chart


class Driven(NamedTuple):
    """The state of the drives."""

    x: Float[Array, "n s"]
    line: Float[Array, "d n"]  # commands that still act, newest first
    sent: Float[Array, " n"]  # the sum of the controller's steps
    smooth: Float[Array, " n"] | None  # the filtered command


def resting(chain, drive: Drive, model: Sampled, q) -> Driven:
    """Drives at rest at q (n,), commanded to stay there."""
    x = jnp.zeros((*q.shape, model.size), q.dtype).at[..., 0].set(chart.centre(chain, q))
    held = q if drive.steps_positions else jnp.zeros_like(q)
    return Driven(x, jnp.tile(held, (model.remembered, 1)), q, held if drive.filters == "command" else None)


def reached(chain, q, at: Driven):
    """The joint values (n,) after a sample that starts at q (n,), and the drives in the chart centred there."""
    after = chart.out(chain, q, at.x[:, 0])
    return after, at._replace(x=at.x.at[:, 0].set(chart.centre(chain, after))) if chain.balls else at


def driven(chain, drive: Drive, model: Sampled, at: Driven, q, step, Ts) -> Driven:
    """The drives one sample later, after the controller's step (n,) from the joint values q (n,) that it used."""
    sent = chart.moved(chain, q if drive.feedback == "rebased" else at.sent, step)
    command, smooth = sent if drive.steps_positions else step / Ts, None
    if at.smooth is not None:
        command = smooth = averaged(drive.kept(Ts), at.smooth, command)
    line = jnp.concatenate([command[None], at.line])[: len(at.line)]
    return Driven(model.moved(at.x, at.line, command), line, sent, smooth)


def averaged(kept, before, new):
    """One sample of the filter: ρ before + (1 − ρ) new."""
    return kept * before + (1 - kept) * new


def white_noise(sigma, N: int, m: int, seed=0):
    """(N, m) independent normal measurement errors; the same seed gives the same numbers.

    Args:
      sigma: standard deviation, a number or one per task coordinate (m,) [m, rad]; it may be traced, the seed not.
    """
    sigma = errors.array("noise", sigma, (), (1,), (m,))
    if errors.concrete(sigma) and np.any(np.asarray(sigma) < 0):
        raise errors.fail("noise", "be at least 0", f"is {np.min(sigma):g}")
    return sigma * np.random.default_rng(int(errors.seed(seed))).standard_normal((N, m))
