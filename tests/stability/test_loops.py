"""What needs a robot: advice on a law's rates, the spectrum of its own step, and maps of whole loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive
from cnclik.stability import advise, amplification, gains, maps, plane, spectral_radius, stability_limit, stability_map
from cnclik.stability.maps import limit_table
from tests.refusals import refusals

PANDA = ck.panda()
Q = np.array([0.2, -0.785, 0.1, -2.2, 0.1, 1.6, 0.785])
PLANAR = ck.planar_arm([1.0, 1.0, 1.0])
QP = np.array([0.3, 0.9, -0.5])
Q2 = np.array([0.3, 0.9])


# --- advice ---------------------------------------------------------------------------------------------


def test_each_rate_of_a_law_is_beside_its_gains():
    tasks = ck.stack(hand=ck.position(), turn=ck.orientation(), rest=ck.joints())
    law = ck.Law(
        PANDA, tasks, alpha={"hand": 8.0, "turn": 80.0, "rest": 0.0},
        inverse=ck.levels(["hand"], ["turn"], ["rest"], damping=(1e-3, 0.02, 0.3)),
        limits=ck.bounded(rate=12.0, walls=[ck.wall(ck.position("z"), above=0.1, rate=5.0, name="table")]),
    )  # fmt: skip
    drive = Drive(delay=3)
    said = advise(law, Ts=0.01, drive=drive)
    assert [one.name for one in said.rates] == ["hand", "turn", "rest", "joint limits", "wall table"]
    assert said.gains.recommended == gains(Ts=0.01, drive=drive).recommended
    assert said.unstable == ("turn",) and said.above == ("turn", "joint limits")
    assert "turn: 80 1/s (z = 0.8), UNSTABLE" in str(said) and "rest: 0 asks for no motion" in str(said)
    euler = gains(Ts=0.01, drive=drive, method="EE")
    assert said.rates[-1].limits.recommended == euler.recommended  # walls act on velocities
    assert said.rates[0].response.alpha == 8.0 and said.rates[1].response is None


def test_a_gain_that_is_not_recommended_for_another_reason_than_dead_time():
    """Beyond 1/Ts a share of 0.7 does not overshoot; of a rebased servo no gain is recommended: "up to none 1/s"."""
    rebased = dict(command="position", feedback="rebased")
    servo = Drive(delay=4, natural_frequency=49.9, damping_ratio=0.2, **rebased)
    stiff = ck.replace(servo, natural_frequency=122.3, damping_ratio=0.037, delay=2)
    slow = Drive(lag=0.1, **rebased)
    cases = (120.0, slow, "up to 100 1/s"), (1.0, servo, "no gain: each"), (3.0, stiff, "no gain is stable")
    for alpha, drive, wanted in cases:
        said = str(advise(ck.Law(PANDA, ck.position(), alpha=alpha), Ts=0.01, drive=drive).rates[0])
        assert wanted in said and "overshoots with" not in said and "none" not in said


def test_a_posture_has_the_gains_of_a_task():
    law = ck.Law(PANDA, ck.position(), alpha=2.0, null_velocity=ck.posture(Q, 30.0))
    said = advise(law, Ts=0.01, drive=Drive(delay=3))
    assert said.above == ("posture",) and said.rates[1].rate == 30.0


def test_different_drives_and_different_gains_have_no_limit():
    """Recommended gains of two lags, tried at a posture where rows are nearly parallel: the true loop grows."""
    tasks = ck.stack(x=ck.position("x"), y=ck.position("y"))
    arm, drive = ck.planar_arm([1.0, 1.0]), Drive(delay=2, lag=[0.2, 0.02])
    with pytest.raises(ArgumentError, match="one gain for all"):
        advise(ck.Law(arm, tasks, alpha={"x": 1.147, "y": 0.014}), Ts=0.01, method="EE", drive=drive)
    law = ck.Law(arm, ck.position("xy"), alpha=np.array([1.147, 0.014]))
    assert np.isnan(stability_map(law, ck.hold([1.0, 1.0]), Q2, alpha=[1.0, 2.0], Ts=0.01, N=4, drive=drive).limit)
    said = advise(ck.Law(arm, tasks, alpha={"x": 1.0, "y": 1.0}), Ts=0.01, method="EE", drive=drive)
    assert said.gains.recommended == pytest.approx(
        gains(Ts=0.01, method="EE", drive=Drive(delay=2, lag=0.2)).recommended
    )


# --- the spectrum, and the gains as its bound -------------------------------------------------------------


@pytest.mark.parametrize("method", ["CN", "EXP-MIDPOINT"])
def test_with_an_exact_inverse_the_radius_is_that_of_the_method(method):
    """A posture, which rests elsewhere, moves nothing of the task."""
    law = ck.Law(PLANAR, ck.position("xy"), alpha=[40.0, 10.0], null_velocity=ck.posture(np.zeros(3), 5.0))
    for Ts in (0.01, 0.045):
        expected = np.abs(amplification(method, law.alpha * Ts, 5)).max()
        assert spectral_radius(law, None, QP, Ts, method, ck.picard(5)) == pytest.approx(expected, abs=1e-9)


def test_no_gain_below_the_limit_is_unstable_by_the_loops_own_step():
    tasks, levels = ck.stack(tip=ck.position("xy"), rest=ck.joints()), ck.levels(["tip"], ["rest"], damping=(1e-2, 0.1))
    law = ck.Law(PLANAR, tasks, alpha={"tip": 20.0, "rest": 9.0}, inverse=levels)
    Ts = 0.999 * stability_limit("IE", 1) / 20.0
    assert spectral_radius(law, None, QP, Ts, "IE", ck.picard(1)) < 1 + 1e-9


def test_it_is_differentiable_and_checks_rest():
    law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=20.0, inverse=ck.damped(0.3))
    of, step = jax.jit(jax.value_and_grad(lambda Ts: spectral_radius(law, None, jnp.asarray(Q2), Ts, "EE"))), 1e-6
    with jax.enable_x64(True):
        (before, _), (_, slope), (after, _) = (of(Ts) for Ts in (0.09 - step, 0.09, 0.09 + step))
    np.testing.assert_allclose(slope, (after - before) / (2 * step), rtol=1e-5)
    cases = ("q` must be at rest", ck.hold([1.0, 1.0]), Q2, 0.01), ("Ts` must be positive", None, Q2, 0.0)
    for says, *bad in (*cases, ("q` must be finite", None, np.inf * Q2, 0.01)):
        with pytest.raises(ArgumentError, match=says):
            spectral_radius(law, *bad, "EE")


# --- maps -----------------------------------------------------------------------------------------------


LAW = ck.Law(PLANAR, ck.position("xy"), alpha=5.0)
TARGET = ck.hold(np.asarray(ck.forward(PLANAR, QP).position)[:2] + np.array([0.05, -0.05]))


@pytest.mark.parametrize(("method", "drive"), [("EE", Drive()), ("EE", Drive(delay=2))])
def test_loops_end_as_the_gains_predict(method, drive, monkeypatch):
    monkeypatch.setattr(maps, "CHUNK", 16)  # of 36 loops: the last part of three is filled up
    alpha, Ts = np.geomspace(5.0, 80.0, 12), np.array([0.02, 0.05, 0.1])
    data = stability_map(LAW, TARGET, QP, alpha=alpha, Ts=Ts, method=method, drive=drive, N=400)
    assert data.ending.dims == ("Ts", "alpha") and data.limit.attrs["units"] == "1/s"
    z, limit = data.alpha.values, data.limit.values[:, None]
    np.testing.assert_allclose(data.limit, [gains(Ts=T, method=method, drive=drive).largest_stable for T in Ts])
    clear = np.abs(z / limit - 1) > 0.05
    assert ((data.ending.values <= 1) == (z < limit))[clear].all()


def test_passes_are_an_axis():
    z = np.linspace(0.1, 1.6, 16)
    data = stability_map(LAW, TARGET, QP, alpha=z / 0.1, Ts=0.1, M=[0, 1, 2, 5], method="CN", N=200)
    assert data.ending.dims == ("M", "alpha") and float(data.Ts) == 0.1
    np.testing.assert_allclose(data.limit * 0.1, [stability_limit("CN", M) for M in (0, 1, 2, 5)])
    clear = np.abs(z / (0.1 * data.limit.values[:, None]) - 1) > 0.05
    assert ((data.ending.values <= 1) == (z < 0.1 * data.limit.values[:, None]))[clear].all()
    solved = stability_map(LAW, TARGET, QP, alpha=[5.0, 9.0], Ts=0.1, M=[1, 5], method="IE", stage=ck.chord(1), N=200)
    assert (solved.limit == np.inf).all() and (solved.ending <= 1).all()  # of the stage's own iteration


def test_a_plane_has_regions_and_limits():
    data = plane(("EE", "IE"), (0, 5), points=21)
    assert list(data.stage.values) == ["", "picard(0)", "picard(5)", "exact"]
    assert data.region.dims == ("row", "im", "re") and limit_table(data)[0][0] == ["EE", "", "2.0000", "1.0000"]
    inside = np.abs(1 - (data.re.values + 1j * data.im.values[:, None])) <= 1 + 1e-6  # of a region in float32
    np.testing.assert_array_equal(data.region[0].values <= 1 + 1e-6, inside)
    with pytest.raises(ArgumentError, match="`points` must be at least 2"):
        plane(("EE",), (), points=1)
    with pytest.raises(ArgumentError, match="`methods` must hold a method"):
        plane((), ())


test_bad_maps_are_named = refusals(
    (dict(Ts=0.0), "`Ts` must be positive"),
    (dict(M=[1, 2], method="EE"), "`method` must be implicit where M is given"),
    (dict(M=[0.5], method="CN"), "`M` must be whole"),
    (dict(alpha=1.0), "hold several values"),
    (dict(N=2), "`N` must be at least 4"),
    (dict(alpha=[np.nan]), "`alpha` must be finite"),
    (dict(reference=ck.circle([0.4, 0, 0.5], 0.1, period=1.0)), "`reference` must be constant, .* but moves"),
    (dict(stage="picard"), "`stage` must be a stage such as picard"),
    (dict(alpha=[-5.0, 5.0]), "`alpha` must be at least 0"),
    (dict(alpha=[]), "`alpha` must hold numbers, but is empty"),
    of=lambda **change: stability_map(**(dict(law=LAW, reference=TARGET, q0=QP, alpha=[1.0, 2.0], Ts=0.1) | change)),
)
