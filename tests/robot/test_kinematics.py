"""Pose and Jacobian against Pinocchio on random chains."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Joint, assemble
from cnclik.robot.fixed import Offset
from tests.oracles import close, pinocchio_pose_and_jacobian, transform


def random_robot(kinds, seed):
    """Joints (kind, axis, origin) with random axes and offsets, and a tip."""
    rng = np.random.default_rng(seed)

    def anywhere():
        return transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-1, 1, 3))

    axes = rng.normal(size=(len(kinds), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    axes[0] = np.eye(3)[seed % 3]  # one axis that folds
    return [(kind, axis, anywhere()) for kind, axis in zip(kinds, axes, strict=True)], anywhere()


def build(joints, tip, form):
    """The same robot as a Chain; `form` makes a tuple of floats (literal) or of array entries (leaves)."""
    kind = {"R": REVOLUTE, "P": PRISMATIC}

    def offset(t):
        return Offset(position=form(t[:3, 3]), rotation=tuple(form(row) for row in t[:3, :3]))

    return assemble(
        [
            Joint(kind=kind[k], axis=form(axis), origin=offset(origin), coordinate=i)
            for i, (k, axis, origin) in enumerate(joints)
        ],
        offset(tip),
    )


def literal(v):
    return tuple(float(x) for x in v)


def leaf(v):
    return tuple(jnp.asarray(v)[i] for i in range(len(v)))


@pytest.mark.parametrize(
    ("kinds", "form"), [("R", literal), ("P", literal), ("RPRRPRR", literal), ("RPRRPRR", leaf), ("RRRRRRR", leaf)]
)
def test_against_pinocchio(kinds, form):
    for seed in range(1 if form is literal else 5):  # leaves: five robots, one program
        joints, tip = random_robot(kinds, seed)
        chain = build(joints, tip, form)
        for q in np.random.default_rng(seed).uniform(-4, 4, (5, len(kinds))):
            wanted, jacobian = pinocchio_pose_and_jacobian(joints, tip, q)
            found = ck.forward(chain, q)
            close(found.position, wanted[:3, 3], atol=1e-12)
            close(found.rotation, wanted[:3, :3], atol=1e-12)
            close(ck.jacobian(chain, q), jacobian, atol=1e-12)


@functools.cache
def mixed():
    return build(*random_robot("RPRRPRR", 11), literal)


def test_public_functions_under_jit_and_vmap():
    chain, q = mixed(), jnp.asarray(np.random.default_rng(5).uniform(-3, 3, (4, 7)))
    many = jax.jit(jax.vmap(functools.partial(ck.jacobian, chain)))(q)
    assert many.shape == (4, 6, 7)
    for one, j in zip(q, many, strict=True):
        close(j, ck.jacobian(chain, one), atol=1e-14)
    poses = jax.vmap(functools.partial(ck.forward, chain))(q)
    assert poses.position.shape == (4, 3) and poses.rotation.shape == (4, 3, 3)
    close(poses.rotation[2], ck.forward(chain, q[2]).rotation, atol=1e-14)


def test_kinds_of_joint_values_accepted():
    arm = ck.planar_arm([1.0, 1.0])
    wanted = ck.forward(arm, np.array([1.0, 2.0])).position
    for q in ([1, 2], (1.0, 2.0), np.array([1, 2]), jnp.array([1, 2]), [np.float32(1), 2], [jnp.asarray(1.0), 2]):
        found = ck.forward(arm, q).position
        assert found.dtype == jnp.float64
        np.testing.assert_array_equal(found, wanted)
    single = ck.forward(arm, np.array([1, 2], np.float32))
    assert single.position.dtype == single.rotation.dtype == jnp.float32
    close(single.position, wanted, atol=3e-7)


def test_xla_gets_no_products_of_small_matrices():
    """It would call a library for each of them, for ten times the time of all frames."""
    traced = jax.make_jaxpr(functools.partial(ck.forward, ck.panda()))(jnp.zeros(7))
    assert "dot_general" not in str(traced)


def test_float32_on_a_long_chain():
    chain, q = mixed(), np.random.default_rng(6).uniform(-3, 3, 7)
    joints, tip = random_robot("RPRRPRR", 11)
    wanted, jacobian = pinocchio_pose_and_jacobian(joints, tip, q.astype(np.float32).astype(float))
    close(ck.forward(chain, q.astype(np.float32)).position, wanted[:3, 3], atol=3e-6)
    close(ck.jacobian(chain, q.astype(np.float32)), jacobian, atol=5e-6)
