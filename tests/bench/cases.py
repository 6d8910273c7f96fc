"""The loops that are timed: robots, where their lanes start and go to, and what a lane computes."""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.integrate.solve import solve
from cnclik.law import paths as ref
from cnclik.law.inverse import damped, pseudoinverse
from cnclik.law.law import Law
from cnclik.robot.builtin import panda, ur5
from cnclik.robot.chain import Chain, from_dh, planar_arm
from cnclik.robot.model import forward
from cnclik.task.build import pose, position

ALPHA, TS = 5.0, 0.1  # the paper's: z = 0.5
DAMPING = 0.1


class Case(NamedTuple):
    """A robot's law, and the posture around which loops start and targets lie."""

    law: Law
    posture: tuple
    spread: float  # [rad] of both


def chain_of_30() -> Chain:
    """30 revolute joints, neighbours' axes at right angles, links of 0.1 m: a snake arm of 3 m."""
    turns = [math.pi / 2 if i % 2 == 0 else -math.pi / 2 for i in range(30)]
    return from_dh(a=[0.1] * 30, alpha=turns, d=[0.0] * 30)


def _planar(n):
    law = Law(planar_arm([1.0] * n, clockwise=True), position("xy"), alpha=ALPHA, inverse=pseudoinverse())
    return Case(law, (0.0, math.pi / 2, *[0.0] * (n - 2)), 0.2)


def _spatial(chain, posture):
    return Case(Law(chain, pose(), alpha=ALPHA, inverse=damped(DAMPING)), posture, 0.2)


# The paper's arms on their position with J#, the others on their whole pose with damped least squares.
ROBOTS = {
    "planar2": lambda: _planar(2),
    "planar5": lambda: _planar(5),
    "panda": lambda: _spatial(panda(), (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)),
    "ur5": lambda: _spatial(ur5(), (0.0, -1.2, 1.8, -2.2, -math.pi / 2, 0.0)),
    "chain30": lambda: _spatial(chain_of_30(), (0.3,) * 30),
}


def inputs(case: Case, batch: int, dtype) -> dict:
    """Starts q0 (batch, n) and targets, each lane its own: position (batch, 3), rotation (batch, 3, 3).

    Targets are poses of nearby joint values, so that all can be reached; there are at most 4096 different ones.
    """
    draw = np.random.default_rng(0)
    n, few = len(case.posture), min(batch, 4096)
    q0 = case.posture + case.spread * draw.uniform(-1, 1, (batch, n))
    goals = case.posture + case.spread * draw.uniform(-1, 1, (few, n))
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(lambda q: forward(case.law.chain, q)))(goals)
    named = {"q0": q0, "position": np.resize(at.position, (batch, 3))}
    if case.law.task.orientation:
        named["rotation"] = np.resize(at.rotation, (batch, 3, 3))
    return {name: np.asarray(value, dtype) for name, value in named.items()}


def end(law, reference, q0, Ts, N, method, stage):
    """The joint values and the error after N steps, (q (n,), e (m,)), of one lane."""
    run = solve(law, reference, q0, Ts, N, method, stage)
    return run.q[-1], run.e[-1]


def loop(case: Case, N: int, method, stage):
    """The end of a loop of N steps, none of it stored, (q (n,), ‖e‖), as a function of one lane's start and target."""

    def one(q0, position, rotation=None):
        q, e = end(case.law, ref.hold(position, rotation), q0, TS, N, method, stage)
        return q, jnp.linalg.norm(e)

    return one


def tracking_loss(case: Case, N: int, method, stage):
    """Mean of ‖e‖² over a loop's N + 1 instants, as a function of alpha and one lane's start and target."""

    def loss(alpha, q0, position, rotation=None):
        law = dataclasses.replace(case.law, alpha=alpha)
        e = solve(law, ref.hold(position, rotation), q0, TS, N, method, stage).e
        return jnp.mean(jnp.sum(e * e, axis=1))

    return loss
