"""Walls: the least behind them, what they miss where they contradict, by how much steps pass them, and derivatives."""

import functools
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.status import StepError, rounding_of
from cnclik.law.walls import Wall
from cnclik.record import record
from tests.bank import robot as robot_of
from tests.bank import screws
from tests.law.test_bounded import RATE, draws
from tests.refusals import refusals

ROOM = {"lower": [-1.0] * 3, "upper": [1.0] * 3, "velocity_limit": [5.0] * 3}
GANTRY = screws([[0.0] * 3] * 3, np.eye(3), [0.0] * 3, kinds="PPP", **ROOM)  # J = I


@record
class Given(Wall):
    """A wall whose row and distance are given."""

    gradient: Any
    h: Any

    def distance(self, robot):
        return self.h

    def row(self, robot):
        return self.gradient


def problems(name, count, seed, k=4, none=0.2):
    """Draws with k walls each, half of which touch a velocity within bounds; some no joint moves."""
    drawn, rng = draws(name, count, seed), np.random.default_rng(seed)
    rows = 0.4 * rng.normal(size=(count, k, drawn.low.shape[1])) * (rng.random((count, k, 1)) >= none)
    inner = np.clip(rng.normal(size=drawn.low.shape) * rng.uniform(0.1, 2, (count, 1)), drawn.low, drawn.high)
    room = np.where(rng.random((count, k)) < 0.5, 0.0, rng.exponential(1.0, (count, k)))
    floor = np.einsum("bkn,bn->bk", rows, inner) - room
    return drawn, rows, floor


def acts(damping, rows, velocity, low, high, walls, floor):
    """What `bounded` makes of it, at q = 0 of a chain whose velocities have these bounds."""
    far, rate, damping = map(jnp.asarray, (jnp.inf, RATE, damping))
    bounds = {"lower": low / RATE, "upper": high / RATE, "velocity_limit": far + 0 * low}
    chain = SimpleNamespace(bounded=True, slowed=True, **bounds)
    unused = {"task": None, "normal": 0.0, "offset": 0.0, "name": ""}
    made = [Given(gradient=walls[i], h=-floor[i] / rate, rate=rate, **unused) for i in range(len(walls))]
    limits = ck.bounded(rate, 100, made)
    return limits(damping**2, chain, jnp.zeros_like(low), rows, velocity, None)


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, 0))
@ck.native
def each(damping, of):
    made = acts(damping, *of)
    return made.qdot, made.walls, made.limited


def made_of(damping, drawn, walls, floor):
    of = (drawn.rows, drawn.velocity, drawn.low, drawn.high, walls, floor)
    return map(np.asarray, each(damping, of))


def check_least(name, damping, count, k, spared=0):
    """Compare with daqp's minimum; `spared` of the problems may need more than five descents."""
    daqp = pytest.importorskip("daqp")
    drawn, walls, floor = problems(name, count, seed=13, k=k)  # of which two take several descents
    qdot, room, _ = made_of(damping, drawn, walls, floor)
    assert np.all((qdot >= drawn.low) & (qdot <= drawn.high))
    off, missed = [], []
    for i in range(count):
        b, n = drawn.rows[i] / damping, len(drawn.low[i])
        upper, lower = np.r_[drawn.high[i], np.full(k, 1e30)], np.r_[drawn.low[i], floor[i]]
        h, f, sense = b.T @ b + np.eye(n), -b.T @ drawn.velocity[i] / damping, np.zeros(n + k, np.intc)
        found, _, flag, _ = daqp.solve(h, f, walls[i], upper, lower, sense, primal_tol=1e-10, dual_tol=1e-10)
        if flag == 1:
            off.append(np.abs(qdot[i] - found).max() / max(np.abs(found).max(), 1e-3))
            missed.append(-room[i].min())
    assert len(off) > 0.9 * count and max(np.sort([off, missed])[:, -1 - spared]) < 1e-6 and max(missed) < 1e-5
    return room


@pytest.mark.parametrize("damping", [0.05, 1e-3])
def test_it_is_the_least_behind_walls(damping):
    room = check_least("panda", damping, 100, 4)
    assert 0.1 < np.mean(np.abs(room) < 1e-9) < 0.9


def test_an_arm_at_rest_on_a_wall_has_arrived_in_float32(monkeypatch):
    """As users compile: large forces cancel but for roundings; one step in eighty was said not to have converged."""
    monkeypatch.setenv("CFLAGS", "-O2")
    arm = ck.replace(ck.planar_arm([0.5, 0.4, 0.3]), velocity_limit=(2.0,) * 3)
    limits = ck.bounded(walls=[ck.wall(ck.position("y"), above=0.2)])
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=ck.damped(0.02), limits=limits)
    q0, x = np.array([0.3, 0.9, -0.4], np.float32), np.linspace(-0.2, 0.8, 16).astype(np.float32)
    run = ck.lanes(lambda x: ck.solve(law, ck.hold((x, -0.3)), q0, 0.01, 200))(x)
    assert run.q.dtype == np.float32 and np.min(run.walls) > -1e-5
    assert not np.any(run.status & (ck.Status.NOT_CONVERGED | ck.Status.WALLS_CONTRADICT))


def test_a_wall_that_is_passed_and_that_no_joint_moves_changes_nothing():
    drawn, walls, floor = problems("panda", 100, seed=1)
    still, without = ~walls.any(axis=2), next(made_of(0.05, drawn, walls, floor))
    np.testing.assert_allclose(next(made_of(0.05, drawn, walls, floor + 0.1 * still)), without, atol=1e-9)


def inside(robot, q):
    """Distance from the tip to a sphere of 0.1 m around it."""
    return 0.1 - jnp.linalg.norm(ck.forward(robot, q).position)[None]


def passed(run, since):
    """(by how much the wall is passed from a step on, κ v² for its curvature κ there and the last speed)"""
    h = 0.1 - np.linalg.norm(run.x[since:], axis=1)
    return -np.min(h), np.linalg.norm(run.qdot[-1]) ** 2 / (0.1 - np.min(h))


def in_circles(rate, normal, Ts, method="EE"):
    """A run that is to go round in a circle of twice the radius, at 0.5 m/s on the wall; N is the same for any Ts."""
    wall = ck.wall(ck.function(inside, ["room"], ["m"]), above=0.0, rate=np.asarray(rate))  # one program for all
    law = ck.Law(GANTRY, ck.position(), alpha=20.0, inverse=ck.damped(1e-3), limits=ck.bounded(walls=[wall]))
    path = ck.circle([0.0, 0, 0], 0.2, period=2 * np.pi * 0.1 / 0.5, normal=normal)
    return ck.solve(law, path, np.array([0.05, 0.02, 0.01]), Ts, 2000, method)


@pytest.mark.parametrize(
    ("rate", "Ts", "normal"), [(10.0, 0.01, (0, 0, 1.0)), (10.0, 0.001, (0.3, 0.5, 1.0)), (90.0, 0.01, (0.3, 0.5, 1.0))]
)
def test_steps_pass_a_wall_by_the_formula(rate, Ts, normal):
    """A midpoint stays on its side: what bends away there and back cancels, to second order in Ts."""
    got, bend = passed(in_circles(rate, normal, Ts), 1000)
    np.testing.assert_allclose(got, bend * Ts / (2 * rate), rtol=2e-3)
    got, bend = passed(in_circles(rate, normal, Ts, "MIDPOINT"), 1000)
    np.testing.assert_allclose(-got, bend * Ts**2 / 8 / (1 - rate * Ts / 2), rtol=0.02)


def test_contradicting_walls_are_told_in_the_status():
    """Two walls of one coordinate share what they miss; of several coordinates a wall counts by its normal."""
    z = ck.position("z")
    walls = [ck.wall(z, above=0.1), ck.wall(z, below=-0.1), ck.wall(ck.position("x"), below=0.2)]
    walls += [ck.wall(ck.position(), normal=(0.6, 0.8, 0.0), below=0.3, rate=20.0)]
    law = ck.Law(GANTRY, ck.position(), alpha=5.0, inverse=ck.damped(0.01), limits=ck.bounded(walls=walls))
    run = ck.solve(law, ck.hold([0.4, 0.3, 0.0]), np.zeros(3), 0.01, 300, "EE")
    assert np.all(run.status & ck.Status.WALLS_CONTRADICT) and np.all(run.status & ck.Status.AT_LIMIT)
    missed = [-1.0, -1.0, 0.0, 0.0]  # half of 10/s times 0.2 m each; and the others hold
    np.testing.assert_allclose(run.walls[-1], missed, rtol=0.02, atol=1e-6)
    np.testing.assert_allclose(run.x[-1], [0.2, 0.225, 0.0], atol=1e-3)
    np.testing.assert_allclose(rounding_of(np.array([[0.0, 0.0], [3.0, -9.0]])), [[1e-4], [1e-3]])  # by speed
    with pytest.raises(StepError, match="WALLS_CONTRADICT: move apart the walls"):
        ck.require_ok(run, allow=ck.Status.AT_LIMIT)


@ck.native
def behind(walls, floor):
    """Velocities of four joints, of which a task has two, behind three walls."""
    return acts(0.05, jnp.eye(4)[:2], jnp.array([0.3, 0.2]), jnp.full(4, -5.0), jnp.full(4, 5.0), walls, floor).qdot


with_slopes = jax.jit(lambda *given: (behind(*given), *jax.jacrev(behind, (0, 1))(*given)))


def test_a_wall_that_holds_has_the_derivatives_of_an_equation():
    """∂(G q̇)/∂floor = 1: breaks where its softness enters them."""
    walls, floor = np.zeros((3, 4)), np.array([0.6, -1.0, -1.0])
    walls[0] = [1.0, 0.5, 0.2, 0.0]
    made, _, slope = with_slopes(walls, floor)
    np.testing.assert_allclose(walls[0] @ made, floor[0], rtol=1e-9)
    np.testing.assert_allclose(walls[0] @ slope, [1.0, 0.0, 0.0], atol=2e-6)


def test_walls_that_contradict_have_the_derivatives_of_their_shares():
    """Three walls around two joints that are in no task: least squares of the rows, each by its length."""
    given = np.array([[1.0, 0.2, 0.9], [-0.7, 1.1, 0.6], [-0.5, -0.8, 0.3]])  # rows and floors

    def shared(given):
        weighted = given / np.sqrt(np.sum(given[:, :2] ** 2, 1))[:, None]
        return np.linalg.lstsq(weighted[:, :2], weighted[:, 2])[0]

    made, by_walls, by_floor = with_slopes(np.pad(given[:, :2], ((0, 0), (2, 0))), given[:, 2])
    slope = np.concatenate([by_walls[2:, :, 2:], by_floor[2:, :, None]], axis=2)
    nudged = 1e-6 * np.eye(9).reshape(9, 3, 3)
    wanted = np.stack([shared(given + one) - shared(given - one) for one in nudged], 1) / 2e-6
    np.testing.assert_allclose(made[2:], shared(given), atol=1e-6)
    np.testing.assert_allclose(slope.reshape(2, 9), wanted, atol=2e-6)


def test_hands_stay_apart():
    """Two hands, told to meet: at rest what walls push and the task pulls is large beside the velocities."""
    robot, q0 = robot_of("two arms"), np.array([0.2, -0.4, 0.9, 0.5, -0.9, -0.8])
    one, other = (tip.name for tip in robot.tips)
    task = ck.stack(one=ck.position("xy", tip=one), other=ck.position("xy", tip=other), rest=ck.joints())
    walls = [ck.wall(ck.distance(ck.sphere(one, 0.08), ck.sphere(other, 0.08)), above=0.02)]
    law = ck.Law(
        robot,
        task,
        alpha={"one": 5.0, "other": 5.0, "rest": 1.0},
        inverse=ck.levels(["one", "other"], ["rest"], damping=(0.02, 0.5)),
        limits=ck.bounded(walls=walls),
    )
    middle = ck.hold([0.04, 2.14])
    run = ck.solve(law, ck.hold_at(robot, task, q0, one=middle, other=middle), q0, 0.01, 200, "EE")
    h = np.linalg.norm(run.x[:, :2] - run.x[:, 2:4], axis=1) - 0.18
    assert -1e-4 < h.min() < 1e-3 and abs(run.walls[-1, 0]) < 1e-6
    assert np.all(run.status[100:] == ck.Status.AT_LIMIT)


def limited(wall):
    return ck.Law(GANTRY, ck.position(), alpha=1.0, inverse=ck.damped(0.1), limits=ck.bounded(walls=[wall]))


test_what_does_not_fit_is_refused = refusals(
    (lambda: ck.wall(ck.position("z")), "`above` must be given, or `below`, but not both, but neither is."),
    (lambda: ck.wall(ck.position("z"), above=0.0, below=1.0), "but not both, but both are."),
    (lambda: ck.wall(ck.position(), above=0.0), "`normal` must be given for 3 coordinates"),
    (lambda: ck.wall(ck.pose(), above=0.0), "`task` must be of positions"),
    (lambda: ck.bounded(walls=ck.wall(ck.position("z"), above=0.0)), "`walls` must be a list"),
    (lambda: limited(ck.wall(ck.position("z", tip="elbow"), above=0.0)), "`tip` must"),
)
