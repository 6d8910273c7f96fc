"""Inverses against NumPy and the papers' formulas, near singularities too, with their derivatives; the error clamp."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.measure.metrics import chatter
from tests.bank import screws
from tests.oracles import close
from tests.refusals import refusals

LAMBDA, EPSILON = 0.2, 0.5
INVERSES = {
    "pseudoinverse": ck.pseudoinverse(),
    "damped": ck.damped(LAMBDA),
    "singular_damped": ck.singular_damped(LAMBDA, EPSILON),
    "error_damped": ck.error_damped(LAMBDA),
}
LEAST = (1.0, 0.45, 0.1, 1e-3, 1e-6, 0.0)


def matrices(m, n, seed=3):
    """Random J with a least singular value from 1 down to exactly 0, and one of lower rank still."""
    rng, out = np.random.default_rng(seed), []
    for least in LEAST:
        u, v = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (m, n))
        values = np.linspace(1.5, 1.0, min(m, n))
        values[-1] = least
        out.append(u[:, : len(values)] * values @ v[:, : len(values)].T)
    return np.array([*out, np.zeros((m, n))])


def applied(inverse, j, v):
    factored = inverse(j, v)
    return factored.apply(v), factored.least


apply = jax.jit(ck.native(applied))
every = jax.jit(jax.vmap(ck.native(lambda of, j, v: [applied(one, j, v) for one in of]), (None, 0, 0)))


def each(inverse, j, v):
    """By one program of all kinds for a shape and dtype."""
    kinds = [inverse if type(one) is type(inverse) else one for one in INVERSES.values()]
    return every(jax.tree.map(lambda v: np.asarray(v, j.dtype), kinds), j, v)[kinds.index(inverse)]


def formula(name, j, e):
    """λ² as the papers have it, by SVD."""
    least = np.linalg.svd(j, compute_uv=False)[-1]
    share = max(1 - (least / EPSILON) ** 2, 0)
    known = {"pseudoinverse": 0.0, "damped": LAMBDA**2, "singular_damped": LAMBDA**2 * share}
    return known.get(name, LAMBDA**2 + e @ e / 2)


@pytest.mark.parametrize("shape", [(3, 2), (6, 7)], ids=str)
@pytest.mark.parametrize("name", INVERSES)
def test_values_are_the_formulas(name, shape):
    """Of what some joints can do: next to a singularity the pseudoinverse damps the rest, and does not cut it off."""
    js, given = matrices(*shape), np.random.default_rng(4).normal(size=(7, shape[1]))
    t = np.einsum("kmn,kn->km", js, given)
    found, least = each(INVERSES[name], js, t)
    for j, v, qdot, estimate in zip(js, t, found, least, strict=True):
        smallest = np.linalg.svd(j, compute_uv=False)[-1]
        wanted = j.T @ np.linalg.pinv(j @ j.T + formula(name, j, v) * np.eye(shape[0]), rcond=1e-12) @ v
        if name != "pseudoinverse" or smallest > 1e-3 or smallest == 0:
            close(qdot, wanted, atol=1e-6)
        assert smallest * min(shape) ** -0.5 - 1e-6 <= estimate <= smallest + 1e-5  # whatever the damping


@pytest.mark.parametrize(("smallest", "error"), [(1e-2, 1e-13), (1e-4, 1e-10), (1e-5, 1e-6), (1e-6, 2e-3)])
def test_the_pseudoinverse_near_a_singularity(smallest, error):
    """It errs by (λ²/(σ² + λ²))², as its docstring says; in any direction not by more."""
    rng = np.random.default_rng(5)
    u, w = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (6, 7))
    a = u * np.array([1, 0.9, 0.8, 0.5, 0.3, smallest]) @ w[:6]
    j = np.linalg.pinv(a, rcond=1e-12)
    found = np.array(each(INVERSES["pseudoinverse"], np.stack([a] * 6), np.eye(6))[0]).T
    assert np.linalg.norm(found - j, 2) < error * np.linalg.norm(j, 2)
    assert smallest > 1e-3 or np.linalg.norm(found - j, 2) > error / 100 * np.linalg.norm(j, 2)


def test_derivatives_of_the_pseudoinverse_are_those_of_the_closed_form():
    """Golub & Pereyra 1973, eq. 4.12, at full rank; finite at a singularity, and second ones with them."""
    a, d = np.random.default_rng(1).normal(size=(2, 3, 4))
    v = np.array([1.0, -2.0, 0.5])
    p, j = np.linalg.pinv(a), lambda a: apply(ck.pseudoinverse(), a, v)[0]
    wanted = -p @ d @ p + p @ p.T @ d.T @ (np.eye(3) - a @ p) + (np.eye(4) - p @ a) @ d.T @ p.T @ p
    second = jax.jacfwd(lambda a: (jax.jacrev(j)(a),) * 2, has_aux=True)
    both = jax.jit(jax.vmap(lambda a: (jax.jacfwd(j)(a), second(a))))
    forward, (curvature, reverse) = both(np.stack([a, np.ones((3, 4)), np.zeros((3, 4))]))
    close(np.einsum("imn,mn->i", forward[0], d), wanted @ v, rtol=1e-8, atol=1e-9)
    close(reverse[0], forward[0], rtol=1e-8, atol=1e-8)
    assert np.isfinite(curvature[1:]).all()


def test_derivatives_are_finite_at_singularities_and_right_near_them():
    js, t = matrices(2, 3), np.array([0.4, -1.1])

    @ck.native
    def value(j):
        return jnp.stack([INVERSES[name](j, t).apply(t) for name in ("singular_damped", "error_damped")])

    forward, reverse = jax.jit(jax.vmap(lambda j: (jax.jacfwd(value)(j), jax.jacrev(value)(j))))(js)
    assert np.isfinite(forward).all()
    close(forward, reverse, atol=1e-6)
    values = jax.jit(jax.vmap(value))
    push = 1e-6 * np.eye(6).reshape(6, 2, 3)
    for k in (1, 2):  # σ = 0.45 and 0.1: within the threshold, away from 0
        ahead, behind = (values(js[k] + s * push) for s in (1, -1))
        close(np.moveaxis(np.reshape(forward[k], (2, 3, 6)), -1, 0), (ahead - behind) / 2e-6, atol=1e-5)


@pytest.mark.parametrize("dtype", [np.float64, np.float32], ids=["double", "single"])
def test_damping_below_rounding_is_no_division_by_zero(dtype):
    """As small as it may be, with J of any rank and joints that a limit has taken out: finite, and near J#."""
    eps, rng = np.finfo(dtype).eps, np.random.default_rng(1)
    j = np.concatenate([*(matrices(6, 7, seed) for seed in range(40)), rng.normal(size=(40, 6, 7))])
    j[np.arange(len(j)) % 3 == 0, :, :4] = 0.0  # rank 3
    t = np.einsum("kmn,kn->km", j, rng.normal(size=(len(j), 7)))  # within reach
    for inverse in (*map(ck.damped, (1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 1e-20)), ck.pseudoinverse()):
        q, least = each(inverse, j.astype(dtype), t.astype(dtype))
        assert q.dtype == dtype and np.isfinite(q).all() and np.isfinite(least).all()
        missed = np.linalg.norm(np.einsum("kmn,kn->km", j, q) - t, axis=1)
        # Directions that stay damped are those of σ² near the shift.
        damping = float(getattr(inverse, "damping", 0.0))
        assert np.all(missed <= 2 * max(damping, 20 * eps**0.5) * (1 + np.linalg.norm(t, axis=1)))


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_levels_below_rounding_leave_the_others_as_they_are(scale):
    """Also where the lower ones are in millimetres."""
    m = 9
    task = ck.stack(a=ck.joints(list("bcd")), b=ck.joints(list("bcdefghij")[: m - 3]))
    made = ck.levels(["a"], ["b"], damping=(1e-5, 0.1 * scale)).on(task)
    j, t = matrices(m, 7)[0], np.random.default_rng(5).normal(size=m)
    j[3:], t[3:] = scale * j[3:], scale * t[3:]
    narrow, _ = apply(jax.tree.map(np.float32, made), j.astype(np.float32), t.astype(np.float32))
    d = np.array([1e-10] * 3 + [0.01 * scale**2] * (m - 3))
    close(narrow, j.T @ np.linalg.solve(j @ j.T + np.diag(d), t), atol=3e-3)


test_parameters_are_checked = refusals(
    *((lambda bad=bad: ck.damped(bad), "`damping` must be") for bad in (0.0, -1, np.nan, "x", [0.1, 0.2])),
    (lambda: ck.singular_damped(0, 1), "`damping` must be"),
    (lambda: ck.singular_damped(1, -1), "`threshold` must be"),
)


def test_targets_out_of_reach_settle_with_the_clamp_and_shake_without():
    arm, late = ck.planar_arm([1.0, 1.0, 1.0]), {}
    for clamp in (None, (0.1, 0.5)):
        law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=ck.damped(0.05), error_clamp=clamp)
        run = ck.solve(law, ck.hold([3.0, 4.0]), np.array([0.3, -0.5, -0.6]), 0.01, 1500, "EE")
        late[clamp] = jax.jit(chatter)(run.qdot)
    # The bound of `clamped`: 0.05·0.1·c < 2·0.05² holds for c < 1, 0.05·2·c does not.
    assert late[(0.1, 0.5)] < 1e-6 < 1.0 < late[None]
    close(run.x[-1], [1.8, 2.4], atol=1e-2)  # stretched towards it


def test_the_clamp_shortens_metres_and_radians_of_a_part_separately():
    robot = screws(np.zeros((3, 3)), np.eye(3), [0.0, 0, 0], kinds="PRP")
    law = ck.Law(robot, ck.joints(), alpha=2.0, inverse=ck.pseudoinverse(), error_clamp=(0.1, 0.5))
    for aim, shortened in (([0.3, 2.0, 0.4], [0.06, 0.5, 0.08]), ([0.03, 2.0, 0.04], [0.03, 0.5, 0.04])):
        made = ck.step(law, ck.hold(values=aim), np.zeros(3), 0.0, 0.01, "EE")
        close(made.qdot, np.multiply(2.0, shortened), rtol=1e-6)
