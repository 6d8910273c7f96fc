"""With x64 off, JAX's default, what advises gives the answers it gives with x64 on: it computes in float64 by itself.

Arguments lose digits where they are made in float32 (q, alpha, targets), so answers agree to 1e-4, not to rounding.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik import stability as st

FIVE = ck.planar_arm([1.0] * 5, clockwise=True)
TWO = ck.planar_arm([1.0, 1.0])
Q = {2: [0.3, 1.2], 5: [0.3, 0.5, -0.4, 0.6, 0.2]}
CASES = {
    "redundant position": (FIVE, ck.position("xy")),
    "redundant pose": (FIVE, ck.pose("xy", "z")),
    "position": (TWO, ck.position("xy")),
}
Ts = 0.1


def both(fn):
    """What fn(array maker) gives with x64 on and off."""
    made = []
    for wide in (True, False):
        with jax.enable_x64(wide):
            made.append(fn(jnp.asarray))
    return made


def loop(name, array):
    chain, task = CASES[name]
    return ck.Law(chain, task, alpha=array(5.0)), array(Q[chain.n])


@pytest.mark.parametrize(
    "name", [pytest.param("redundant position", marks=pytest.mark.slow), "redundant pose", "position"]
)
def test_advice_is_the_same(name):
    """The 5-dof arm was called stable to z = 0.34 in float32, where 2 is true."""

    def advice(array):
        law, q = loop(name, array)
        return st.analyse(law, None, q, Ts=Ts, method="EE")

    for found in both(advice):
        assert found.gains.z_largest == pytest.approx(2, rel=1e-6)
        assert found.times.largest == pytest.approx(0.4, rel=1e-6)
        assert found.gains.z_fastest == pytest.approx(1, abs=1e-4)
        assert found.margin.margin == pytest.approx(4, rel=1e-6)
        assert found.spectrum.radius == pytest.approx(0.5, abs=1e-6)
        np.testing.assert_allclose(found.spectrum.null, 1, atol=1e-9)


def test_joint_values_in_float32_with_x64_on():
    """Where x64 was on, arrays of float32 were taken as they came: stable to z = 0.70 in place of 2 on this arm."""
    law = ck.Law(ck.planar_arm([1.0, 0.5, 0.3]), ck.position("xy"), alpha=5.0)
    q = np.array([0.3, 0.8, 0.5], np.float32)
    found = st.recommend(law, None, q, Ts=0.01, method="EE")
    assert found.z_largest == pytest.approx(2, rel=1e-5)
    assert st.margin(law, None, q, Ts=0.01, method="EE").margin == pytest.approx(40, rel=1e-5)
    assert st.spectral_radius(law, None, q, 0.01, "EE") == pytest.approx(0.95, abs=1e-9)


def test_settling_and_what_follows():
    def follow(array):
        law, q = loop("redundant position", array)
        target = ck.hold(array(np.asarray(ck.forward(FIVE, q).position[:2]) + np.array([-0.1, 0.1])))
        rest = st.settle(law, target, q)
        made = st.recommend(law, target, rest, Ts=Ts, method="EE"), st.margin(law, target, rest, Ts=Ts, method="EE")
        return rest, made[0].z_largest, made[1].margin, st.spectral_radius(law, target, rest, Ts, method="EE")

    wide, narrow = both(follow)
    assert narrow[0].dtype == np.float64
    np.testing.assert_allclose(narrow[0], wide[0], atol=1e-4)
    np.testing.assert_allclose(narrow[1:], wide[1:], rtol=1e-5)
    np.testing.assert_allclose(narrow[1:], [2, 4, 0.5], rtol=1e-5)


def test_a_float32_run_at_rest_is_accepted():
    """Where a float32 loop comes to rest is a rounding or two from the target."""
    with jax.enable_x64(False):
        law, q = loop("redundant position", jnp.asarray)
        target = ck.hold(ck.forward(FIVE, q).position[:2] + jnp.array([-0.1, 0.1]))
        run = ck.solve(law, target, q, Ts, 60, method="EE")
        assert run.q.dtype == np.float32
        assert st.recommend(law, target, run.q[-1], Ts=Ts, method="EE").z_largest == pytest.approx(2, rel=1e-5)


def test_theory_is_the_same():
    for found in both(lambda _: st.real_axis_limits("IE", ck.chord(5))):
        assert found.stable == found.fastest == np.inf  # was 958697 in float32
    for found in both(lambda _: (st.stability_limit("IE", ck.picard(5)), st.delay_limit(2))):
        np.testing.assert_allclose(found, [1, 2 * np.sin(np.pi / 10)], rtol=1e-9)
    z = np.linspace(0.1, 3, 5)
    wide, narrow = both(lambda _: st.amplification("CN", ck.picard(5), z))
    np.testing.assert_array_equal(narrow, wide)


def test_maps_responses_and_attraction_are_the_same():
    def look(array):
        law, q = loop("position", array)
        target = ck.hold(array(np.asarray(ck.forward(TWO, q).position[:2]) + np.array([0.05, -0.08])))
        made = st.stability_map(
            law, target, q, alpha=np.array([4.0, 30.0]), Ts=np.array([0.05, 0.1]), N=40, method="EE"
        )
        step = st.responses(law, None, q, Ts=Ts, N=8, method="EE")
        certain = st.certified_radius(law, q, Ts=Ts)
        tried = st.sampled_attraction(law, q, radii=[0.01, 0.05], Ts=Ts, directions=4, N=40, method="EE")
        return made.ending.values, made.limit.values, step.response.values, certain, tried.converged.values

    for wide, narrow in zip(*both(look), strict=True):
        np.testing.assert_allclose(narrow, wide, rtol=1e-4, atol=1e-4)


def test_traced_it_keeps_the_callers_precision():
    with jax.enable_x64(False):
        law, q = loop("position", jnp.asarray)

        def radius(alpha):
            return st.spectral_radius(ck.replace(law, alpha=alpha), None, q, Ts, method="EE")

        value, slope = jax.jit(jax.value_and_grad(radius))(jnp.asarray(5.0))
    assert value.dtype == slope.dtype == np.float32
    assert value == pytest.approx(0.5, abs=1e-5) and slope == pytest.approx(-Ts, abs=1e-5)
