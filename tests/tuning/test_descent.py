"""Descent alone: targets whose minimum is known on paper, in one compiled program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.record import record
from cnclik.tuning import parameters as pm
from cnclik.tuning.descent import Descent, descend

FLAT = pm.parameter("x", np.zeros(2), -5.0, 5.0, None)


@record
class Bowl:
    """w·(x − centre)² with a·x ≤ b, not a number where x[0] > wall."""

    parameters: tuple
    w: object
    centre: object
    a: object
    b: object
    wall: object

    def __call__(self, values):
        (x,) = values
        loss = jnp.sum(self.w * (x - self.centre) ** 2)
        return jnp.where(x[0] > self.wall, jnp.nan, loss), jnp.atleast_1d(self.a @ x - self.b)


TARGETS = {  # w, centre, a, b, wall: minimum
    "free": ([1, 1], [1, 2], [0, 0], 1, 9, [1, 2]),
    "badly scaled": ([1, 1e4], [1, 2], [0, 0], 1, 9, [1, 2]),
    "constraint not met at the minimum": ([1, 2], [1, 2], [1, 1], 2, 9, [1 / 3, 5 / 3]),  # multiplier 4/3
    "constraint without a say": ([1, 2], [1, 2], [1, 1], 4, 9, [1, 2]),
    "wall behind the minimum": ([1, 1], [2, 2], [0, 0], 1, 2.1, [2, 2]),
    "constraint in front of a wall": ([1, 1], [3, 0], [1, 0], 1.5, 1.6, [1.5, 0]),
}


def minimum(target, descent=Descent(), progress=None):
    made = [jnp.asarray(v, float) for v in TARGETS[target][:-1]]
    bowl = Bowl(parameters=(FLAT,), **dict(zip(("w", "centre", "a", "b", "wall"), made, strict=True)))
    u = jnp.asarray(pm.free(FLAT, np.array([-2.0, -1.0])), float)[None]
    done = descend(bowl, u, np.array([0.1]), constraints=1, descent=descent, progress=progress)
    return np.asarray(pm.bounded(FLAT, jnp.asarray(done.u[0]))), done


@pytest.mark.parametrize("target", TARGETS)
def test_minima_known_on_paper(target):
    x, done = minimum(target)
    np.testing.assert_allclose(x, TARGETS[target][-1], atol=2e-4)
    assert done.why == "converged" and np.isfinite(done.u).all()
    loss = done.history.loss[0]
    assert np.isfinite(loss[5:]).all() and loss.shape == done.history.accepted[0].shape


def test_reverse_mode_ends_where_forward_mode_does():
    x, _ = minimum("constraint not met at the minimum", descent=Descent(gradient="reverse"))
    np.testing.assert_allclose(x, [1 / 3, 5 / 3], atol=2e-4)


def test_in_float32_too():
    with jax.enable_x64(False):
        x, done = minimum("constraint not met at the minimum")
    assert done.u.dtype == np.float32
    np.testing.assert_allclose(x, [1 / 3, 5 / 3], atol=5e-3)


def test_progress_is_told_after_each_round():
    told = []
    minimum("constraint not met at the minimum", progress=lambda *report: told.append(report))
    assert [report[:2] for report in told][:2] == [(20, 100), (40, 100)]
    assert told[-1][2].startswith("loss ") and "constraints" in told[-1][2]


@pytest.mark.parametrize(
    "options, named",
    [({"steps": 1}, "steps"), ({"rounds": 0}, "rounds"), ({"starts": 0}, "starts"), ({"gradient": "up"}, "gradient")],
)
def test_what_does_not_fit_is_named(options, named):
    with pytest.raises(ck.ArgumentError, match=named):
        Descent(**options)
