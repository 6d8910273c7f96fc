"""`python -m tests.bench.first`: how soon each library has answered the same question, in a process of its own.

The question: from a URDF file, 400 steps of 10 ms of one arm's tip around a circle of 0.1 m, its orientation held. Wall
time from start to end of the process, imports included; rounds in turn, medians. cnclik cold has an empty cache folder.
Needs `pip install -e .[bench]`.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

from cnclik.measure.files import markdown
from tests.bench.cold import arm, environment

_PINK = """
import sys, numpy as np, pinocchio as pin, pink
from pink.tasks import FrameTask
model = pin.buildModelFromUrdf(sys.argv[1])
at = pink.Configuration(model, model.createData(), np.array(Q0))
task = FrameTask("l7", position_cost=1.0, orientation_cost=1.0, gain=GAIN)
start = at.get_transform_frame_to_world("l7")
for k in range(400):
    turn = 2 * np.pi * k / 400
    task.set_target(pin.SE3(start.rotation, start.translation + 0.1 * np.array([np.cos(turn) - 1, np.sin(turn), 0])))
    at.integrate_inplace(pink.solve_ik(at, [task], 0.01, solver="daqp"), 0.01)
"""

_MINK = """
import sys, numpy as np, mujoco, mink
at = mink.Configuration(mujoco.MjModel.from_xml_path(sys.argv[1]), q=np.array(Q0))
task = mink.FrameTask("l7", "body", position_cost=1.0, orientation_cost=1.0, gain=GAIN)
start = at.get_transform_frame_to_world("l7", "body")
for k in range(400):
    turn = 2 * np.pi * k / 400
    place = start.translation() + 0.1 * np.array([np.cos(turn) - 1, np.sin(turn), 0])
    task.set_target(mink.SE3.from_rotation_and_translation(start.rotation(), place))
    at.integrate_inplace(mink.solve_ik(at, [task], 0.01, "daqp"), 0.01)
"""

_CNCLIK = """
import sys, jax, numpy as np, cnclik as ck
jax.config.update("jax_enable_x64", True)
ck.use_cache()
problem = ck.problem_from(sys.argv[1], q0=Q0, reference="circle", radius=0.1, period=4.0, alpha=GAIN / 0.01, Ts=0.01)
np.asarray(ck.solve(problem.law, problem.reference, problem.q0, 0.01, 400, METHOD).q)
"""

Q0 = "[0.3, 0.6, -0.4, 0.8, 0.5, -0.7, 0.2]"


def _script(text, method="ck.EE"):
    return text.replace("Q0", Q0).replace("GAIN", "0.05").replace("METHOD", method)


def _seconds(script, urdf, folder):
    begun = time.perf_counter()
    command = [sys.executable, "-c", script, urdf]
    done = subprocess.run(command, env=environment(folder), capture_output=True, text=True)
    seconds = time.perf_counter() - begun
    if done.returncode:
        raise RuntimeError(done.stderr.strip().split("\n")[-1])
    return seconds


def measure(rounds):
    """Seconds of each library, one list of rounds each."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        urdf = arm(folder)
        for k in range(rounds):
            empty = os.path.join(folder, f"cache{k}")
            for name, script, cache in (
                ("pink", _script(_PINK), empty),
                ("mink", _script(_MINK), empty),
                ("cnclik EE, cold", _script(_CNCLIK), empty),
                ("cnclik EE, again", _script(_CNCLIK), empty),
                ("cnclik CN, cold", _script(_CNCLIK, "ck.CN"), os.path.join(folder, f"cache{k}-cn")),
                ("cnclik CN, again", _script(_CNCLIK, "ck.CN"), os.path.join(folder, f"cache{k}-cn")),
            ):
                found.setdefault(name, []).append(_seconds(script, urdf, cache))
    return found


def table(found) -> str:
    """What was measured, as Markdown."""
    rows = [(name, f"{statistics.median(v):.2f}", f"{min(v):.2f} to {max(v):.2f}") for name, v in found.items()]
    return markdown(("library", "median [s]", "range [s]"), rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=pathlib.Path)
    args = parser.parse_args()
    found = measure(args.rounds)
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n")
    print(table(found))


if __name__ == "__main__":
    main()
