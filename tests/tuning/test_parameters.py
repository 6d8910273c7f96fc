"""Parameters: where each goes, and that no number of an optimizer leads out of their bounds."""

import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.tuning import parameters as pm

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)


def test_every_parameter_goes_where_it_belongs():
    law = ck.replace(
        LAW, inverse=ck.damped(0.1), null_velocity=ck.posture([0.0, 1.0], rate=1.0), alpha=np.array([4.0, 6.0])
    )
    loop = pm.Adjustable(law=law, Ts=jnp.asarray(0.1))
    read = {
        "alpha": lambda made: made.law.alpha,
        "schedule": lambda made: made.schedule,
        "damping": lambda made: made.law.inverse.damping,
        "posture_rate": lambda made: made.law.null_velocity.rate,
        "feedforward": lambda made: made.law.feedforward,
        "links": lambda made: ck.forward(made.law.chain, np.zeros(2)).position[1] / 2,
        "tool": lambda made: jnp.asarray(made.law.chain.tip.position),
        "Ts": lambda made: made.Ts,
    }
    assert set(read) == set(pm.NAMES)
    for name, of in read.items():
        p = pm.named(name, loop)
        value = np.asarray(p.start) * 1.1 + (1e-3 if name == "tool" else 0.0)
        np.testing.assert_allclose(pm.bounded(p, jnp.asarray(pm.free(p, value))), value, rtol=1e-9)
        got = of(pm.put(loop, (p,), (jnp.asarray(value),)))
        np.testing.assert_allclose(got, 1.1 if name == "links" else value, rtol=1e-12, err_msg=name)


def test_scaled_links_are_longer_links():
    q, f = np.array([0.3, -0.7]), np.array([1.0, 1.02, 0.97])
    scaled = ck.forward(pm.scaled_links(ARM, f), q).position
    np.testing.assert_allclose(scaled, ck.forward(ck.planar_arm(f[1:], clockwise=True), q).position, rtol=1e-14)


@pytest.mark.parametrize("far", [0.0, 3.0, 50.0, 1e3, 1e9])
def test_values_never_leave_their_bounds(far):
    rng = np.random.default_rng(2)
    p = pm.parameter("k", np.array([1.0, 2.0]), 0.5, 20.0, None)
    np.testing.assert_allclose(pm.bounded(p, jnp.asarray(pm.free(p, p.start))), p.start, rtol=1e-9)
    value = np.asarray(pm.bounded(p, jnp.asarray(rng.normal(size=pm.size(p)) * far)))
    assert np.all(value >= 0.5 - 1e-9) and np.all(value <= 20 + 1e-9)
