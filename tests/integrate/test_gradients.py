"""Derivatives of whole loops: forward = reverse = central differences, for everything that can be differentiated.

All arguments sit in one dictionary, so that one program per method and mode differentiates them all; ordinary
and singular configurations are only other numbers in it.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import cnclik as ck
from tests.bank import screws
from tests.oracles import central_differences, close

N = 3
ORDINARY = dict(
    alpha=[4.0, 2.0],
    Ts=0.1,
    q0=[0.3, -0.9, 0.6],
    lengths=[0.7, 1.1, 0.4],
    start=[0.6, 1.3],
    end=[0.2, 1.5],
    damping=0.1,
    weights=[1.0, 2.0],
    posture=[0.5, -1.4, 1.1],
    rate=0.7,
    feedforward=0.9,
)
CASES = {
    "ordinary": {},
    # Stretched along +y, with the target further inward and to the side: J loses its row along y.
    "singular": dict(q0=[0.0, 0.0, 0.0], start=[0.1, 2.0], end=[0.1, 1.9], damping=0.3),
    # And with nothing to do in the direction that is left.
    "singular, at rest": dict(q0=[0.0, 0.0, 0.0], start=[0.0, 2.2], end=[0.0, 2.2], posture=[0.0] * 3),
}


def arguments(case):
    return ravel_pytree({k: np.asarray(v, float) for k, v in (ORDINARY | CASES[case]).items()})


def final(p, method, inverse):
    """The last joint values and the last error of a damped or exact loop."""
    law = ck.Law(
        ck.planar_arm(p["lengths"]),
        ck.position("xy", weights=p["weights"]),
        alpha=p["alpha"],
        inverse=ck.damped(p["damping"]) if inverse == "damped" else ck.pseudoinverse(),
        null_velocity=ck.posture(p["posture"], p["rate"]),
        feedforward=p["feedforward"],
    )
    reference = ck.line(p["start"], p["end"], duration=1.0)
    run = ck.solve(law, reference, p["q0"], p["Ts"], N, method, ck.picard(2))
    return jnp.concatenate([run.q[-1], run.e[-1]])


@functools.cache
def programs(method, inverse):
    unravel = arguments("ordinary")[1]
    fn = lambda v: final(unravel(v), method, inverse)  # noqa: E731
    return both_ways(fn if method == "TRAPEZOID" else ck.native(fn))  # in a user's program, and within a native one


def both_ways(fn):
    """Compiled: a batch of values, and both Jacobians at once, as functions of the flat vector of arguments."""
    return jax.jit(jax.vmap(fn)), jax.jit(lambda x: (jax.jacfwd(fn)(x), jax.jacrev(fn)(x)))


def agree(x, values, jacobians):
    wanted, (forward, reverse) = central_differences(values, x), jacobians(x)
    size = np.abs(wanted).max()
    close(forward, wanted, atol=1e-6 * size)
    close(reverse, forward, atol=1e-12 * size)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", ["TRAPEZOID", "EXP-MIDPOINT"])  # each is two compilations; EE is below
def test_damped_loops(method, case):
    agree(np.asarray(arguments(case)[0]), *programs(method, "damped"))


@pytest.mark.parametrize("case", CASES)
def test_loops_with_the_pseudoinverse(case):
    """Where J has full rank; at a singularity nothing is NaN."""
    x, (values, jacobians) = np.asarray(arguments(case)[0]), programs("EE", "pseudoinverse")
    if case == "ordinary":
        agree(x, values, jacobians)
    assert all(np.all(np.isfinite(made)) for made in (values(x[None]), *jacobians(x)))


def wrist(v):
    """A spatial arm that turns: points, axes, tool, target quaternion, start and gain, all differentiated."""
    arm = screws(v[:9].reshape(3, 3), v[9:18].reshape(3, 3), v[18:21])
    law = ck.Law(arm, ck.orientation(), alpha=v[28], inverse=ck.damped(0.2))
    run = ck.solve(law, ck.hold(None, v[21:25]), v[25:28], 0.1, 2, "EE")
    return jnp.concatenate([run.q[-1], run.e[-1], ck.forward(arm, run.q[-1]).position])


WRIST = both_ways(ck.native(wrist))
AXES = np.eye(3)[[2, 1, 2]].ravel()  # z, y, z: singular where the middle joint is at 0
AT = np.concatenate([np.linspace(-0.4, 0.5, 9), AXES, [0.1, 0.2, 0.9]])


@pytest.mark.parametrize(
    ("turn", "q0"),  # ordinary; singular; singular with nothing to turn
    [([0.9, 0.1, -0.3, 0.2], [0.3, 0.8, -0.4]), ([0.9, 0.1, -0.3, 0.2], [0.3, 0, 0.2]), ([1, 0, 0, 0], [0, 0, 0])],
)
def test_orientation_loop(turn, q0):
    x = np.concatenate([AT, turn / np.linalg.norm(turn), q0, [3.0]])
    agree(x, *WRIST)
