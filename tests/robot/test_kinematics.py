"""forward and jacobian as they are called: under jit and vmap, with numbers of any kind, in single precision.

Values are those of Pinocchio and MuJoCo in the tests of files.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from tests.oracles import close

PANDA = ck.panda()


def test_public_functions_under_jit_and_vmap():
    q = jnp.asarray(np.random.default_rng(5).uniform(-3, 3, (4, 7)))
    many = jax.jit(jax.vmap(functools.partial(ck.jacobian, PANDA)))(q)
    poses = jax.vmap(functools.partial(ck.forward, PANDA))(q)
    assert many.shape == (4, 6, 7) and poses.position.shape == (4, 3) and poses.rotation.shape == (4, 3, 3)
    for one, j, turn in zip(q, many, poses.rotation, strict=True):
        close(j, ck.jacobian(PANDA, one), atol=1e-14)
        close(turn, ck.forward(PANDA, one).rotation, atol=1e-14)


def test_kinds_of_joint_values_accepted():
    arm = ck.planar_arm([1.0, 1.0])
    wanted = ck.forward(arm, np.array([1.0, 2.0])).position
    for q in ([1, 2], (1.0, 2.0), np.array([1, 2]), jnp.array([1, 2]), [np.float32(1), 2], [jnp.asarray(1.0), 2]):
        found = ck.forward(arm, q).position
        assert found.dtype == jnp.float64
        np.testing.assert_array_equal(found, wanted)


def test_xla_gets_no_products_of_small_matrices():
    """It would call a library for each of them, for ten times the time of all frames."""
    traced = jax.make_jaxpr(functools.partial(ck.forward, PANDA))(jnp.zeros(7))
    assert "dot_general" not in str(traced)


def test_float32_on_a_long_chain():
    q = np.random.default_rng(6).uniform(-3, 3, 7).astype(np.float32)
    at, wanted = ck.forward(PANDA, q), ck.forward(PANDA, q.astype(float))
    assert at.position.dtype == at.rotation.dtype == jnp.float32
    close(at.position, wanted.position, atol=3e-6)
    close(ck.jacobian(PANDA, q), ck.jacobian(PANDA, q.astype(float)), atol=5e-6)
