"""Sine and cosine against mpmath, in both precisions."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from cnclik.engine.sines import RANGE, sincos


def _angles(dtype, count=1500):
    """Random magnitudes, multiples of π/4 and their neighbours, the ends of the range, zeros."""
    rng = np.random.default_rng(0)
    spread = rng.choice([-1, 1], count) * 10 ** rng.uniform(-8, np.log10(RANGE), count)
    near = (np.arange(1, 12732, 61) * np.pi / 4).astype(dtype)
    edge = np.array([0.0, RANGE, -RANGE, np.pi, -np.pi / 2])
    near = np.concatenate([near, np.nextafter(near, dtype(0)), np.nextafter(near, dtype(1e9))])
    return np.concatenate([spread, near, edge]).astype(dtype)


def _ulps(found, exact):
    """Distance in units of the last place of the exact value's float."""
    return max(
        float(abs(mpmath.mpf(float(f)) - e) / mpmath.mpf(float(np.spacing(np.abs(f.dtype.type(float(e)))))))
        for f, e in zip(found, exact, strict=True)
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_within_two_ulp(dtype):
    angles = _angles(dtype)
    (sines,), (cosines,) = jax.jit(jax.vmap(lambda x: sincos((x,))))(angles)
    with mpmath.workdps(50):
        exact = [mpmath.mpf(float(x)) for x in angles]
        assert _ulps(np.asarray(sines), [mpmath.sin(x) for x in exact]) < 2
        assert _ulps(np.asarray(cosines), [mpmath.cos(x) for x in exact]) < 2


def test_beyond_the_range_the_library_answers():
    angles = jnp.array([1.0001e4, -3e7, 1e300, jnp.inf, jnp.nan, 0.5])
    (sines,), (cosines,) = jax.vmap(lambda x: sincos((x,)))(angles)
    np.testing.assert_allclose(sines, jnp.sin(angles), rtol=4e-16)
    np.testing.assert_allclose(cosines, jnp.cos(angles), rtol=4e-16)
    assert np.isnan(sines[3:5]).all()
