"""The loops that are timed: arms, where their lanes start and go to, and what a lane computes."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck

ALPHA, TS, DAMPING = 5.0, 0.1, 0.1  # the paper's: z = 0.5


class Case(NamedTuple):
    """An arm's law, and the posture around which loops start and targets lie, within `spread` [rad]."""

    law: ck.Law
    posture: tuple
    spread: float = 0.2


ROBOTS = {  # its whole pose, by damped least squares
    "panda": (ck.panda, (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)),
    "ur5": (ck.ur5, (0.0, -1.2, 1.8, -2.2, -math.pi / 2, 0.0)),
}


def case(robot="panda", **changes) -> Case:
    """An arm's pose loop, with some of its law changed."""
    build, posture = ROBOTS[robot]
    law = ck.Law(build(), ck.pose(), alpha=ALPHA, inverse=ck.damped(DAMPING))
    return Case(ck.replace(law, **changes), posture)


def inputs(case: Case, batch: int, dtype) -> dict:
    """Starts q0 (batch, n) and targets, each lane its own: position (batch, 3), rotation (batch, 3, 3).

    Targets are poses of nearby joint values, so that all can be reached; there are at most 4096 different ones.
    """
    draw = np.random.default_rng(0)
    n, few = len(case.posture), min(batch, 4096)
    q0 = case.posture + case.spread * draw.uniform(-1, 1, (batch, n))
    goals = case.posture + case.spread * draw.uniform(-1, 1, (few, n))
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(lambda q: ck.forward(case.law.chain, q)))(goals)
    named = {
        "q0": q0,
        "position": np.resize(at.position, (batch, 3)),
        "rotation": np.resize(at.rotation, (batch, 3, 3)),
    }
    return {name: np.asarray(value, dtype) for name, value in named.items()}


def end(law, reference, q0, Ts, N, method="EE", stage=None):
    """The joint values and the error after N steps, (q (n,), e (m,)), of one lane."""
    run = ck.solve(law, reference, q0, Ts, N, method, stage or ck.picard(5))
    return run.q[-1], run.e[-1]


def tracking_loss(case: Case, N: int):
    """Mean of ‖e‖² over the N + 1 instants of a loop by EE, as a function of alpha and one lane's start and target."""

    def loss(alpha, q0, position, rotation):
        e = ck.solve(ck.replace(case.law, alpha=alpha), ck.hold(position, rotation), q0, TS, N, "EE").e
        return jnp.mean(jnp.sum(e * e, axis=1))

    return loss


def matrix(offset) -> np.ndarray:
    """An Offset of cnclik as a 4×4 matrix."""
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = offset.rotation, offset.position
    return m


def panda_matrices():
    """(origins (7, 4, 4), tip (4, 4)) for the peers: every joint turns about the z of its own frame."""
    chain = ck.panda()
    assert all(joint.axis == (0.0, 0.0, 1.0) for joint in chain.joints)
    return np.stack([matrix(joint.origin) for joint in chain.joints]), matrix(chain.tips[0].offset)
