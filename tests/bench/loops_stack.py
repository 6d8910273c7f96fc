"""What the advice for a stack is worth: both arms of a Baxter in MuJoCo, on servos, with dead time, friction, encoders.

A stack of both hands' poses and a posture, in two levels. Each cell records a step of all joints, fits the drive, asks
`ck.gains` for the gain of all tasks, and runs the loop with it from hands 3 cm and 60 mrad away from their targets:
does an error grow, and how far does a hand go beyond its target?

    python -m tests.bench.loops_stack                 # 20 cells, a few minutes, into results/loops/stack.json
    python -m tests.bench.loops_stack --cells 4
"""

import argparse
import json
import pathlib

import mujoco
import numpy as np

import cnclik as ck
from cnclik.diagnosis.fit import fit_drive
from cnclik.record import replace
from tests.bench.loops_advice import SERVOS, WORLDS, beyond, recorded, unstable
from tests.bench.loops_arms import Arm
from tests.bench.loops_mujoco import Setup, begin, rotation_of
from tests.oracles import robot_file

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "loops" / "stack.json"
HANDS = ("right_gripper", "left_gripper")  # in the order of the file
AWAY = np.array([0.018, -0.015, 0.019, 0.035, 0.03, -0.035])  # of the hands from their targets [m, rad]
RATES, DELAYS, SECONDS = (100, 250, 500), (0, 1, 3, 5, 8), 3.0


class BothArms(Arm):
    """Baxter's arms at rest, and their stack; its gain is 1 until one is recommended."""

    def __init__(self):
        self.name, self.path, self.tip = "Baxter", robot_file("baxter"), None
        self.chain = ck.load_urdf(self.path, tips=list(HANDS))
        self.n = self.chain.n
        self.q = np.array([0.3, -0.4, 0.2, 1.2, -0.3, 0.7, 0.1, -0.3, -0.5, -0.1, 1.1, 0.4, 0.8, -0.2])
        tasks = ck.stack(hands=ck.pose(tip=HANDS[0]), others=ck.pose(tip=HANDS[1]), rest=ck.joints())
        levels = ck.levels(["hands", "others"], ["rest"], damping=(1e-3, 0.3))
        self.law = ck.Law(self.chain, tasks, alpha=1.0, inverse=levels)
        self.text = self._urdf()


def run(setup, law, delay, N):
    """Errors (N + 1, 2, 6) of the hands."""
    arm, servo, Ts, _, physics, world = setup
    model, position = arm.model(servo, physics, world), servo.command == "position"
    data, rest = mujoco.MjData(model), arm.q if position else np.zeros(arm.n)
    begin(data, arm.q, rest)
    paths = {}
    for name, hand in zip(("hands", "others"), HANDS, strict=True):
        at = ck.forward(arm.chain, arm.q, tip=hand)
        turn = rotation_of(AWAY[3:])
        paths[name] = ck.hold(np.asarray(at.position) + AWAY[:3], turn @ np.asarray(at.rotation))
    paths = ck.hold_at(arm.chain, law.task, arm.q, **paths)
    line, sent, e = [rest] * (delay + 1), arm.q, np.full((N + 1, 2, 6), np.nan)
    for k in range(N + 1):
        seen = np.round(data.qpos / world.resolution) * world.resolution if world.resolution else data.qpos.copy()
        made = ck.step(law, paths, seen, k * Ts, Ts, "EE")
        e[k] = np.asarray(ck.step(law, paths, data.qpos.copy(), k * Ts, Ts, "EE").e)[:12].reshape(2, 6)
        if np.abs(e[k]).max() > 1.0:
            break
        step = np.asarray(made.q) - seen
        sent = sent + step
        line = [rest + world.gain * ((sent if position else step / Ts) - rest), *line[:-1]]
        data.ctrl.reshape(-1, arm.n)[:] = line[-1]
        mujoco.mj_step(model, data, round(Ts / physics))
    return e


def measure(arm, servo, rate, delay, world) -> dict:
    """One cell."""
    Ts = 1.0 / rate
    setup = Setup(arm, SERVOS[servo], Ts, "measured", min(Ts, 2e-3 if rate <= 250 else 1e-3), WORLDS[world])
    row = dict(servo=servo, rate=rate, delay=delay, world=world)
    fit = fit_drive(None, *recorded(setup, delay), Ts, command_kind=setup.servo.command)
    alpha = ck.gains(Ts=Ts, method="EE", drive=fit.drive).recommended
    e = run(setup, replace(arm.law, alpha=alpha), delay, round(SECONDS / Ts))
    over = [float(beyond(e[:, [i]])[0]) for i in (0, 1)]
    return row | {"alpha": alpha, "over": max(over), "unstable": bool(unstable(e).any())}


def cells(count):
    for i in range(count):
        servo, world = list(SERVOS)[i % len(SERVOS)], list(WORLDS)[(3 * i) % len(WORLDS)]
        yield servo, RATES[i % 3], DELAYS[(2 * i + i // 5) % 5], world


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=20)
    count = parser.parse_args().cells
    arm, rows = BothArms(), []
    for cell in cells(count):
        rows.append(measure(arm, *cell))
        print(rows[-1], flush=True)
    grown, over = sum(r["unstable"] for r in rows), sum(r["over"] > 0.05 for r in rows)
    print(f"{len(rows)} cells: {grown} unstable, {over} beyond their targets by more than 5 %")
    if count >= 20:
        RESULTS.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
