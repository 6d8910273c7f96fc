"""As C a loop gives what XLA gives: every inverse, limit, null-space term, method and stage."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.oracles import close

LIMITS = {"lower": (-3.0, -2.0, -3.0, -2.0), "upper": (3.0, 0.9, 3.0, 2.0), "velocity_limit": (2.0, 2.0, np.inf, 1.0)}
ARM = ck.replace(ck.planar_arm([1.0, 0.8, 0.6, 0.4]), **LIMITS)
SHORT = ck.replace(ck.planar_arm([1.0, 0.8, 0.8]), **{name: value[:3] for name, value in LIMITS.items()})
Q0 = np.array([0.3, 0.5, -0.4, 0.9])
TASKS = {
    "position": ck.position("xy"),
    "pose": ck.pose("xy", "z"),
    "weighted": ck.position("xy", weights=[1.0, 3.0]),
}
INVERSES = {
    "pseudoinverse": ck.pseudoinverse(),
    "damped": ck.damped(0.1),
    "singular": ck.singular_damped(0.1, 2.0),
}
KEPT = {
    "free": None,
    "scaled": ck.velocity_scaling(),
    "bounded": ck.bounded(),
}
NULL = {
    "none": lambda arm: None,
    "posture": lambda arm: ck.posture([0.0, 0.3, 0.3, 0.3][: arm.n], 2.0),
}
ENGINES = ("native", "xla")
METHODS = (
    (ck.EE, ck.picard(0)),
    (ck.IE, ck.picard(2)),
    (ck.CN, ck.chord(1)),
    (ck.TRAPEZOID, ck.newton(1)),
    (ck.HEUN, ck.picard(0)),
    (ck.RK4, ck.picard(0)),
    (ck.IE, ck.chord(2)),
)
QUICK = [  # every part once
    ("position", "damped", "bounded", "none", 0),
    ("pose", "pseudoinverse", "free", "posture", 1),
    ("weighted", "damped", "scaled", "posture", 2),
    ("position", "singular", "free", "posture", 3),
    ("weighted", "singular", "scaled", "none", 4),
    ("position", "damped", "free", "none", 5),
    ("position", "pseudoinverse", "scaled", "none", 6),
    ("weighted", "singular", "bounded", "posture", 1),
]
WHOLE = [  # every inverse with every limit
    pytest.param(list(TASKS)[i % 3], *pair, list(NULL)[i % 2], i % 7, marks=pytest.mark.slow)
    for i, pair in enumerate(itertools.product(INVERSES, KEPT))
    if pair[1] != "bounded" or pair[0] != "pseudoinverse"
]


def loop(arm, task, inverse, kept, null, number):
    task, (method, stage) = TASKS[task], METHODS[number]
    law = ck.Law(
        arm,
        task,
        alpha=np.linspace(4.0, 5.0, task.m) if number % 3 == 0 else 4.0,
        inverse=INVERSES[inverse],
        limits=KEPT[kept],
        null_velocity=NULL[null](arm),
        error_clamp=(0.2, 0.5) if number % 2 else None,
    )
    turn = {"rotation": np.array([np.cos(0.4), 0, 0, np.sin(0.4)])} if task.orientation else {}
    return law, ck.line([-1.0, 1.5], [-1.3, 1.0], duration=0.6, **turn), method, stage


def end(law, reference, method, stage, alpha, q0):
    run = ck.solve(ck.replace(law, alpha=law.alpha * alpha), reference, q0, 0.05, 6, method, stage)
    return run.e[-1], run


@pytest.mark.parametrize("task, inverse, kept, null, number", [*QUICK, *WHOLE])
def test_both_engines_agree(request, task, inverse, kept, null, number):
    slow = request.node.get_closest_marker("slow")
    arm = ARM if slow or task == "pose" else SHORT  # one joint more than the task has rows
    made, given, start = {}, loop(arm, task, inverse, kept, null, number), jnp.asarray(Q0[: arm.n])
    for engine in ENGINES:
        with ck.use_engine(engine):
            value = jax.jit(lambda alpha, q0: end(*given, alpha, q0)[1])(1.0, start)
            turned = jax.jacfwd(lambda alpha, q0: end(*given, alpha, q0)[0], (0, 1))
            made[engine] = value, jax.jit(turned)(1.0, start) if slow else ()  # quick: below
    (one, d_one), (two, d_two) = (made[engine] for engine in ENGINES)
    for name in ("q", "x", "e", "qdot", "residual"):
        close(getattr(one, name), getattr(two, name), atol=1e-10, rtol=1e-9)
    np.testing.assert_array_equal(one.status, two.status)
    for a, b in zip(d_one, d_two, strict=True):
        assert np.all(np.isfinite(a))
        close(a, b, atol=1e-7, rtol=1e-7)


def test_reverse_gradients_agree():
    given = loop(SHORT, "position", "damped", "free", "posture", 0)

    def loss(q0):
        return jnp.sum(end(*given, 1.0, q0)[0] ** 2)

    found = {}
    for engine in ENGINES:
        with ck.use_engine(engine):
            found[engine] = jax.jit(jax.grad(loss))(jnp.asarray(Q0[:3]))
    close(*found.values(), atol=1e-11)


@pytest.mark.parametrize("limits", [None, pytest.param(ck.bounded(), marks=pytest.mark.slow)])
def test_a_whole_pose_of_a_real_arm(limits):
    arm, q0 = ck.panda(), np.array([0.0, -0.3, 0.1, -2.0, 0.0, 1.8, 0.5])
    to = ck.forward(arm, q0 + 0.1)
    law = ck.Law(arm, ck.pose(), alpha=5.0, limits=limits, inverse=ck.damped(0.05))
    runs = {}
    for engine in ENGINES:
        with ck.use_engine(engine):
            runs[engine] = jax.jit(lambda q0: ck.solve(law, ck.hold(to), q0, 0.01, 20))(q0)
    for name in ("q", "x", "e", "qdot"):
        close(*(getattr(run, name) for run in runs.values()), atol=1e-12)
    np.testing.assert_array_equal(*(run.status for run in runs.values()))
