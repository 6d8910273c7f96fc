"""The whole loop's one-step map at rest against linear theory, direction by direction."""

import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.hints import equations
from cnclik.record import replace
from cnclik.stability import linear
from cnclik.stability.advice import advise
from cnclik.stability.recommend import analyse, margin, recommend
from cnclik.stability.spectrum import at_rest, one_step, settle, spectral_radius, spectrum

ARM = ck.planar_arm([1.0] * 3)
Q = jnp.array([0.3, 0.9, -0.5])
XY = ck.position("xy")
SIGMA = np.linalg.svd(np.asarray(ck.jacobian(ARM, Q))[:2])[1]
Ts = 0.1


def law(**changes):
    return ck.Law(ARM, XY, **({"alpha": 6.0} | changes))


@pytest.mark.parametrize(
    ("method", "stage"),
    [(ck.IE, ck.picard(3)), (ck.TRAPEZOID, ck.chord(2)), (ck.CN, ck.newton(1))],
    ids=str,
)
def test_exact_inverse_amplifies_the_task_by_R_and_the_null_space_by_one(method, stage):
    found = spectrum(law(), None, Q, Ts, method, stage)
    np.testing.assert_allclose(found.task, linear.amplification(method, stage, 0.6), atol=1e-9)
    np.testing.assert_allclose(found.null, 1, atol=1e-12)
    assert found.coupling < 1e-9 and found.lost == 0


def test_maps_of_many_gains_factor_one_jacobian():
    pose = ck.Law(ck.planar_arm([1.0] * 4), ck.pose("xy", "z"), alpha=6.0)
    q = np.array([0.3, 0.9, -0.5, 0.4])
    changed, held = at_rest(pose, None, q)

    def one(gain):
        return one_step(replace(changed, alpha=gain), held, q, Ts, ck.CN, ck.chord(2))

    traced = jax.make_jaxpr(jax.vmap(one))(np.linspace(1, 9, 5)).jaxpr
    factored = [e.invars[0].aval.shape for e in equations(traced) if e.primitive.name == "cholesky"]
    assert factored and set(factored) == {(3, 3)}


def test_damping_slows_each_singular_direction_by_itself():
    damping = 0.7
    z = 0.6 * SIGMA**2 / (SIGMA**2 + damping**2)
    found = spectrum(law(inverse=ck.damped(damping)), None, Q, Ts, ck.IE, ck.picard(4))
    expected = linear.amplification(ck.IE, ck.picard(4), z)
    np.testing.assert_allclose(np.sort(found.task.real), np.sort(expected), atol=1e-9)


def test_transpose_is_stable_below_two_over_sigma_max_squared():
    found = recommend(law(inverse=ck.transpose()), None, Q, Ts=Ts, method="EE")
    assert found.largest * Ts == pytest.approx(2 / SIGMA[0] ** 2, rel=1e-6)


def test_recommended_gain_of_the_damped_inverse():
    found = recommend(law(inverse=ck.damped(0.7)), None, Q, Ts=Ts, method="EE")
    factors = SIGMA**2 / (SIGMA**2 + 0.7**2)
    assert found.z_largest == pytest.approx(2 / factors[0], rel=1e-6)
    assert found.z_fastest == pytest.approx(2 / (factors[0] + factors[1]), rel=1e-3)  # both as far from 0
    assert "changes sign" in found.limit


def test_recommended_sampling_time_and_margin():
    found = recommend(law(), None, Q, method=ck.IE, stage=ck.picard(5))
    assert found.name == "Ts" and found.largest == pytest.approx(1 / 6, rel=1e-6)
    now = margin(law(), None, Q, Ts=Ts, method=ck.IE, stage=ck.picard(5))
    assert now.margin == pytest.approx(1 / 0.6, rel=1e-6)
    assert now.radius == pytest.approx(abs(linear.amplification(ck.IE, ck.picard(5), 0.6)), abs=1e-9)
    assert recommend(law(), None, Q, Ts=Ts, method=ck.IE, stage=ck.chord(2)).largest == np.inf


def test_advice_is_what_its_parts_say():
    advice = analyse(law(), None, Q, Ts=Ts, method=ck.IE, stage=ck.picard(5))
    assert str(advice.gains) == str(recommend(law(), None, Q, Ts=Ts, method=ck.IE, stage=ck.picard(5)))
    assert advice.times.largest == pytest.approx(1 / 6, rel=1e-6)
    assert advice.margin.margin == pytest.approx(1 / 0.6, rel=1e-6)
    assert advice.spectrum.radius == advice.margin.radius and len(advice.spectrum.null) == 1


def test_a_loop_that_rests_only_nearly_is_judged_at_rest():
    """A few 1e-6 m of error move null-space eigenvalues by as much from 1, which is no instability."""
    near = ck.hold(np.asarray(ck.forward(ARM, Q).position[:2]) + 4e-6)
    assert recommend(law(), near, Q, Ts=Ts, method="EE").z_largest == pytest.approx(2, rel=1e-6)


def test_rotating_gain_is_limited_where_its_complex_eigenvalues_leave_the_region():
    """K = a (1 ± 2i): EE is stable while |1 − Ts a (1 + 2i)| ≤ 1, that is Ts a ≤ 2/5."""
    found = recommend(law(alpha=jnp.array([[3.0, 6.0], [-6.0, 3.0]])), None, Q, Ts=Ts, method="EE")
    np.testing.assert_allclose(found.largest, np.array([[4.0, 8.0], [-8.0, 4.0]]), rtol=1e-6)
    assert "turns" in found.limit


def test_null_space_velocity_is_a_limit_of_its_own():
    """q̇₀ = κ (q* − q) moves the null space by 1 − κ Ts, whatever the task's gain: κ Ts < 2 limits Ts."""
    own = law(alpha=6.0, null_velocity=lambda q: 15.0 * (Q - q))
    assert spectrum(own, None, Q, Ts, method="EE").null == pytest.approx([1 - 15 * Ts], abs=1e-9)
    found = recommend(own, None, Q, method="EE")
    assert found.largest == pytest.approx(2 / 15, rel=1e-6)
    assert "null-space" in found.limit


def test_radius_is_differentiable_in_the_gain():
    def radius(alpha):
        return spectral_radius(law(alpha=alpha), None, Q, Ts, ck.IE, ck.picard(2))

    value, slope = jax.jit(jax.value_and_grad(radius))(jnp.asarray(6.0))
    assert value == pytest.approx(abs(linear.amplification(ck.IE, ck.picard(2), 0.6)), abs=1e-9)
    z = 0.6  # R = Σ_{j=0}^{3} (−z)^j
    assert slope == pytest.approx(Ts * sum(j * (-1) ** j * z ** (j - 1) for j in range(1, 4)), abs=1e-9)


def test_a_loop_that_is_not_at_rest_is_refused_and_settle_finds_rest():
    target = ck.hold(ck.forward(ARM, Q).position[:2] + 0.2)
    with pytest.raises(ck.ArgumentError, match="`q` must be at rest"):
        spectrum(law(), target, Q, Ts, method="EE")
    rest = settle(law(), target, Q)
    assert spectrum(law(), target, rest, Ts, method="EE").radius == pytest.approx(0.4, abs=1e-6)
    with pytest.raises(ck.ArgumentError, match="`target` must be one the loop comes to rest on"):
        settle(law(), ck.hold([9.0, 0.0]), Q)


@pytest.mark.parametrize("one", [1, np.float32(1)])
def test_a_sampling_time_may_be_any_number(one):
    assert spectral_radius(law(alpha=0.5), None, Q, one, "EE") == pytest.approx(0.5)
    assert spectrum(law(alpha=0.5), None, Q, one, "EE").radius == pytest.approx(0.5)


@pytest.mark.parametrize("wrong", [0, -0.1, np.nan, 1j, "x", None, [1, 2]])
@pytest.mark.parametrize("asked", [spectral_radius, spectrum])
def test_a_sampling_time_that_is_none_is_refused(asked, wrong):
    with pytest.raises(ck.ArgumentError, match="`Ts` must be"):
        asked(law(), None, Q, wrong, "EE")


# --- a null-space velocity that moves the arm, or is unstable by itself -----------------------------------

FOUR = ck.planar_arm([1.0, 0.8, 0.6, 0.5])
ON_THE_WAY = jnp.array([-0.4, 0.9, -1.2, 0.3])  # manipulability grows from here on
NULL = {
    "posture": ck.posture(np.zeros(4), 3.0),
    "manipulability": ck.maximize_manipulability(FOUR, XY, 5.0),
    "constant": np.array([1.0, -2.0, 3.0, 0.5]),
    "function": lambda q: jnp.sin(3 * q[::-1]),
}


def on_the_way(null, **changes):
    return ck.Law(FOUR, XY, **({"alpha": 6.0, "null_velocity": null} | changes))


KEPT = {"free": None, "scaled": ck.velocity_scaling(), "saturated": ck.saturation()}
QUICK = {("posture", "free"), ("constant", "free")}


@pytest.mark.parametrize(
    ("null", "limits"),
    [
        pytest.param(null, limits, marks=[] if (null, limits) in QUICK else pytest.mark.slow)
        for null, limits in itertools.product(NULL, KEPT)
    ],
)
def test_gains_are_safe_on_the_way_to_another_posture_as_at_its_end(null, limits):
    """Moving through the null space changes nothing of the error, which an exact J# multiplies by 1 − z."""
    fast = ck.replace(FOUR, velocity_limit=(0.5,) * 4)
    made = ck.replace(on_the_way(NULL[null]), chain=fast, limits=KEPT[limits])
    found = recommend(made, None, ON_THE_WAY, Ts=Ts, method="EE")
    assert found.z_largest == pytest.approx(2, rel=1e-6) and found.z_recommended == pytest.approx(0.25, rel=1e-3)
    assert found.limit.startswith("limited by EE")
    assert margin(made, None, ON_THE_WAY, Ts=Ts, method="EE").margin == pytest.approx(2 / 0.6, rel=1e-6)
    now = spectrum(made, None, ON_THE_WAY, Ts, "EE")
    np.testing.assert_allclose(now.task, 0.4, atol=1e-6)
    assert now.coupling < 1e-6
    assert spectral_radius(made, None, ON_THE_WAY, Ts, "EE") == pytest.approx(0.4, abs=1e-6)
    assert jax.jit(lambda q: spectral_radius(made, None, q, Ts, "EE"))(ON_THE_WAY) == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize("drive", [ck.Drive(), ck.Drive(delay=2), ck.Drive(lag=np.array([0.1, 0.1, 0.1, 0.2]))])
def test_a_posture_that_is_left_by_itself_limits_no_gain(drive):
    """The step shows it: whatever the gain, its null space grows by more than any rounding, and doesn't swing."""
    made = on_the_way(NULL["manipulability"])
    away = next(q for q in np.random.default_rng(0).uniform(-2, 2, (20, 4)) if _growth(made, q) > 1.05)
    calm = recommend(on_the_way(None), None, away, Ts=Ts, method="EE", drive=drive)
    found = recommend(made, None, away, Ts=Ts, method="EE", drive=drive)
    assert found.z_largest == pytest.approx(calm.z_largest, rel=1e-3) and calm.z_largest > 0.1
    assert found.z_recommended == pytest.approx(calm.z_recommended, rel=1e-3)
    said = advise(made, None, away, Ts=Ts, method="EE", drive=drive).notes
    assert any("drifts away from this posture" in note for note in said)
    assert not any("leaves" in note for note in advise(on_the_way(None), None, away, Ts=Ts, drive=drive).notes)


def _growth(made, q):
    return spectrum(made, None, q, Ts, "EE").null.real.max()


def test_dead_time_that_is_tolerated_is_that_of_the_null_space_too():
    """κ Ts = 2 sin(π/(2(2d + 1))) at the largest d; a run with a sample more than that leaves its posture."""
    pulled = ck.Law(ARM, XY, alpha=6.0, null_velocity=ck.posture(Q, 2.0))
    said = advise(pulled, None, Q, Ts=Ts, method="EE", drive=ck.Drive(delay=5))
    most = np.pi / (4 * np.arcsin(2.0 * Ts / 2)) - 0.5 - 5
    assert said.recommended.delay_margin == pytest.approx(most, rel=1e-2)
    calm = advise(ck.replace(pulled, null_velocity=None), None, Q, Ts=Ts, method="EE", drive=ck.Drive(delay=5))
    assert calm.recommended.delay_margin > 5 * most


def test_no_gain_is_advised_for_a_null_space_that_assumed_drives_make_unstable():
    """It was advised, and the arm swung away; known drives of the same kind were refused, by "1 each step"."""
    drives = ck.Drive(delay=0.03 / 0.01, lag=0.1)
    pulled = ck.Law(ARM, XY, alpha=6.0, null_velocity=ck.posture(Q, 60.0))
    with pytest.raises(
        ck.ArgumentError, match=r"`null_velocity` must be stable on drives with 30 ms .* by 1\.0\d+ each"
    ):
        advise(pulled, None, Q, Ts=0.01, method="EE")
    with pytest.raises(
        ck.ArgumentError, match=r"through dead time and drive the null-space .* a motion by 1\.0\d+ each"
    ):
        advise(pulled, None, Q, Ts=0.01, method="EE", drive=drives)
    assert advise(pulled, None, Q, Ts=0.01, method="EE", drive=ck.Drive()).recommended_alpha == pytest.approx(25)


@pytest.mark.parametrize(("method", "drive"), [("EE", ck.Drive()), ("EXP-MIDPOINT", ck.Drive(delay=2))], ids=str)
def test_no_gain_is_stable_with_a_null_space_velocity_that_is_not(method, drive):
    """1 − κ Ts = −1.5, and of two stages 1 − 2.5 + 2.5²/2: positive, and as wrong."""
    made = ck.Law(ARM, XY, alpha=6.0, null_velocity=lambda q: 25.0 * (Q - q))
    found = recommend(made, None, Q, Ts=Ts, method=method, drive=drive)
    assert found.largest == found.recommended == found.monotone == found.fastest == found.z_largest == 0
    factor = {"EE": "1.5", "EXP-MIDPOINT": "1.625"}[method]
    assert f"none is stable: the null-space velocity multiplies a motion by {factor} each step" in found.limit
    assert margin(made, None, Q, Ts=Ts, method=method, drive=drive).margin == 0
    with pytest.raises(ck.ArgumentError, match="`null_velocity` must leave some gain stable"):
        advise(made, None, Q, Ts=Ts, method=method, drive=drive)


def test_a_null_space_velocity_that_is_not_finite_is_named():
    with pytest.raises(ck.ArgumentError, match="`null_velocity` must give a finite velocity at q, but is") as caught:
        recommend(law(null_velocity=lambda q: jnp.nan * q), None, Q, Ts=Ts, method="EE")
    assert "\n" not in str(caught.value)


def test_factors_that_meet_at_one_are_no_instability():
    """q̇₀ that moves one direction as another is off: a nilpotent flow, whose eigenvalues rounding parts by √ε."""
    across = np.linalg.svd(np.asarray(ck.jacobian(FOUR, ON_THE_WAY))[:2])[2][2:]
    shear = across[0][:, None] * across[1]
    found = recommend(on_the_way(lambda q: shear @ (q - ON_THE_WAY)), None, ON_THE_WAY, Ts=Ts, method="EE")
    assert found.z_largest == pytest.approx(2, rel=1e-5)


def test_a_null_space_that_spirals_out_by_itself_limits_no_gain():
    across = np.linalg.svd(np.asarray(ck.jacobian(FOUR, ON_THE_WAY))[:2])[2][2:]
    for growth, turn in ((0.2, 3.0), (2.0, 0.0)):
        flow = across.T @ np.array([[growth, turn], [-turn, growth]]) @ across
        made = on_the_way(lambda q, flow=flow: flow @ (q - ON_THE_WAY))
        assert spectrum(made, None, ON_THE_WAY, Ts, "EE").null_radius > 1.01
        assert recommend(made, None, ON_THE_WAY, Ts=Ts, method="EE").z_largest == pytest.approx(2, rel=1e-6)
    around = across.T @ np.array([[0.0, 3.0], [-3.0, 0.0]]) @ across  # a circle, out of which explicit Euler steps
    found = recommend(on_the_way(lambda q: around @ (q - ON_THE_WAY)), None, ON_THE_WAY, Ts=Ts, method="EE")
    assert found.z_largest == 0 and "by 1.04" in found.limit  # sqrt(1 + 0.3²)


def test_null_space_velocities_that_pull_at_the_task_are_told():
    """Through a damped J#, whose projector is none."""
    leaks = on_the_way(ck.maximize_manipulability(FOUR, XY, 20.0), inverse=ck.damped(0.5))
    found = recommend(leaks, None, ON_THE_WAY, Ts=Ts, method="EE")
    assert found.z_largest == 0 and re.search(r"multiplies an error, through this J#, by 1\.\d+ each step", found.limit)
    place = ck.hold(np.asarray(ck.forward(FOUR, ON_THE_WAY).position)[:2])
    with pytest.raises(ck.ArgumentError, match="as the null-space velocity pulls at it"):
        settle(leaks, place, ON_THE_WAY)
    climbs = on_the_way(ck.maximize_manipulability(FOUR, XY, 5.0), inverse=ck.damped(0.5))
    with pytest.raises(ck.ArgumentError, match="`q` must be no singular posture to climb the manipulability from"):
        recommend(climbs, None, np.zeros(4), Ts=Ts)


@pytest.mark.slow
def test_a_null_space_velocity_that_no_gain_makes_up_for_is_refused():
    draws = on_the_way(lambda q: 30.0 * (ON_THE_WAY - q), inverse=ck.damped(0.5))
    with pytest.raises(ck.ArgumentError, match=r"`null_velocity` must leave .* one step removes 0\.\d+ of an error"):
        advise(draws, None, ON_THE_WAY, Ts=0.05)


def test_a_recommendation_says_first_what_it_assumes_of_the_drives():
    """A gain is of the drives as they are given: where a lag may hide, it is said before the gain."""
    for drive, words in (
        (ck.Drive(), "Assumed: the drives follow at once, without dead time, lag or servo."),
        (ck.Drive(delay=4), "Assumed: after 4 samples (40 ms) of dead time the drives follow at once, without a lag."),
    ):
        made = recommend(law(), None, Q, Ts=0.01, drive=drive)
        assert str(made).startswith(words) and "\nalpha: recommended" in str(made) and made.assumed == words
        assert repr(made).index(words) < repr(made).index("largest")
    told = recommend(law(), None, Q, Ts=0.01, drive=ck.Drive(delay=4, lag=0.02))
    assert str(told).startswith("alpha: recommended") and told.assumed == ""
    assert recommend(law(), None, Q, Ts=0.01, drive=ck.Drive(delay=4, feedback="commanded")).assumed == ""
    assert str(recommend(law(), None, Q)).startswith("Assumed: the drives follow at once")
