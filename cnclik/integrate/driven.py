"""Driven: drives and filters within the loop that `solve` runs: their state, and one sample of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from cnclik.integrate.drive import Drive, Sampled
from cnclik.record import Array, Float
from cnclik.robot import chart
from cnclik.robot.rotations import exp_so3, log_so3


class Driven(NamedTuple):
    """The state of the drives."""

    x: Float[Array, "n s"]
    line: Float[Array, "d n"]  # commands that still act, newest first
    sent: Float[Array, " n"]  # the sum of the controller's steps
    late: tuple[Array, ...]  # measured errors on their way, newest first
    smooth: Any  # the filtered error (m,), command (n,), or target of each part of the task; None without a filter


def resting(chain, drive: Drive, model: Sampled, q, late=(), smooth=None) -> Driven:
    """Return drives at rest at q (n,), commanded to stay there.

    Args: late: the errors on their way. smooth: the filtered error or target.
    """
    x = jnp.zeros((*q.shape, model.size), q.dtype).at[..., 0].set(chart.centre(chain, q))
    held = q if drive.steps_positions else jnp.zeros_like(q)
    return Driven(x, jnp.tile(held, (model.remembered, 1)), q, late, held if drive.filters == "command" else smooth)


def driven(chain, drive: Drive, model: Sampled, drives: Driven, q, seen, step, Ts) -> tuple[Array, Driven]:
    """Return the joint values (n,) one sample after q (n,), and the drives then.

    Args: seen, step: (n,) the joint values that the controller used, and its step from there.
    """
    sent = chart.moved(chain, seen if drive.feedback == "rebased" else drives.sent, step)
    command, smooth = sent if drive.steps_positions else step / Ts, drives.smooth
    if drive.filters == "command":
        command = smooth = averaged(drive.kept(Ts), smooth, command)
    line = jnp.concatenate([command[None], drives.line])[: len(drives.line)]
    x = model.moved(drives.x, drives.line, command)
    after = chart.out(chain, q, x[:, 0])
    if chain.balls:
        x = x.at[:, 0].set(chart.centre(chain, after))
    return after, drives._replace(x=x, line=line, sent=sent, smooth=smooth)


def averaged(kept, before, new):
    """Return one sample of the filter: ρ before + (1 − ρ) new."""
    return kept * before + (1 - kept) * new


def turned(kept, before, new):
    """Return one sample of the filter of a rotation."""
    return exp_so3((1 - kept) * log_so3(new @ before.T)) @ before
