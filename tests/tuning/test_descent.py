"""Descent alone: targets whose minimum is known on paper."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from cnclik.record import record
from cnclik.tuning.descent import Bounds, descend


@record
class Bowl:
    """w·(x − centre)² with a·x ≤ b, not a number where x[0] > wall."""

    w: object
    centre: object
    a: object
    b: object
    wall: object

    def __call__(self, x):
        loss = jnp.sum(self.w * (x - self.centre) ** 2)
        return jnp.where(x[0] > self.wall, jnp.nan, loss), jnp.atleast_1d(self.a @ x - self.b), x


TARGETS = {  # w, centre, a, b, wall: minimum
    "free": ([1, 1], [1, 2], [0, 0], 1, 9, [1, 2]),
    "badly scaled": ([1, 1e4], [1, 2], [0, 0], 1, 9, [1, 2]),
    "constraint not met at the minimum": ([1, 2], [1, 2], [1, 1], 2, 9, [1 / 3, 5 / 3]),
    "constraint without a say": ([1, 2], [1, 2], [1, 1], 4, 9, [1, 2]),
    "bound of one number": ([1, 1], [1, 7], [0, 0], 1, 9, [1, 5]),
    "wall behind the minimum": ([1, 1], [2, 2], [0, 0], 1, 2.1, [2, 2]),
    "constraint in front of a wall": ([1, 1], [3, 0], [1, 0], 1.5, 1.6, [1.5, 0]),
}
SQUARE = Bounds(np.full(2, -5.0), np.full(2, 5.0))


def minimum(target, **options):
    w, centre, a, b, wall, _ = (np.asarray(v, float) for v in TARGETS[target])
    bowl = Bowl(w=w, centre=centre, a=a, b=b, wall=wall)
    with jax.enable_x64(True):
        best, count, status = descend(bowl, SQUARE, np.array([-2.0, -1.0]), **options)
    assert count <= options.get("steps", 100) and best.excess <= 1e-9
    np.testing.assert_array_equal(best.seen, SQUARE.values(best.u))
    return best, status


@pytest.mark.parametrize("target", TARGETS)
def test_minima_known_on_paper(target):
    best, status = minimum(target)
    w, centre, *_, wanted = map(np.asarray, TARGETS[target])
    assert best.loss == pytest.approx(np.sum(w * (wanted - centre) ** 2), rel=1e-2, abs=1e-8)  # a penalty spares 0.5 %
    np.testing.assert_allclose(best.u, wanted, atol=5e-2 if "constraint" in target else 1e-4)
    assert status == "converged"


def test_another_optimizer_progress_and_an_end():
    best, _ = minimum("free", optimizer=optax.adam(0.3))
    np.testing.assert_allclose(best.u, [1, 2], atol=1e-2)
    reports = []
    _, status = minimum("badly scaled", steps=5, progress=lambda *report: reports.append(report))
    assert status == "steps" and [report[:2] for report in reports] == [(k, 5) for k in range(3, 6)]
    assert reports[-1][2].startswith("loss ")


def test_bounds_are_reached_and_never_left():
    bounds = Bounds(np.array([1e-3, -1.0]), np.array([1e3, 1.0]))
    for some in ([1e-3, -1.0], [0.5, 0.3], [1e3, 1.0]):
        np.testing.assert_allclose(bounds.values(bounds.free(np.array(some))), some, rtol=1e-6)
    for far in (1.0, 50.0, 1e9):
        u = bounds.within(np.array([far, -far]))
        assert np.all(np.asarray(bounds.values(u)) <= bounds.upper * (1 + 1e-6)) and u[1] >= -1
