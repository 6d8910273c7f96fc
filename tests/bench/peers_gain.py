"""`python -m tests.bench.peers_gain`: the gain 1 − exp(−alpha·dt) in pink and mink, whose own gain is a share per step.

A UR5 that stands 1 mm and 2 mrad beside its target is held by each library's own loop (FrameTask, solve_ik with daqp,
integrate). With the exponential share the error has fallen to e^{−alpha·t} at every dt, as the law says; with the share
alpha·dt that the first order suggests it falls faster the larger dt is, is dead-beat at alpha·dt = 1, and is refused
(mink) or overshoots (pink) beyond. Tables in Markdown; AssertionError where the exponential one is off by more than 1 %
or overshoots. It needs pin-pink, mink, daqp and example-robot-data, not cnclik:

    python -m tests.bench.peers_gain
"""

import importlib.metadata
import math
import pathlib
import xml.etree.ElementTree as ET

import mink
import mujoco
import numpy as np
import pink
import pinocchio as pin
from pink.tasks import FrameTask

TIP = "tool0"
Q0 = np.array([0.4, -1.2, 1.5, -1.9, -1.3, 0.3])
SHIFT, TURN = np.array([0.6, -0.5, 0.62]) * 1e-3, np.array([1.2, 1.0, -1.2]) * 1e-3  # of the target [m], [rad]
TIME = 0.5  # of a run [s]
STEPS = (0.1, 0.05, 0.02, 0.01, 0.002)
TOLERANCE = 0.01
SHARES = {"1 − exp(−alpha·dt)": lambda alpha, dt: -math.expm1(-alpha * dt), "alpha·dt": lambda alpha, dt: alpha * dt}


def urdf() -> str:
    """The UR5's kinematics as URDF text, without shapes; MuJoCo is told to keep its fixed links."""
    files = importlib.metadata.files("example-robot-data")
    path = pathlib.Path(next(f for f in files if f.name == "ur5_robot.urdf").locate()).resolve()
    robot = ET.parse(path).getroot()
    for link in robot.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    settings = {"fusestatic": "false", "balanceinertia": "true", "boundmass": "1", "boundinertia": "1"}
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", settings)
    return ET.tostring(robot, encoding="unicode")


def with_pink(text, gain, dt, steps):
    """Errors (steps + 1, 6) in the target's frame."""
    model = pin.buildModelFromXML(text)
    at = pink.Configuration(model, model.createData(), Q0.copy())
    task = FrameTask(TIP, position_cost=1.0, orientation_cost=1.0, gain=gain)
    start = at.get_transform_frame_to_world(TIP)
    task.set_target(pin.SE3(start.rotation @ pin.exp3(TURN), start.translation + SHIFT))
    errors = [task.compute_error(at)]
    for _ in range(steps):
        velocity = pink.solve_ik(at, [task], dt, solver="daqp", limits=[])
        at.integrate_inplace(velocity, dt)
        errors.append(task.compute_error(at))
    return np.array(errors)


def with_mink(text, gain, dt, steps):
    """The same with mink."""
    at = mink.Configuration(mujoco.MjModel.from_xml_string(text), q=Q0.copy())
    task = mink.FrameTask(TIP, "body", position_cost=1.0, orientation_cost=1.0, gain=gain)
    start = at.get_transform_frame_to_world(TIP, "body")
    turned = start.rotation() @ mink.SO3.exp(TURN)
    task.set_target(mink.SE3.from_rotation_and_translation(turned, start.translation() + SHIFT))
    errors = [task.compute_error(at)]
    for _ in range(steps):
        velocity = mink.solve_ik(at, [task], dt, "daqp", limits=[])
        at.integrate_inplace(velocity, dt)
        errors.append(task.compute_error(at))
    return np.array(errors)


LOOPS = {"pink": with_pink, "mink": with_mink}


def held(loop, text, share, alpha, dt) -> tuple:
    """(‖e‖ in the end over ‖e₀‖ e^{−alpha·t}, overshoot −e·e₀/‖e₀‖²) of a run; NaN where the gain is refused."""
    steps = round(TIME / dt)
    try:
        e = loop(text, SHARES[share](alpha, dt), dt, steps)
    except mink.InvalidGain:
        return math.nan, math.nan
    size = np.linalg.norm(e, axis=1)
    return size[-1] / size[0] / math.exp(-alpha * TIME), max(0.0, -float(np.min(e @ e[0]) / size[0] ** 2))


def main():
    text = urdf()
    print(f"‖e(t)‖ after {TIME:g} s over ‖e₀‖ e^{{−alpha·t}}, alpha = 5 1/s: 1 is what the law says\n")
    print("| | gain | " + " | ".join(f"dt = {dt:g} s" for dt in STEPS) + " |")
    print("| --- | --- |" + " ---: |" * len(STEPS))
    for name, loop in LOOPS.items():
        for share in SHARES:
            ratios = [held(loop, text, share, 5.0, dt)[0] for dt in STEPS]
            print(f"| {name} | {share} | " + " | ".join(f"{r:.3f}" for r in ratios) + " |", flush=True)
            if share.startswith("1"):
                assert max(abs(r - 1.0) for r in ratios) < TOLERANCE, ratios
    print("\nOvershoot (how far beyond the target, as a share of e₀), dt = 0.1 s\n")
    gains = (5.0, 15.0, 25.0, 50.0)
    print("| | gain | " + " | ".join(f"alpha = {a:g} 1/s" for a in gains) + " |")
    print("| --- | --- |" + " ---: |" * len(gains))
    for name, loop in LOOPS.items():
        for share in SHARES:
            beyond = [held(loop, text, share, a, 0.1)[1] for a in gains]
            told = ["refused" if math.isnan(b) else f"{b:.3g}" if b > 1e-3 else "none" for b in beyond]
            print(f"| {name} | {share} | " + " | ".join(told) + " |", flush=True)
            if share.startswith("1"):
                assert max(beyond) < TOLERANCE, beyond


if __name__ == "__main__":
    main()
