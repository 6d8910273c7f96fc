"""Damped inverses near singularities against formulas in NumPy, with derivatives that stay finite."""

import jax
import numpy as np
import pytest

import cnclik as ck

LAMBDA, EPSILON = 0.2, 0.5
RNG = np.random.default_rng(3)


def matrices(m, n):
    """Random J with a least singular value from 1 down to exactly 0, and one of lower rank still."""
    out = []
    for least in (1.0, 0.45, 0.1, 1e-3, 1e-6, 0.0):
        u, _ = np.linalg.qr(RNG.normal(size=(m, m)))
        v, _ = np.linalg.qr(RNG.normal(size=(n, n)))
        values = np.linspace(1.5, 1.0, min(m, n))
        values[-1] = least
        out.append(u[:, : len(values)] * values @ v[:, : len(values)].T)
    out.append(np.zeros((m, n)))
    return np.array(out)


def formula(name, j):
    """λ² as the papers have it, by SVD."""
    s = np.linalg.svd(j, compute_uv=False)
    if name == "damped":
        return LAMBDA**2
    return LAMBDA**2 * max(1 - (s[-1] / EPSILON) ** 2, 0)


INVERSES = {
    "damped": ck.damped(LAMBDA),
    "singular_damped": ck.singular_damped(LAMBDA, EPSILON),
}


def applied(inverse, j, t):
    rows = j
    made = inverse(rows)
    return made.apply(t), made.least


@pytest.mark.parametrize(
    ("shape", "name"),
    [
        ((3, 2), "damped"),
        *((shape, "singular_damped") for shape in ((2, 3), (3, 2), (6, 7))),
    ],
)
def test_values_are_the_formulas(name, shape):
    js, t = matrices(*shape), RNG.normal(size=shape[0])
    found, least = jax.jit(jax.vmap(lambda j: applied(INVERSES[name], j, t)))(js)
    for j, qdot, estimate in zip(js, found, least, strict=True):
        expected = j.T @ np.linalg.pinv(j @ j.T + formula(name, j) * np.eye(shape[0])) @ t
        np.testing.assert_allclose(qdot, expected, atol=1e-6)
        smallest = np.linalg.svd(j, compute_uv=False)[-1]
        if name == "singular_damped" and smallest < EPSILON:  # its damping hangs on the estimate
            np.testing.assert_allclose(estimate, smallest, atol=1e-7)


@pytest.mark.parametrize("name", INVERSES)
def test_derivatives_are_finite_at_singularities_and_right_near_them(name):
    js, t = matrices(2, 3), RNG.normal(size=2)
    fn = lambda j: applied(INVERSES[name], j, t)[0]  # noqa: E731
    value = jax.jit(fn)
    forward, reverse = jax.jit(jax.vmap(lambda j: (jax.jacfwd(fn)(j), jax.jacrev(fn)(j))))(js)
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(forward, reverse, atol=1e-6)
    for k in (1, 2):  # σ = 0.45 and 0.1: inside both thresholds, away from σ = 0
        step = 1e-6
        for i, l in np.ndindex(2, 3):
            push = np.zeros((2, 3))
            push[i, l] = step
            difference = (value(js[k] + push) - value(js[k] - push)) / (2 * step)
            np.testing.assert_allclose(forward[k][:, i, l], difference, atol=1e-5)


def test_parameters_are_checked():
    for pair, told in (((0, 1), "damping"), ((1, -1), "threshold")):
        with pytest.raises(ck.ArgumentError, match=told):
            ck.singular_damped(*pair)


def test_targets_out_of_reach_settle_with_the_clamp_and_shake_without():
    from cnclik.measure.metrics import chatter

    arm = ck.planar_arm([1.0, 1.0, 1.0])
    q0 = np.array([0.3, -0.5, -0.6])
    late = {}
    for clamp in (None, (0.1, 0.5)):
        law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=ck.damped(0.05), error_clamp=clamp)
        run = ck.solve(law, ck.hold([3.0, 4.0]), q0, 0.01, 1500)
        late[clamp] = chatter(run.qdot)
    # The bound of `clamped`: 0.05·0.1·c < 2·0.05² holds for c < 1, 0.05·2·c does not.
    assert late[(0.1, 0.5)] < 1e-6 < 1.0 < late[None]
    np.testing.assert_allclose(run.x[-1], [1.8, 2.4], atol=1e-2)  # stretched towards it


def test_the_clamp_shortens_metres_and_radians_of_a_part_separately():
    robot = ck.from_screws(np.zeros((3, 3)), np.eye(3), [0.0, 0, 0], kinds="PRP")
    law = ck.Law(robot, ck.joints(), alpha=2.0, inverse=ck.pseudoinverse(), error_clamp=(0.1, 0.5))
    for aim, shortened in (([0.3, 2.0, 0.4], [0.06, 0.5, 0.08]), ([0.03, 2.0, 0.04], [0.03, 0.5, 0.04])):
        made = ck.step(law, ck.hold(values=aim), np.zeros(3), 0.0, 0.01, "EE")
        np.testing.assert_allclose(made.qdot, np.multiply(2.0, shortened), rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, np.float32], ids=["double", "single"])
def test_damping_below_rounding_is_no_division_by_zero(dtype):
    """As small as it may be, with J of any rank and joints that a limit has taken out: finite, and near J#."""
    eps = np.finfo(dtype).eps

    @jax.jit
    @jax.vmap
    def act(j, t, damping):
        rows = j
        made = ck.damped(damping)(rows)
        return made.apply(t), made.least

    draw = np.random.default_rng(1)
    j = np.concatenate([np.concatenate([matrices(6, 7) for _ in range(40)]), draw.normal(size=(40, 6, 7))])
    j[np.arange(len(j)) % 3 == 0, :, :4] = 0.0  # rank 3
    t = np.einsum("kmn,kn->km", j, draw.normal(size=(len(j), 7)))  # within reach
    for damping in (1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 1e-20):
        q, least = act(*(np.asarray(v, dtype) for v in (j, t, np.full(len(j), damping))))
        assert q.dtype == dtype and np.isfinite(q).all() and np.isfinite(least).all()
        missed = np.linalg.norm(np.einsum("kmn,kn->km", j, q) - t, axis=1)
        # Directions that stay damped are those of σ² near the shift.
        assert np.all(missed <= 2 * max(damping, 20 * eps**0.5) * (1 + np.linalg.norm(t, axis=1)))
