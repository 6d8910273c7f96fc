"""What runs did, in a sentence: loops whose behaviour is known, and whether the remedy mends them."""

import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.cli.common import as_options
from cnclik.integrate.drive import Drive
from cnclik.law.reference import sample
from cnclik.problem.build import problem_from
from cnclik.problem.names import task_from
from cnclik.stability import Behaviour, trial, verdict
from cnclik.stability.advice import advise
from cnclik.stability.case import case_of
from cnclik.stability.loop import LoopAtRest
from cnclik.stability.observed import observe
from cnclik.stability.remedies import Remedy
from cnclik.stability.trial import Trials

FIVE = ck.planar_arm([1.0] * 5, clockwise=True)
TWO = ck.planar_arm([1.0, 1.0], clockwise=True)
Q5 = np.array([0.3, 0.5, -0.4, 0.6, 0.2])
Q2 = np.array([0.3, 1.2])
XY = ck.position("xy")
TIP = np.asarray(ck.forward(FIVE, Q5).position[:2])
INWARD = -TIP / np.linalg.norm(TIP)
NEAR = ck.hold(TIP + np.array([-0.1, 0.1]))
Ts = 0.1


def law(alpha, chain=FIVE, **options):
    return ck.Law(chain, XY, alpha=alpha, **options)


def judge(law, reference, N, q=Q5, Ts=Ts, method=ck.EE, stage=ck.picard(5)):
    run = ck.solve(law, reference, q, Ts, N, method, stage)
    return verdict(law, reference, run, Ts=Ts, method=method, stage=stage)


def test_a_coordinate_that_no_joint_moves_is_named():
    """z of a planar arm: settled where the target has it, else out of reach; not a posture near a singularity."""
    xyz = ck.Law(FIVE, ck.position("xyz"), alpha=5.0, inverse=ck.damped(0.01))
    for z, kind in ((0.0, Behaviour.SETTLED), (0.1, Behaviour.OUT_OF_REACH)):
        said = judge(xyz, ck.hold([*(TIP + 0.1 * INWARD), z]), 60)
        assert said.kind == kind and "no joint motion has a part along z, in any posture" in str(said)
    assert "no joint motion" not in str(judge(law(5.0), NEAR, 60))


def test_errors_without_a_unit_are_told_as_they_are():
    """They were left out, and a prefix of none made 0.005 "5 m"."""
    bent = ck.function(lambda robot, q: q[:1] ** 2, ["bent"], ["1"])
    own, target = ck.Law(FIVE, bent, alpha=0.5), ck.hold(values=[0.085])
    said = str(judge(own, target, 10))
    assert re.search(r"the errors are at most: function 0\.00\d+ \(shrinking\)", said), said


@pytest.mark.parametrize(
    ("z", "N", "kinds"),
    [
        (0.5, 60, "settled"),
        (1.0, 1, "converging"),
        (0.05, 60, "converging"),
        (0.001, 60, "too-short-to-tell"),  # a twentieth of a time constant
        (1.9, 60, "ringing"),
        (2.5, 1, "diverging"),
        (2.5, 20, "diverging shaking"),
        (2.5, 60, "shaking diverging"),
        (0.0, 60, "no-progress"),
    ],
)
def test_explicit_euler_over_z(z, N, kinds):
    found = judge(law(z / Ts), NEAR, N)
    assert found.kind.replace(" ", "-") in kinds.split(), found.sentence
    if z < 2:
        assert found.radius == pytest.approx(abs(1 - z), abs=0.06)
    else:
        assert float(re.search(r"below ([\d.]+) 1/s", found.remedy)[1]) == pytest.approx(2 / Ts, rel=0.02)
    if z == 0:
        assert found.remedies[0].change["alpha"] == pytest.approx(0.2 / Ts)
    if z == 1.9:
        assert float(re.search(r"about ([\d.]+) 1/s", found.remedy)[1]) == pytest.approx(1 / Ts, rel=0.02)


def test_what_is_prepared_is_what_will_be_asked(monkeypatch):
    """Else the program of the verdict is made after the run, and not beside it."""
    module, asked = sys.modules["cnclik.stability.verdict"], []
    maps = LoopAtRest.maps

    def recorded(self, *args):
        asked.append(jax.tree.map(lambda v: (np.shape(v), np.asarray(v).dtype), (self.law, self.held, self.q, args)))
        return maps(self, *args)

    monkeypatch.setattr(LoopAtRest, "maps", recorded)
    module.prepare(law(5.0), NEAR, Q5, Ts=Ts, method=ck.EE)
    judge(law(5.0), NEAR, 20)
    assert len(asked) >= 2 and len({str(one) for one in asked}) == 1
    assert jax.tree.structure(asked[0]) == jax.tree.structure(asked[1])


def test_what_a_loop_does_at_rest_is_known_without_its_step(monkeypatch):
    """A humanoid's step was differentiated, and compiled, for it."""
    monkeypatch.setattr(sys.modules["cnclik.stability.loop"], "step_maps", None)
    assert judge(law(5.0), NEAR, 60).radius == pytest.approx(0.5)


def test_transpose_that_shakes_is_told_and_its_remedy_settles_it():
    """The command line called it stable and its steps OK, 0.5 m off at 38 rad/s of chatter."""
    q, target = np.array([0.5, 0.3, 0.3, 0.3, 0.3]), ck.hold([1.5, 2.5])
    made = law(30.0, inverse=ck.transpose())
    found = judge(made, target, 60, q, 0.05)
    assert found.kind == Behaviour.SHAKING and found.radius > 1 and found.error > 0.1
    gain = float(re.search(r"below ([\d.]+) 1/s", found.remedy)[1])
    calm = judge(ck.replace(made, alpha=jnp.asarray(0.8 * gain)), target, 400, q, 0.05)
    assert calm.kind in (Behaviour.SETTLED, Behaviour.CONVERGING), calm.sentence


@pytest.mark.parametrize("N", [40, 150])
def test_a_small_decrease_towards_a_limit_cycle_is_no_convergence(N):
    """At 40 steps it was called converging, at 150 shaking: its error stays at 0.155 m for ever."""
    made = law(60.0, chain=ck.planar_arm([1.0, 0.5, 0.3]), inverse=ck.transpose())
    found = judge(made, ck.hold([-0.026502, 0.80831]), N, np.array([-1.0334647, 1.52846724, 0.75246399]), 0.05)
    assert found.kind == Behaviour.SHAKING and "below 28.7" in found.remedy, found.sentence
    if N > 40:
        assert found.radius > 1.04  # at rest, where the run ended


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (law(0.15, inverse=ck.transpose()), "use inverse=damped(0.066), and run"),
        (law(20.0, inverse=ck.damped(60.0)), "use inverse=damped(0.066) and reduce alpha to 2 1/s at this Ts, and run"),
        (law(5e-4), "raise alpha to 2 1/s at this Ts, and run"),
    ],
    ids=["transpose", "damped", "gain"],
)
def test_what_falls_too_slowly_is_told_what_is_quicker(made, said):
    """Loop 13.13 of seed 31: "converging", by a run of five million steps, and for 4,000 steps its error stayed."""
    q = np.array([0.0, 0.02, -0.04, 0.06, 0.02])  # nearly stretched
    weak = np.linalg.svd(np.asarray(ck.jacobian(FIVE, q))[:2])[0][:, 1]  # along which the tip hardly moves
    target = ck.hold(np.asarray(ck.forward(FIVE, q).position[:2]) - 0.004 * weak * np.sign(weak[0]))
    found = judge(made, target, 60, q)
    assert found.kind == Behaviour.UNDECIDED and "not known" in found.sentence, found.sentence
    assert said in found.remedy and len(found.remedies) == 1, found.sentence
    (change,) = [one.change for one in found.remedies]
    assert ("--inverse damped --damping 0.066" in as_options(found.remedy)) == ("damping" in change)
    assert f"run for --N {change['N']} steps" in as_options(found.remedy)
    quick = ck.replace(made, alpha=jnp.asarray(change.get("alpha", made.alpha)))
    quick = ck.replace(quick, inverse=ck.damped(change["damping"])) if "damping" in change else quick
    assert judge(quick, target, change["N"], q).kind == Behaviour.SETTLED


def test_damped_loop_settles_with_a_radius_of_its_own():
    found = judge(law(5.0, inverse=ck.damped(0.5)), NEAR, 100)
    assert found.kind == Behaviour.SETTLED and found.radius > 0.501 and found.remedy == ""


def test_out_of_reach():
    far = ck.hold([2.5, 0.5])
    quiet = judge(law(5.0, TWO, inverse=ck.damped(0.3), error_clamp=(0.1, 0.1)), far, 200, Q2)
    assert quiet.kind == Behaviour.OUT_OF_REACH and "0.55 m beyond the stretched arm" in quiet.sentence
    loud = judge(law(5.0, TWO), far, 120, Q2)
    assert loud.kind in (Behaviour.OUT_OF_REACH, Behaviour.SHAKING, Behaviour.STALLED, Behaviour.DIVERGING)
    assert "can get no nearer than 0.55 m" in loud.sentence


def test_a_gantry_reaches_as_far_as_its_slides():
    """Its joints are all in one place at q = 0: an arm without any length."""
    gantry = ck.from_dh([0.0] * 3, [np.pi / 2, np.pi / 2, 0.0], [0.0] * 3, kinds="PPP", lower=[-2] * 3, upper=[2] * 3)
    target = ck.hold(np.asarray(ck.forward(gantry, np.ones(3)).position))
    found = judge(ck.Law(gantry, ck.position(), alpha=0.5), target, 60, q=np.zeros(3))
    assert found.kind == Behaviour.CONVERGING and "stretched arm" not in found.sentence


def test_more_coordinates_than_joints():
    task = ck.pose("xy", "z")
    made = ck.Law(TWO, task, alpha=5.0, inverse=ck.damped(0.1))
    target = ck.hold(np.asarray(ck.forward(TWO, Q2).position[:2]) - 0.1, np.eye(3))
    found = judge(made, target, 200, Q2)
    assert found.kind == Behaviour.OUT_OF_REACH
    assert "3 coordinates of an arm with 2 joints" in found.sentence and re.search(r"\d m?m and .*rad", found.sentence)


@pytest.mark.parametrize(
    "limits",
    [
        pytest.param(ck.weighted_least_norm(), id="weighted"),
        pytest.param(ck.saturation(), id="saturation", marks=pytest.mark.slow),
    ],
)
def test_stuck_at_a_limit(limits):
    chain = ck.replace(TWO, lower=(-1.0, 1.0), upper=(0.5, 1.4))
    goal = ck.hold(np.asarray(ck.forward(TWO, [1.2, 1.2]).position[:2]))
    found = judge(ck.Law(chain, XY, alpha=3.0, inverse=ck.damped(0.1), limits=limits), goal, 120, Q2)
    assert found.kind == Behaviour.AT_LIMIT, found.sentence
    assert re.search(r"q\d(, q\d)? (is|are) at a limit", found.sentence)


def test_a_joint_at_its_limit_in_most_steps_is_named():
    """Also if it has just left it; a joint whose limits are equal can't be moved, and is not."""
    chain = ck.replace(FIVE, lower=(-2.0, 0.5, -0.5, -2.0, 0.0), upper=(2.0, 0.5, -0.4, 2.0, 3.0))
    own = ck.Law(chain, XY, alpha=3.0, inverse=ck.damped(0.1), limits=ck.weighted_least_norm())
    run = ck.solve(own, NEAR, Q5, Ts, 40, "EE")
    q = np.array(run.q)
    q[:, 2:] = -0.45, 0.0, 1.0
    q[-12:-1, 2] = -0.4
    assert observe(own, ck.replace(run, q=q), Ts, q.dtype).at_position.tolist() == [False, False, True, False, False]


def test_a_remedy_for_two_things_is_named_once():
    same = [Remedy(change={"limits": "saturation"}, words=words, mends=words) for words in ("one", "two")]
    assert sys.modules["cnclik.stability.verdict"]._in_words([*same, Remedy(change={"alpha": 1.0}, words="less")]) == (
        "one. Less"
    )


def test_a_path_too_fast_for_the_velocity_limits():
    chain = ck.replace(FIVE, velocity_limit=(0.05,) * 5)
    path = ck.line(TIP, TIP + 1.5 * INWARD, duration=1.0)
    found = judge(ck.Law(chain, XY, alpha=5.0, limits=ck.velocity_scaling()), path, 100, Ts=0.01)
    assert found.kind == Behaviour.AT_LIMIT and "q4 moves at its velocity limit" in found.sentence
    assert [list(one.change) for one in found.remedies] == [["period", "N"]]  # limits=saturation() would not help
    slow = ck.line(TIP, TIP + 1.5 * INWARD, duration=found.remedies[0].change["period"])
    assert judge(ck.Law(chain, XY, alpha=5.0, limits=ck.velocity_scaling()), slow, 5000, Ts=0.01).kind == "settled"


def test_what_asks_for_more_than_joints_can_is_told_how_to_ask_for_less():
    chain = ck.replace(FIVE, velocity_limit=(0.05,) * 5)
    held = judge(law(5.0, chain), NEAR, 60)
    assert held.kind == Behaviour.SETTLED and "velocity limit" in held.sentence
    assert "path" not in held.remedy and "velocity_scaling()" in held.remedy and "reduce alpha" in held.remedy
    moving = judge(law(5.0, chain), ck.line(TIP, TIP + 0.7 * INWARD, duration=2.0), 200, Ts=0.01)
    assert moving.kind == Behaviour.BEYOND_LIMITS and moving.remedy.startswith("follow a slower path")
    assert re.match(r"beyond the robot's limits: \d+ of 200 steps exceed a joint's velo", moving.sentence)
    most = float(np.abs(ck.solve(law(5.0), NEAR, Q5, Ts, 60, ck.EE).qdot).max())
    for excess, kind in ((1.5, Behaviour.SETTLED), (2.5, Behaviour.BEYOND_LIMITS)):
        near = judge(law(5.0, ck.replace(FIVE, velocity_limit=(most / excess,) * 5)), NEAR, 60)
        assert near.kind == kind and f" with up to {excess} times it" in near.sentence, near.sentence


def test_feed_forward_alone_past_a_singularity():
    """alpha = 0 asks for nothing of an error: what is too fast is so by the path, and damping ends it."""
    chain, q = ck.replace(TWO, velocity_limit=(1.0, 1.0)), np.array([0.3, 0.05])
    tip = np.asarray(ck.forward(chain, q).position[:2])
    found = judge(law(0.0, chain), ck.line(tip, np.array([1.0, 1.9]), duration=1.0), 100, q, 0.01)
    assert found.kind == Behaviour.STALLED and "velocity limit" in found.sentence
    assert "damped(" in found.remedy
    # With a gain the joints go 40 times as fast past the singularity, and the error stays.
    assert "raise alpha" not in found.remedy.lower() and "no better: raise alpha, to 20 1/s" in found.sentence


def test_following_a_line():
    """Without feed-forward the loop lags by v/alpha; with it, it follows."""
    path = ck.line(TIP, TIP + 0.7 * INWARD, duration=2.0)
    late = judge(law(5.0, feedforward=0.0), path, 200, Ts=0.01)
    assert late.kind == Behaviour.LAGGING and late.error == pytest.approx(0.35 / 5, rel=0.02)
    assert "a lag of 0.2 s" in late.sentence and "feedforward=1" in late.remedy
    assert judge(law(5.0), path, 200, Ts=0.01).kind == Behaviour.SETTLED


def test_joints_that_whirl_diverge_however_slowly_the_loop_at_rest_does():
    """The error of an arm is no larger than its reach: past it a tip that is lost only varies."""
    chain, drive = ck.replace(FIVE, lower=(-2.0,) * 5, upper=(2.0,) * 5), Drive(delay=4.0, lag=0.06)
    made, goal = law(68.3, chain), ck.hold(TIP + np.array([-0.5, 0.7]))
    run = ck.solve(made, goal, Q5, 0.004, 1000, ck.EE, drive=drive)
    found = verdict(made, goal, run, Ts=0.004, method=ck.EE, drive=drive)
    assert 1 < found.radius < 1.01
    assert found.kind == Behaviour.DIVERGING and "rad beyond its limit" in found.sentence


def test_gains_of_a_stack_are_told_by_task():
    """It was "reduce alpha below 0.8 of what it is (0.4 of it is half of that)", and "each swing 1 times the one
    before" without a remedy, as no smaller gain settles sooner where another task is slower."""
    task = ck.stack(tip=XY, angle=ck.orientation("z"))
    turned = ck.hold(rotation=np.asarray(ck.forward(FIVE, Q5).rotation))
    goal, drive = ck.references(tip=NEAR, angle=turned), Drive(delay=4.0, lag=0.06)

    def told(**alpha):
        made, how = ck.Law(FIVE, task, alpha=alpha), dict(method=ck.EE, drive=drive)
        return verdict(made, goal, ck.solve(made, goal, Q5, 0.004, 600, **how), Ts=0.004, **how)

    fast = told(tip=80.0, angle=8.0)
    assert "below 58.2 1/s for tip at this Ts (29.1 1/s for tip is half" in fast.remedy  # the angle's gain is innocent
    assert fast.remedies[0].change["alpha"][2] == 8.0
    slow = told(tip=58.0, angle=0.1)
    assert slow.kind == Behaviour.RINGING and "each swing nearly as large as the one before" in slow.sentence, slow
    assert "to about 29.1 1/s for tip at this Ts, which is half of what is stable at any posture" in slow.remedy, slow
    assert slow.remedies[0].change["alpha"][2] == 0.1


def test_damping_that_keeps_tips_of_a_stack_away_is_named():
    task = ck.stack(tip=XY, angle=ck.orientation("z"))
    turned = ck.hold(rotation=np.asarray(ck.forward(FIVE, Q5).rotation))
    around = ck.circle(TIP + 0.3 * INWARD, 0.3, period=2.0, phase=float(np.arctan2(*-INWARD[::-1])))
    made = ck.Law(FIVE, task, alpha=5.0, inverse=ck.levels(["tip"], ["angle"], damping=(0.15, 0.3)))
    found = judge(made, ck.references(tip=around, angle=turned), 200, Ts=0.01)
    assert "other tasks, damping or the start posture keep the tips away" in found.sentence
    assert found.remedy == "use a tenth of the damping of each level"


def test_null_space_that_shakes():
    made = law(5.0, null_velocity=lambda q: 25.0 * (Q5 + 0.05 - q))
    found = judge(made, NEAR, 40)
    assert found.kind in (Behaviour.SHAKING, Behaviour.DIVERGING)
    calm = 25.0 * found.remedies[0].change["null_gain"]
    assert "reduce the gain of the null-space velocity" in found.remedy
    assert judge(law(5.0, null_velocity=lambda q: calm * (Q5 + 0.05 - q)), NEAR, 40).kind == Behaviour.SETTLED


def test_a_run_that_is_not_finite():
    run = ck.solve(law(5.0), NEAR, jnp.asarray(Q5), Ts, 60)
    broken = ck.replace(run, q=run.q.at[30:].set(jnp.nan), e=run.e.at[30:].set(jnp.nan))
    found = verdict(law(5.0), NEAR, broken, Ts=Ts)
    assert found.kind == Behaviour.DIVERGING and "step 30" in found.sentence and found.error == np.inf


@pytest.mark.slow
def test_a_coordinate_of_a_remedy_is_no_rounding():
    """It was "bring the target to (2.328, 2.33e-07, 0) m"."""
    law = ck.Law(ck.planar_arm([1.0, 0.8, 0.6]), ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))
    goal = ck.hold([3.0, 3e-7])
    found = verdict(law, goal, ck.solve(law, goal, np.array([0.3, 0.3, 0.3]), Ts, 60), Ts=Ts)
    assert found.kind == Behaviour.OUT_OF_REACH and "bring the target to (2.328, 0, 0) m" in found.remedy


def test_a_path_that_is_followed_but_for_noise_is_settled():
    """It was "settled with lag". Without feed-forward it still is a lag."""
    for change, kind in (({}, Behaviour.SETTLED), ({"feedforward": 0.0, "noise": 1e-4}, Behaviour.LAGGING)):
        made = problem_from(
            "panda", **{"reference": "circle", "delay": 3, "lag": 0.05, "alpha": 2.0, "noise": 1e-3, **change}
        )
        how = dict(Ts=made.Ts, method=made.method, stage=made.stage, drive=made.drive, noise=made.noise)
        assert verdict(made.law, made.reference, made.run(), **how).kind == kind


def test_float32_runs_are_judged_alike():
    for z, kind in ((0.5, Behaviour.SETTLED), (1.9, Behaviour.RINGING), (0.05, Behaviour.CONVERGING)):
        with jax.enable_x64(False):
            assert judge(law(z / Ts), NEAR, 60).kind == kind


URDF = """<robot name="three"><link name="base"/><link name="a"/><link name="b"/><link name="tip"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="a"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/></joint>
  <joint name="lift" type="continuous"><parent link="a"/><child link="b"/>
    <origin xyz="0.1 0 0"/><axis xyz="0 1 0"/></joint>
  <joint name="bend" type="continuous"><parent link="b"/><child link="tip"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/></joint>
  <link name="tool"/><joint name="end" type="fixed"><parent link="tip"/><child link="tool"/>
    <origin xyz="0.3 0 0"/></joint></robot>"""


@pytest.mark.parametrize(("alpha", "kinds"), [(5.0, "settled"), (19.0, "ringing"), (25.0, "diverging shaking")])
def test_position_of_an_arm_from_a_file(alpha, kinds, tmp_path):
    (tmp_path / "three.urdf").write_text(URDF, encoding="utf-8")
    chain, q = ck.load_urdf(tmp_path / "three.urdf"), np.array([0.2, 0.4, 0.9])
    made = ck.Law(chain, ck.position("xyz"), alpha=alpha)
    target = ck.hold(np.asarray(ck.forward(chain, q).position) + np.array([0.02, 0.03, -0.02]))
    found = judge(made, target, 40, q)
    assert found.kind in kinds.split(), found.sentence


def test_pose_in_the_plane():
    at = ck.forward(FIVE, Q5)
    target = ck.hold(TIP + np.array([-0.1, 0.1]), np.asarray(at.rotation))
    found = judge(ck.Law(FIVE, ck.pose("xy", "z"), alpha=5.0), target, 60)
    assert (
        found.kind == Behaviour.SETTLED
        and re.search(r"\d m?m and .*rad", found.sentence)
        and found.radius == pytest.approx(0.5)
    )


@pytest.mark.slow
@pytest.mark.parametrize(("alpha", "kinds"), [(5.0, "settled"), (25.0, "diverging shaking")])
def test_pose_of_a_real_arm(alpha, kinds):
    chain, q = ck.ur5(), np.array([0.1, -1.2, 1.5, -0.4, 1.2, 0.3])
    at = ck.forward(chain, q)
    made = ck.Law(chain, ck.pose(), alpha=alpha)
    target = ck.hold(np.asarray(at.position) + np.array([0.05, 0.02, -0.05]), np.asarray(at.rotation))
    with ck.use_hints(False):
        found = judge(made, target, 40, q)
    assert found.kind in kinds.split(), found.sentence


def test_a_null_space_velocity_that_pulls_at_the_task_is_named():
    """Through a damped J# the error stays where gain and pull are even; more damping, or less gain, make it larger."""
    start = np.array([0.3, 0.8, 0.6])
    arm = ck.planar_arm([1.0] * 3)
    made = ck.Law(arm, XY, alpha=5.0, inverse=ck.damped(0.05), null_velocity=ck.posture(start + 0.5, 10.0))
    place = ck.hold(np.asarray(ck.forward(arm, start).position[:2]) + 1e-3)
    found = judge(made, place, 400, start, Ts=0.05)
    assert found.kind == Behaviour.STALLED and "pulls at the task" in found.sentence and found.radius < 1
    assert [list(one.change) for one in found.remedies] == [["inverse", "damping"], ["damping"], ["null_gain"]]
    for changes in ({"inverse": ck.pseudoinverse()}, {"null_velocity": None}):
        assert judge(ck.replace(made, **changes), place, 400, start, Ts=0.05).kind == Behaviour.SETTLED
    for less in ({"inverse": ck.damped(0.02)}, {"null_velocity": ck.posture(start + 0.5, 3.0)}):
        assert judge(ck.replace(made, **less), place, 400, start, Ts=0.05).error < 0.5 * found.error
    said = advise(made, None, start, Ts=0.05, method="EE")
    assert any("the null-space velocity disturbs the task" in note for note in said.notes)
    assert all(note in str(said) for note in said.notes)


def test_a_null_space_velocity_too_fast_for_the_joints_is_named():
    chain = ck.replace(FIVE, velocity_limit=(0.05,) * 5)
    found = judge(law(5.0, chain, null_velocity=ck.posture(Q5 + 0.3, 5.0)), NEAR, 60)
    assert "velocity limit" in found.sentence and "reduce the gain of the null-space velocity" in found.remedy


def test_what_cannot_be_judged():
    run = ck.solve(law(5.0), NEAR, Q5, Ts, 0)
    with pytest.raises(ck.ArgumentError, match="`run` must have at least one step"):
        verdict(law(5.0), NEAR, run, Ts=Ts)


def test_a_gain_far_too_large_is_told_the_one_that_is_stable():
    """It was called unstable at every gain: nobody looked below a thousandth of what it was."""
    found = judge(law(1e8), NEAR, 20)
    assert float(re.search(r"below ([\d.]+) 1/s", found.remedy)[1]) == pytest.approx(2 / Ts, rel=0.02)


def test_joints_that_are_too_fast_are_told_of():
    arm = ck.planar_arm([1.0, 0.8])
    arm = ck.replace(arm, velocity_limit=(2.0, 2.0))
    law = ck.Law(arm, ck.position("xy"), alpha=8.0)
    goal, q0 = ck.hold([0.2, 0.9]), [0.3, 1.1]
    told = ck.verdict(law, goal, ck.solve(law, goal, q0, 0.1, 40, "EE"), Ts=0.1, method="EE")
    assert told.kind == Behaviour.BEYOND_LIMITS and "The loop is settled: " in told.sentence, told.sentence
    assert "velocity limit, q2 with up to 8.98 times" in told.sentence and "velocity_scaling()" in told.remedy
    slow = ck.replace(law, limits=ck.velocity_scaling())
    told = ck.verdict(slow, goal, ck.solve(slow, goal, q0, 0.1, 40, "EE"), Ts=0.1, method="EE")
    assert told.kind == "settled" and "velocity limit" not in told.sentence and not told.remedy


def test_a_run_that_is_over_before_its_dead_time_says_nothing():
    arm = ck.planar_arm([1.0, 0.8])
    law, goal = ck.Law(arm, ck.position("xy"), alpha=3.0), ck.hold([0.9, 0.9])
    loop = dict(Ts=0.01, method="EE", drive=ck.Drive(delay=17))
    short, longer = (ck.solve(law, goal, [0.3, 1.1], 0.01, N, "EE", drive=loop["drive"]) for N in (5, 400))
    assert "over before its dead time" in ck.verdict(law, goal, short, **loop).sentence
    assert "dead time is" not in ck.verdict(law, goal, longer, **loop).sentence


def test_a_loop_that_stops_at_the_rounding_of_its_joint_values_says_so():
    """Below ulp(q)/2/(alpha·Ts) a step of float32 changes nothing: 1.5 mm at 8 kHz and 1 1/s, told as convergence."""
    goal, fast = ck.hold([2.05 - 1.0, 0.95]), dict(Ts=1 / 8000, method="EE")
    slow = ck.Law(TWO, XY, alpha=1.0)
    q = np.array(ck.reach(TWO, [1.05, 0.95, 0.0], task="position", tolerance=(1e-6, 1e-6)).q) + 1e-4
    # As a loop in float32 that doesn't carry what it rounds away: every q is the first one.
    with jax.enable_x64(False):
        run = ck.solve(slow, goal, np.float32(q), 1 / 8000, 400, "EE")
        assert "rounding" not in verdict(slow, goal, run, **fast).sentence
        run = ck.replace(run, q=jnp.tile(run.q[0], (401, 1)), e=jnp.tile(run.e[0], (401, 1)), qdot=0 * run.qdot)
        found = verdict(slow, goal, run, **fast)
    assert found.kind == Behaviour.STALLED and "rounding of q in float32" in found.sentence, found.sentence
    assert found.remedies[0].change == {"dtype": "float64"}
    assert "rounding" not in judge(law(5.0), NEAR, 100).sentence


def test_fewer_coordinates_are_named():
    """Three coordinates of two joints: the remedy is a task that the arm has joints for, and it settles."""
    made = ck.Law(TWO, ck.pose("xy", "z"), alpha=5.0, inverse=ck.damped(0.1))
    target = ck.hold(np.asarray(ck.forward(TWO, Q2).position[:2]) - 0.1, np.eye(3))
    (one,) = judge(made, target, 200, Q2).remedies
    assert one.change == {"task": "xy"}
    assert judge(ck.Law(TWO, task_from("xy", TWO), alpha=5.0), target, 200, Q2).kind == Behaviour.SETTLED


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        pytest.param(
            dict(robot="panda", reference="circle", Ts=0.002, N=200, alpha=0.5),
            "too short to tell",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            dict(robot="panda", reference="circle", Ts=0.001, N=20), "too short to tell", marks=pytest.mark.slow
        ),
        (dict(robot="ur5", N=1000), "settled"),
    ],
)
def test_short_runs_of_real_arms_invent_nothing(options, kind):
    """They were "ringing", at 6.6 µm of error, and "diverging … out of reach"; a settled one had a radius of 1.01."""
    made = problem_from(options.pop("robot"), **options)
    told = verdict(made.law, made.reference, made.run(), Ts=made.Ts, method=made.method, stage=made.stage)
    assert told.kind == kind and told.radius < 1, told.sentence
    if kind == "too short to tell":
        assert told.remedies[-1].mends == "verdict" and told.remedies[-1].change["N"] > made.N
        assert "educe alpha" not in told.sentence and "reach" not in told.sentence


@pytest.mark.slow
def test_a_run_that_leaves_a_singularity_is_told_how_to_leave_it_gently():
    """It was told to run for more steps, at 4,500 rad/s."""
    table = dict(q0=[0.0] * 6, N=50)
    made = problem_from("ur5", **table)
    told = verdict(made.law, made.reference, made.run(), Ts=made.Ts, method=made.method, stage=made.stage)
    assert [one.mends for one in told.remedies][:2] == ["velocity", "velocity"], told.sentence
    for one in told.remedies[:2]:
        gentle = problem_from("ur5", **table | one.change)
        share = np.abs(gentle.run().qdot) / np.array(gentle.law.chain.velocity_limit)
        assert share.max() < 1.05


@pytest.mark.slow
def test_joints_that_leave_their_limits_are_told_of():
    """A settled run said nothing of a joint that the arm has not."""
    arm = ck.replace(ck.planar_arm([1.0, 0.5, 0.3]), lower=(-2.0,) * 3, upper=(2.0, 1.3, 2.0))
    goal, q0 = ck.hold([0.0, 0.95]), np.array([0.3, 1.1, 0.2])
    made = ck.Law(arm, XY, alpha=3.0)
    run = ck.solve(made, goal, q0, Ts, 60, ck.EE)
    told = verdict(made, goal, run, Ts=Ts, method=ck.EE)
    beyond = float(np.max(np.asarray(run.q)[:, 1]) - 1.3)
    assert told.kind == Behaviour.BEYOND_LIMITS, told.sentence
    assert told.sentence.startswith(f"beyond the robot's limits: joint q2 is up to {beyond:.3g} rad beyond its limit")
    (one,) = [one for one in told.remedies if one.mends == "limits"]
    assert one.change == {"limits": "saturation"} and "saturation()" in told.sentence
    kept = ck.replace(made, limits=ck.saturation())
    run = ck.solve(kept, goal, q0, Ts, 60, ck.EE)
    assert np.max(np.asarray(run.q)[:, 1]) <= 1.3
    assert "beyond its limit" not in verdict(kept, goal, run, Ts=Ts, method=ck.EE).sentence
    through = ck.solve(made, goal, q0, Ts, 60, ck.EE, drive=ck.Drive(lag=0.05))  # a drive carries them farther
    told = verdict(made, goal, through, Ts=Ts, method=ck.EE, drive=ck.Drive(lag=0.05))
    assert "beyond its limit" in told.sentence and not [one for one in told.remedies if one.mends == "limits"]


@pytest.mark.parametrize("period", [None, -2.0])
def test_a_longer_run_follows_the_path_as_it_was(period):
    """Left out, the period is as long as the run: more steps alone would slow the path."""
    table = dict(robot="planar:1,1,1", reference="circle", Ts=0.02, N=40, alpha=1.0)
    table |= {} if period is None else {"period": period}
    made = problem_from(**table)
    told = verdict(made.law, made.reference, made.run(), Ts=made.Ts, method=made.method, stage=made.stage)
    assert told.kind == "too short to tell", told.sentence
    change = told.remedies[-1].change
    assert change["N"] > 40 and change["period"] == pytest.approx(0.8 if period is None else period)
    assert f"period={change['period']:.6g} s" in told.sentence
    longer = problem_from(**table | change)
    assert float(longer.reference.curve.period) == pytest.approx(float(made.reference.curve.period))


@pytest.mark.slow
def test_where_the_tip_is_to_turn_a_path_out_of_reach_is_not_moved():
    """Nobody looked whether the moved path could be turned as it was to be; a held target is asked for again."""
    start, task = np.array([0.3, 0.4, -0.2]), ck.pose("xy", "z")
    arm = ck.planar_arm([1.0, 1.0, 0.5])
    turn = np.asarray(ck.forward(arm, start).rotation)
    around = ck.circle([2.6, 0.3], 0.3, period=4.0, rotation=turn)
    made = ck.Law(arm, task, alpha=2.0, inverse=ck.damped(0.1))
    told = judge(made, around, 400, start, Ts=0.02)
    assert told.kind == Behaviour.OUT_OF_REACH and not any("shift" in one.change for one in told.remedies)
    told = judge(made, ck.hold([2.6, 0.3], turn), 400, start, Ts=0.02)
    for one in told.remedies:
        if "target" in one.change:
            there = judge(made, ck.hold(one.change["target"][:2], turn), 2000, start, Ts=0.02)
            assert there.error < 0.05 * told.error, there.sentence


@pytest.mark.parametrize(("radius", "kind"), [(20.0, Behaviour.OUT_OF_REACH), (0.2, Behaviour.SETTLED)])
def test_a_path_that_leaves_the_reach_and_comes_back_is_out_of_reach(radius, kind):
    """Its end is where it began, within reach; all but there the arm is too short, and no shift of it helps."""
    arm, Ts, N = ck.planar_arm([1.0, 0.8]), 0.01, 300
    law, q0 = ck.Law(arm, ck.position("xy"), alpha=5.0), np.array([0.4, 1.1])
    here = np.asarray(ck.forward(arm, q0).position)[:2]
    path = ck.circle([here[0] + radius, here[1]], radius, period=N * Ts, phase=np.pi)
    run = ck.solve(law, path, q0, Ts, N)
    told = ck.verdict(law, path, run, Ts=Ts)
    assert told.kind == kind, told
    assert not any("shift" in one.change or "N" in one.change for one in told.remedies), told.remedies
    assert ("beyond the stretched arm" in told.sentence) is (kind == Behaviour.OUT_OF_REACH)


@pytest.mark.parametrize(
    "change",
    [
        {"alpha": 2.0},
        {"method": "IE", "stage": "chord", "M": 2},
        {"damping": 0.1, "error_clamp": [0.05, 0.05], "N": 30},
        {"feedforward": 0.0},
        {"limits": "velocity-scaling"},
        {"period": 7.0},
    ],
)
def test_what_is_tried_is_what_the_options_change(change):
    """A remedy's change made to the records is that made to a problem's options."""
    table = dict(robot="planar:1,1,1", reference="circle", Ts=0.1, N=35, alpha=5.0, period=3.5, method="EE")
    made, asked = problem_from(**table), problem_from(**table | change)
    how = dict(N=made.N, method=made.method, stage=made.stage, drive=ck.Drive())
    tried = trial.changed(trial.Run(law=made.law, reference=made.reference, q0=made.q0, **how), change)
    run = ck.solve(tried.law, tried.reference, tried.q0, made.Ts, tried.N, tried.method, tried.stage)
    np.testing.assert_allclose(run.q, asked.run().q, atol=1e-9)


def test_only_what_needs_a_remedy_is_run_again(monkeypatch):
    """And by the program that the run itself has used: its own steps again, piece by piece."""
    asked, pieces = [], trial.in_pieces

    def recorded(*args, size, **more):
        asked.append(size)
        return pieces(*args, size=size, **more)

    monkeypatch.setattr(trial, "in_pieces", recorded)
    assert judge(law(np.array(5.0)), NEAR, 60).kind == Behaviour.SETTLED and not asked
    slow = law(np.array(0.5))
    ck.solve(slow, NEAR, Q5, Ts, 60, ck.EE)
    solving = sys.modules["cnclik.integrate.solve"]
    before = solving.solve_soon._cache_size(), len(solving.loops[60].entries)
    found = judge(slow, NEAR, 60)
    assert found.kind == Behaviour.CONVERGING and "N" in found.remedies[0].change
    assert set(asked) == {60} and (solving.solve_soon._cache_size(), len(solving.loops[60].entries)) == before


@pytest.mark.parametrize(("target", "z", "own"), [([1.0, 0.9], 0.5, True), ([3.0, 0.0], 1.0, False)])
def test_runs_of_a_chaotic_loop_depend_on_roundings(target, z, own):
    law, path = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=z / Ts), ck.hold(target)
    run = ck.solve(law, path, np.array([0.3, 0.9]), Ts, 20, "EE")
    case = case_of(law, path, run, np.float64, Ts, ck.EE, ck.picard(5), Drive(), pace=None, noise=None)
    assert Trials(case).repeats(200) is own


def test_a_run_at_a_pace_is_judged_and_tried_at_its_pace():
    """Held back by its pace, it held 0.08 of its time constants and was told to make no progress, after six of them."""
    how = dict(Ts=Ts, method=ck.EE)
    pace = ck.Pace(velocity=0.0005)
    run = ck.solve(law(1.0), NEAR, Q5, Ts, 60, ck.EE, pace=pace)
    with pytest.raises(
        ck.ArgumentError, match="`pace` must be the run's, in which the path waited for the robot, but is left out"
    ):
        verdict(law(1.0), NEAR, run, **how)
    found = verdict(law(1.0), NEAR, run, **how, pace=pace)
    assert found.kind == Behaviour.UNDECIDED, found.sentence
    there = ck.solve(law(1.0), NEAR, Q5, Ts, found.remedies[0].change["N"], ck.EE, pace=pace)
    assert verdict(law(1.0), NEAR, there, **how, pace=pace).kind == Behaviour.SETTLED


def test_a_run_too_long_to_be_tried_says_so():
    found = judge(law(2e-3), NEAR, 60)
    assert found.remedies[0].change["N"] > trial.MOST_TRIED and found.remedy.endswith("to decide (not tried)")


@pytest.mark.parametrize(
    ("path", "shift", "speed"),
    [
        (ck.path(lambda t: jnp.stack([1.5 + 0.1 * jnp.sin(t), 1.0 + 0.1 * t])), [0.1, -0.2, 0.0], 0.5),
        (ck.waypoints([0.0, 1.0, 2.0], [[1.5, 1.0], [1.6, 1.2], [1.4, 1.3]]), [0.1, -0.2, 0.0], 0.5),
        (ck.circle([1.5, 1.0], 0.2, period=2.0), [0.1, -0.2, 0.0], 1.0),
        (ck.circle([1.5, 1.0, 0.0], 0.2, period=2.0), [0.1, -0.2, 0.0], 0.25),
        (ck.with_feedforward(ck.line([1.5, 1.0], [1.2, 1.1], duration=2.0), [0.3, 0.1]), [0.0, 0.1, 0.0], 0.5),
    ],
)
def test_a_path_that_is_tried_is_moved_and_slowed(path, shift, speed):
    run = trial.Run(law=law(1.0), reference=path, q0=Q5, N=10, method=ck.EE, stage=ck.picard(5), drive=ck.Drive())
    made = trial.changed(run, {"shift": shift, "speed": speed, "N": 20}).reference
    for t in (0.0, 0.7, 1.9):
        was, now = path.curve(speed * t)[0], made.curve(t)[0]
        np.testing.assert_allclose(now, np.asarray(was) + shift[: len(was)], atol=1e-12)
        told, tells = (sample(one, XY, at)[1] for one, at in ((path, speed * t), (made, t)))
        np.testing.assert_allclose(tells, speed * told, atol=1e-12)


def test_what_was_tried_is_said_where_nothing_mends():
    """Noise shakes the joints; damping and a clamp don't keep it out, and were named."""
    made = problem_from("planar:1,1,1", alpha=5.0, noise=0.001, N=300, method="EE", Ts=0.1)
    how = dict(Ts=made.Ts, method=made.method, stage=made.stage)
    found = verdict(made.law, made.reference, made.run(), **how, noise=made.noise)
    assert found.kind == Behaviour.SHAKING and not found.remedies
    assert "tried, and no better: use inverse=damped(" in found.sentence


@pytest.mark.slow
def test_an_exact_inverse_is_no_remedy_where_limits_need_damping():
    arm = ck.replace(ck.planar_arm([1.0, 1.0, 1.0]), lower=(-3.0,) * 3, upper=(3.0,) * 3, velocity_limit=(2.0,) * 3)
    q = np.array([0.5, 0.5, 0.5])
    pulled = dict(inverse=ck.damped(0.5), null_velocity=ck.posture([0.0, 1.2, 0.0], 2.0))
    goal = ck.hold(np.asarray(ck.forward(arm, q).position[:2]) + 0.05)
    found = judge(ck.Law(arm, XY, alpha=5.0, limits=ck.bounded(), **pulled), goal, 400, q, 0.01)
    assert found.kind == Behaviour.STALLED
    assert [list(one.change) for one in found.remedies] == [["damping"], ["null_gain"]]


@pytest.mark.slow
def test_a_circle_on_which_the_arm_is_lost_later():
    """It follows, and its null-space velocity carries it on, to where that is no number."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])

    def carries(q):
        return jnp.where(q[1] > 1.5, jnp.nan, 1.0) * jnp.array([0.0, 0.05, 0.0])

    made = ck.Law(arm, XY, alpha=20.0, null_velocity=carries)
    goal = ck.circle(np.asarray(ck.forward(arm, np.array([0.3, 1.2, 0.9])).position[:2]), 0.05, period=1.0)
    found = judge(made, goal, 200, np.array([0.3, 1.2, 0.9]), 0.01, ck.EXP_MIDPOINT)
    assert found.kind == Behaviour.UNDECIDED and "it follows" in found.sentence, found.sentence
    assert re.search(r"run on, for 4096 steps in all, the error is not finite from step \d+ on", found.sentence)


@pytest.mark.parametrize(
    ("inverse", "why"),
    [
        (ck.damped(0.02), "compromise by their weights"),
        (ck.levels(["hand"], ["rest"], damping=(0.01, 0.1)), "level yields"),
    ],
)
def test_a_stack_without_levels_speaks_of_weights(inverse, why):
    tasks = ck.stack(hand=XY, rest=ck.joints(weights=0.1))
    stack = ck.Law(FIVE, tasks, alpha=5.0, inverse=inverse)
    said = judge(stack, ck.hold_at(FIVE, tasks, Q5, hand=NEAR), 400, Ts=0.05)
    assert said.kind == "settled in part" and why in said.sentence


def test_an_unstable_task_that_never_leaves_its_target_is_excited_to_try_what_mends_it():
    """Its error is exactly 0 in the run and in the trials: less gain was "tried, and no better"."""
    tasks, q = ck.stack(still=ck.joints(["q1"]), moves=ck.joints(["q2"])), np.array([0.5, 0.25])
    own = ck.Law(TWO, tasks, alpha={"still": 22.0, "moves": 5.0}, inverse=ck.damped(1e-6))
    target = ck.hold_at(TWO, tasks, q, moves=ck.hold(values=[0.75]))
    said = judge(own, target, 300, q)
    assert said.kind == Behaviour.DIVERGING and "any disturbance grows" in str(said), said
    assert "still" in said.remedies[0].words and "no better" not in str(said), said
