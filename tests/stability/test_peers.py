"""pink and mink: their tasks as a law here step as they do; advised gains are quiet there."""

import importlib

import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import Remark
from cnclik.stability.peers import from_pink, to_pink
from tests.oracles import robot_file, robots

pin = pytest.importorskip("pinocchio")
pink = pytest.importorskip("pink")
pytest.importorskip("daqp")
DT = 0.01
TIPS = {"baxter": ["left_gripper", "right_gripper"], "panda": ["panda_hand"], "ur5": ["tool0"]}


class Robot:
    """A robot in both, its other joints locked in pink's; and a stack of its tips and a posture there."""

    def __init__(self, name, gain=0.2, posture=0.05, cost=0.1):
        file = robot_file(name)
        self.ours = ck.load_urdf(file, tips=TIPS[name])
        model = pin.buildModelFromUrdf(str(file))
        others = [i for i in range(1, model.njoints) if model.names[i] not in self.ours.joint_names]
        self.model = pin.buildReducedModel(model, others, pin.neutral(model))
        self.order = [self.model.names[1:].tolist().index(j) for j in self.ours.joint_names]
        self.q = np.clip(
            np.linspace(0.4, 0.9, self.ours.n), np.add(self.ours.lower, 0.3), np.subtract(self.ours.upper, 0.3)
        )
        self.tasks = [pink.FrameTask(tip, position_cost=1.0, orientation_cost=0.5, gain=gain) for tip in TIPS[name]]
        self.tasks.append(pink.PostureTask(cost=cost, gain=posture))
        at = self.configuration(self.q)
        for task in self.tasks:
            task.set_target_from_configuration(at)

    def configuration(self, q):
        theirs = np.empty(len(q))
        theirs[self.order] = q
        return pink.Configuration(self.model, self.model.createData(), theirs)

    def step(self, q):
        v = pink.solve_ik(self.configuration(q), self.tasks, DT, solver="daqp", limits=[], damping=1e-6)
        return v[self.order] * DT

    def law(self, **changes):
        return from_pink(self.ours, self.tasks, DT, damping=1e-6, **changes)

    def run(self, delay, N, start):
        """|step| of N steps, the joints seen `delay` steps late."""
        line, sizes = [self.q + start] * (delay + 1), []
        for _ in range(N):
            step = self.step(line[-1])
            line = [line[0] + step, *line[:-1]]
            sizes.append(np.linalg.norm(step))
            if sizes[-1] > 1.0:
                break
        return np.array(sizes)


@pytest.mark.parametrize(("base", "root"), [("free", "JointModelFreeFlyer"), ("planar", "JointModelPlanar")])
def test_a_script_on_a_base_that_moves_steps_as_its_law_here(base, root):
    """Its posture and its damping leave out the base, its centre of mass does not."""
    file = robots() / "hyq_description/robots/hyq_no_sensors.urdf"
    ours = ck.load_urdf(file, tips=["lf_foot", "rf_foot", "lh_foot", "rh_foot"], base=base)
    model = pin.buildModelFromUrdf(str(file), getattr(pin, root)())
    q = np.clip(np.linspace(0.2, 0.9, ours.n), np.add(ours.lower, 0.1), np.subtract(ours.upper, 0.1))
    theirs = ck.to_pinocchio_q(ours, model, q)
    at = pink.Configuration(model, model.createData(), theirs)
    tasks = [pink.FrameTask("lf_foot", 1.0, 0.0, gain=0.3), pink.tasks.ComTask(np.array([0.5, 0.4, 0.3]), gain=0.2)]
    tasks += [pink.PostureTask(0.1, gain=0.4), pink.tasks.DampingTask(0.2)]
    for task in tasks[:3]:
        task.set_target_from_configuration(at)
    tasks[1].target_com += [1e-6, -2e-6, 3e-6]  # where its error and ours differ in second order alone
    law = from_pink(ours, tasks, DT, damping=1e-6)
    paths = ck.hold_at(ours, law.task, q, com=ck.hold(values=tasks[1].target_com))
    step = ck.step(law, paths, q, 0.0, DT, "EE")
    wanted = pink.solve_ik(at, tasks, DT, solver="daqp", limits=[], damping=1e-6)
    np.testing.assert_allclose(
        ck.to_pinocchio_q(ours, model, q, step.qdot)[1], wanted, atol=1e-5 * np.abs(wanted).max()
    )


@pytest.mark.parametrize("name", TIPS)
def test_a_pink_script_steps_as_its_law_here(name):
    robot = Robot(name)
    law = robot.law()
    q, start = robot.q, 0.02 * np.cos(np.arange(robot.ours.n))
    run = ck.solve(law, ck.hold_at(robot.ours, law.task, q), q + start, DT, 20, "EE")
    theirs = [q + start]
    for _ in range(20):
        theirs.append(theirs[-1] + robot.step(theirs[-1]))
    # Their error is the logarithm of a pose, ours that of each part: the same to the square of the error.
    np.testing.assert_allclose(run.q, theirs, atol=1e-3)
    np.testing.assert_allclose(run.q[-1], theirs[-1], atol=1e-4)
    assert to_pink(law, DT)["posture"] == {"gain": pytest.approx(0.05), "cost": pytest.approx([0.1] * robot.ours.n)}


@pytest.mark.parametrize("delay", [0, 4])
@pytest.mark.parametrize("name", TIPS)
def test_advised_gains_are_quiet_there_and_beyond_the_limit_errors_grow(name, delay):
    robot = Robot(name)
    said = ck.advise(robot.law(), None, robot.q, Ts=DT, method="EE", drive=ck.Drive(delay=delay)).stack
    start, tip = 1e-6 * np.cos(np.arange(robot.ours.n)), said.tasks[TIPS[name][0]]
    robot.tasks[0].gain = 1.05 * tip.largest_stable_alpha * DT
    sizes = robot.run(delay, 700, start)
    assert sizes[-1] > 1.0 or sizes[-50:].max() > sizes[200:250].max()
    for task, one in zip(robot.tasks, said.tasks.values(), strict=True):
        task.gain = one.recommended_alpha * DT
    sizes = robot.run(delay, 200, start)
    assert sizes[-20:].max() < sizes[:20].max() and sizes.max() < 3 * sizes[delay : delay + 2].max()


def test_limits_and_damping_tasks_and_what_is_not_known():
    robot = Robot("panda")
    limit = pink.limits.ConfigurationLimit(robot.model)
    law = robot.law(limits=[limit])
    assert float(law.limits.rate) == pytest.approx(50.0)  # 0.5 a step
    with pytest.warns(Remark, match="CollisionAvoidanceLimit is left out"):
        robot.law(limits=[limit, type("CollisionAvoidanceLimit", (), {"gain": 0.85})()])
    damped = from_pink(robot.ours, [*robot.tasks, pink.tasks.DampingTask(cost=0.3)], DT)
    assert float(damped.inverse.damping) == pytest.approx(0.3)
    with pytest.raises(ck.ArgumentError, match="hold a RollingTask"):
        from_pink(robot.ours, [type("RollingTask", (), {})()], DT)
    uneven = pink.FrameTask("panda_hand", position_cost=[1.0, 0.0, 2.0], orientation_cost=0.0)
    task = from_pink(robot.ours, [uneven], DT).task
    assert (task.m, list(task.weights)) == (2, [1.0, 2.0])


@pytest.mark.parametrize("delay", [0, 4])
@pytest.mark.parametrize("name", ["Panda", "UR5", "xArm7"])
def test_advised_gains_are_quiet_in_mink_and_beyond_the_limit_errors_grow(name, delay):
    mink, mujoco = pytest.importorskip("mink"), pytest.importorskip("mujoco")
    arm = importlib.import_module("tests.bench.loops_arms").Arm(name)
    configuration = mink.Configuration(mujoco.MjSpec.from_string(arm.text).compile(), arm.q)
    tasks = [mink.FrameTask(arm.tip, "body", position_cost=1.0, orientation_cost=0.5, gain=0.2)]
    tasks.append(mink.PostureTask(configuration.model, cost=0.1, gain=0.05))
    for task in tasks:
        task.set_target_from_configuration(configuration)
    law = from_pink(arm.chain, tasks, DT, damping=1e-6)
    said = ck.advise(law, None, arm.q, Ts=DT, method="EE", drive=ck.Drive(delay=delay)).stack

    def run(N):
        line, sizes = [arm.q + 1e-6 * np.cos(np.arange(arm.n))] * (delay + 1), []
        for _ in range(N):
            configuration.update(line[-1])
            step = mink.solve_ik(configuration, tasks, DT, "daqp", damping=1e-6, limits=[]) * DT
            line = [line[0] + step, *line[:-1]]
            sizes.append(np.linalg.norm(step))
            if sizes[-1] > 1.0:
                break
        return np.array(sizes)

    most = said.tasks[arm.tip].largest_stable_alpha * DT
    if most < 1:  # mink takes no gain above 1
        tasks[0].gain = 1.05 * most
        sizes = run(700)
        assert sizes[-1] > 1.0 or sizes[-50:].max() > sizes[200:250].max()
    for task, one in zip(tasks, said.tasks.values(), strict=True):
        task.gain = one.recommended_alpha * DT
    sizes = run(200)
    assert sizes[-20:].max() < sizes[:20].max() and sizes.max() < 3 * sizes[delay : delay + 2].max()
