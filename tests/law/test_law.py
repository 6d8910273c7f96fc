"""The law q̇ = J#(ẋ_d + K e) + (I − J#J) q̇₀ against NumPy, Pinocchio's and closed-form Jacobians."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from tests.bank import told
from tests.oracles import (
    close,
    damped_inverse,
    pinocchio_pose_and_jacobian,
    planar_jacobian,
    planar_law,
    planar_position,
)

LENGTHS = np.array([0.7, 1.1, 0.4])
ARM = ck.planar_arm(LENGTHS.tolist())
Q = np.array([0.3, -0.9, 0.6])
TARGET, VELOCITY = np.array([0.5, 1.2]), np.array([0.3, -0.2])
REFERENCE = told(ck.hold(TARGET), VELOCITY)
GAINS = {"scalar": 5.0, "per axis": [5.0, 2.0]}


def qdot(law, q=Q, reference=REFERENCE):
    return ck.step(law, reference, q, 0.0, 0.1, "EE").qdot


def oracle(alpha=5.0, q=Q, velocity=VELOCITY, **kwargs):
    return planar_law(LENGTHS, lambda t: TARGET, lambda t: velocity, alpha, **kwargs)(q, 0.0)


@pytest.mark.parametrize(
    ("gain", "inverse"),
    [*((gain, "pseudoinverse") for gain in GAINS), ("per axis", "damped")],
)
def test_gains_and_inverses(gain, inverse):
    alpha = GAINS[gain]
    ours = {"pseudoinverse": ck.pseudoinverse(), "damped": ck.damped(0.3)}[inverse]
    theirs = {"pseudoinverse": np.linalg.pinv, "damped": damped_inverse(0.3)}[inverse]
    found = qdot(ck.Law(ARM, ck.position("xy"), alpha=alpha, inverse=ours))
    close(found, oracle(alpha, inverse=theirs), atol=1e-13)


def test_feedforward_factor():
    for factor in (1, 0.0, 0.5):
        law = ck.Law(ARM, ck.position("xy"), alpha=5.0, feedforward=factor)
        close(qdot(law), oracle(velocity=factor * VELOCITY), atol=1e-13)


def test_weights():
    """Weights scale rows and errors: they matter where not everything can be had."""
    w = np.array([1.0, 3.0])
    weighted = ck.position("xy", weights=w)
    j = np.diag(w) @ planar_jacobian(LENGTHS, Q)
    v = w * (VELOCITY + 5 * (TARGET - planar_position(LENGTHS, Q)))
    law = ck.Law(ARM, weighted, alpha=5.0, inverse=ck.damped(0.3))
    close(qdot(law), damped_inverse(0.3)(j) @ v, atol=1e-13)
    close(qdot(ck.Law(ARM, weighted, alpha=5.0)), oracle(), atol=1e-13)  # full rank: no effect
    # One joint, two coordinates: weighted least squares.
    one = ck.Law(ck.planar_arm([0.7]), weighted, alpha=5.0, inverse=ck.damped(0.3))
    q = np.array([0.4])
    j = np.diag(w) @ planar_jacobian(LENGTHS[:1], q)
    v = VELOCITY + 5 * (TARGET - planar_position(LENGTHS[:1], q))
    close(qdot(one, q), damped_inverse(0.3)(j) @ (w * v), atol=1e-13)


def test_a_posture_pulls_in_the_null_space():
    rest = np.array([1.0, -0.5, 0.25])
    law = ck.Law(ARM, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(rest, 2.0))
    close(qdot(law), oracle(null=2.0 * (rest - Q)), atol=1e-13)
    moved = qdot(law) - qdot(ck.replace(law, null_velocity=None))
    close(planar_jacobian(LENGTHS, Q) @ moved, 0, atol=1e-14)  # J q̇_null = 0
    assert np.linalg.norm(moved) > 0.1


def test_the_rate_of_a_posture_may_be_traced():
    law = ck.Law(ARM, ck.position("xy"), alpha=5.0)

    def joint(k, q):
        return qdot(ck.replace(law, null_velocity=ck.posture(np.zeros(3), k)), q)

    close(jax.grad(lambda k: joint(k, Q)[0])(2.0), (oracle(null=-3 * Q) - oracle(null=-2 * Q))[0], atol=1e-13)
    many = jax.vmap(joint, (0, None))(jnp.arange(3.0), Q)
    close(many[2], oracle(null=-2 * Q), atol=1e-13)


def test_pose_task_on_a_spatial_arm():
    """Six joints in space: Pinocchio's Jacobian, SciPy's rotation vector, numpy's pseudoinverse."""
    rng = np.random.default_rng(8)
    points, axes = rng.normal(size=(2, 6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    kinds, home = "RRPRRR", np.array([0.3, 0.2, 1.0])
    arm = ck.from_screws(points.tolist(), axes.tolist(), home.tolist(), kinds=kinds)
    origins = np.diff(np.concatenate([np.zeros((1, 3)), points]), axis=0)
    joints = [(k, a, np.block([[np.eye(3), o[:, None]], [0, 0, 0, 1]])) for k, a, o in zip(kinds, axes, origins)]  # noqa: B905
    tip = np.eye(4)
    tip[:3, 3] = home - points[-1]
    law = ck.Law(arm, ck.pose(), alpha=np.arange(1.0, 7.0))
    target, goal = np.array([0.1, 0.2, 0.4]), Rotation.from_rotvec([0.3, 0.2, -1.0])
    for q in rng.uniform(-2, 2, (5, 6)):
        pose, j = pinocchio_pose_and_jacobian(joints, tip, q)
        turn = (goal * Rotation.from_matrix(pose[:3, :3]).inv()).as_rotvec()
        e = np.concatenate([target - pose[:3, 3], turn])
        wanted = np.linalg.pinv(j) @ (np.arange(1.0, 7.0) * e)
        made = ck.step(law, ck.hold(target, goal.as_matrix()), q, 0.0, 0.1, "EE")
        close(made.e, e, atol=1e-13)
        close(made.qdot, wanted, atol=1e-12 * np.abs(wanted).max() * np.linalg.cond(j))


# --- dtypes -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "alpha",
    [5, np.float32(5), np.array(5), jnp.asarray(5.0)],
    ids=repr,
)
def test_kinds_of_gain(alpha):
    found = qdot(ck.Law(ARM, ck.position("xy"), alpha=alpha, feedforward=1, near_singular=0))
    assert found.dtype == jnp.float64
    close(found, oracle(), atol=1e-13)


@pytest.mark.parametrize(
    "q", [(0, 1, 0), [0, 1, 0], np.array([0, 1, 0]), jnp.array([0, 1, 0]), (0.0, 1, np.float32(0))]
)
def test_kinds_of_joint_values_and_times(q):
    made = ck.step(ck.Law(ARM, ck.position("xy"), alpha=5), REFERENCE, q, 0, 1, "EE")
    assert made.q.dtype == jnp.float64
    close(made.qdot, oracle(q=np.array([0.0, 1, 0])), atol=1e-13)


def test_single_precision_loop_in_a_double_precision_session():
    """The loop runs in the dtype of q, whatever the dtypes of gains, targets and times."""
    law = ck.Law(
        ARM, ck.position("xy"), alpha=np.float64(5), inverse=ck.damped(0.1), null_velocity=ck.posture(np.ones(3))
    )
    made = ck.step(law, ck.path(lambda t: (0.5, np.float64(1.2) + t)), Q.astype(np.float32), 0, 1, "CN")
    assert {v.dtype for v in (made.q, made.e, made.qdot, made.residual)} == {jnp.dtype(jnp.float32)}


def test_gains_at_the_edge_and_traced_ones_pass():
    for alpha in (0, [0.0, 1.0], np.ones(2, np.float32)):
        ck.Law(ARM, ck.position("xy"), alpha=alpha)
    jax.jit(lambda a: ck.Law(ARM, ck.position("xy"), alpha=a).alpha)(-1.0)
    ck.Law(ARM, ck.pose(), alpha=1.0, inverse=ck.damped(0.1))  # a compromise, and every step says so


# --- what is refused ----------------------------------------------------------------------------------

XY = ck.position("xy")


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ck.Law(3, XY, alpha=1.0), "`chain` must be a Chain, but is int"),
        (lambda: ck.Law(ARM, "xy", alpha=1.0), "`task` must be a Task, but is str"),
        (lambda: ck.Law(ARM, XY, alpha=[1, 2, 3]), "`alpha` must be a single number or have 2 numbers, but has 3"),
        (lambda: ck.Law(ARM, XY, alpha=np.nan), r"`alpha` must be finite, but is nan"),
        (lambda: ck.Law(ARM, XY, alpha="5"), "`alpha` must"),
        (lambda: ck.Law(ARM, XY, alpha=None), "`alpha` must be an array of real numbers, but is None"),
        (lambda: ck.Law(ARM, XY, alpha=-5), "`alpha` must not be negative, but is -5"),
        (lambda: ck.Law(ARM, XY, alpha=[1.0, -1e-9]), "`alpha` must not be negative, but is -1e-09"),
        (lambda: ck.Law(ARM, XY, alpha=np.eye(2)), r"`alpha` must have shape \(\) or \(2,\), but has"),
        (lambda: ck.replace(ck.Law(ARM, XY, alpha=1), alpha=-1.0), "`alpha` must not be negative"),
        (
            lambda: ck.Law(ARM, ck.pose("xyz", "z"), alpha=1),
            r"`task` must have at most 3 coordinates, one per joint, .* but has 4: x, y, z, rz\.",
        ),
        (lambda: ck.Law(ARM, XY, alpha=1, inverse="damped"), "`inverse` must be pseudoinverse()"),
        (lambda: ck.Law(ARM, XY, alpha=1, null_velocity=np.ones(3)), r"`null_velocity` must be None or posture\("),
        (
            lambda: ck.Law(ARM, XY, alpha=1, null_velocity=ck.posture([0, 1])),
            "`rest` must have 3 joint values, but has",
        ),
        (lambda: ck.Law(ARM, XY, alpha=1, feedforward=[1, 2]), "`feedforward` must be a number"),
        (lambda: ck.Law(ARM, XY, alpha=1, near_singular=np.inf), "`near_singular` must be finite"),
        (
            lambda: ck.replace(ck.Law(ARM, XY, alpha=1), alpha=np.ones(3)),
            "`alpha` must be a single number or have 2 numbers",
        ),
        (lambda: qdot(ck.Law(ARM, XY, alpha=1), reference=ck.hold([1.0])), r"`reference` must give positions of 2"),
        (lambda: qdot(ck.Law(ARM, ck.position("xyz"), alpha=1), reference=REFERENCE), "of 3 coordinates"),
        (lambda: qdot(ck.Law(ARM, ck.orientation(), alpha=1), reference=REFERENCE), "`reference` must give a rotation"),
    ],
)
def test_bad_input(build, message):
    with pytest.raises(ck.ArgumentError, match=message) as caught:
        build()
    assert "\n" not in str(caught.value)


GANTRY = ck.from_screws([[0.0] * 3] * 3, np.eye(3), [0.0] * 3, kinds="PPP", velocity_limit=[1.0] * 3)


@pytest.mark.parametrize(
    ("arm", "task", "inverse"),
    [
        (GANTRY, "xy", ck.damped(0.1)),
        (GANTRY, "xy", ck.pseudoinverse()),
        (ck.panda(), "z", ck.singular_damped(0.1, 0.1)),
    ],
    ids=str,
)
def test_joints_that_a_task_does_not_see(arm, task, inverse):
    """Their columns of J are zeros: they stand still."""
    law, q = ck.Law(arm, ck.position(task), alpha=2.0, inverse=inverse), np.full(arm.n, 0.1, np.float32)
    qdot = ck.step(law, ck.hold([0.3] * len(task)), q, 0.0, 0.1, "EE").qdot
    moved = np.asarray(ck.jacobian(arm, q))[["xyz".index(c) for c in task]]
    unseen = ~np.any(np.abs(moved) > 1e-7, axis=0)
    assert unseen.any() and np.all(np.abs(qdot[unseen]) < 1e-6) and np.all(np.abs(qdot[~unseen]) > 1e-4)
