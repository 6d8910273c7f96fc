"""`python -m tests.bench.first`: how soon each library has answered the same question, in a process of its own.

The question: from a URDF file, 400 steps of 10 ms of one arm's tip around a circle of 0.1 m, its orientation held.
Times are from start to end of the process, imports and compilers included; rounds in turn, medians; "again" finds what
the first process kept. `--commands` asks the command line instead. Needs `pip install -e .[bench]`.
"""

import argparse
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

from cnclik.measure.files import markdown

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
path = dict(q0=Q0, reference="circle", radius=0.1, period=4.0)
problem = ck.problem.problem_from(sys.argv[1], alpha=GAIN / 0.01, Ts=0.01, **path)
np.asarray(ck.solve(problem.law, problem.reference, problem.q0, 0.01, 400, METHOD).q)
"""

Q0 = "[0.3, 0.6, -0.4, 0.8, 0.5, -0.7, 0.2]"


COMMANDS = (  # arguments of `cnclik`, run in a folder with arm.urdf
    "--help",
    "solve arm.urdf --reference circle --method EXP-MIDPOINT --N 400 --no-figures",
    "solve arm.urdf --reference circle --method CN --damping 0.05 --limits bounded --N 400 --no-figures",
    "stability --delay 34ms",
    "stability arm.urdf --draw map",
    "reproduce",
)


def run(command, folder, cache) -> tuple:
    """(wall seconds, CPU seconds, largest memory [MiB]) of a process, its own start and its compilers included."""
    with open(os.path.join(folder, "said"), "w+", encoding="utf-8") as said:
        begun = time.perf_counter()
        process = subprocess.Popen(
            command, env=environment(cache), cwd=folder, stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - begun
        if process.returncode:
            said.seek(0)
            raise RuntimeError(said.read().strip().split("\n")[-1])
    return seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**10


def environment(cache) -> dict:
    """Variables for a process that runs the package that measures, and keeps its programs below a folder."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "JAX_PERSISTENT"))}
    path = os.pathsep.join(filter(None, (str(pathlib.Path(__file__).parents[2]), kept.get("PYTHONPATH"))))
    return kept | {"XDG_CACHE_HOME": cache, "PYTHONPATH": path}


def arm(folder) -> str:
    """A URDF file of seven revolute joints, a little less than 1 m long."""
    inertia = " ".join(f'i{a}="{0.01 * (a in ("xx", "yy", "zz"))}"' for a in ("xx", "yy", "zz", "xy", "xz", "yz"))
    inertial = f'<inertial><mass value="1"/><inertia {inertia}/></inertial>'
    links = "".join(f'<link name="l{i}">{inertial}</link>' for i in range(8))  # simulators want masses
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{0.02 * (i % 3)} 0 0.13" rpy="{1.5707963267948966 * (-1) ** i} 0 0.1"/><axis xyz="0 0 1"/>'
        '<limit lower="-2.9" upper="2.9" velocity="2" effort="50"/></joint>'
        for i in range(7)
    )
    path = os.path.join(folder, "arm.urdf")
    pathlib.Path(path).write_text(f'<robot name="arm">{links}{joints}</robot>', encoding="utf-8")
    return path


def question(peers):
    """(name, command) of the same question to each library."""
    scripts = {"pink": _PINK, "mink": _MINK} if peers else {}
    scripts |= {f"cnclik {method}": _CNCLIK.replace("METHOD", f'"{method}"') for method in ("EE", "CN")}
    for name, script in scripts.items():
        yield name, [sys.executable, "-c", script.replace("Q0", Q0).replace("GAIN", "0.05"), "arm.urdf"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--commands", action="store_true", help="of the command line instead")
    parser.add_argument("--alone", action="store_true", help="without pink and mink")
    args = parser.parse_args()
    lines = list(question(not args.alone))
    if args.commands:
        lines = [(f"`{line}`", [sys.executable, "-m", "cnclik", *line.split()]) for line in COMMANDS]
    times: dict = {}
    for _ in range(args.rounds):
        for name, command in lines:
            with tempfile.TemporaryDirectory() as folder:
                arm(folder)
                for which in ("cold", "again"):
                    times.setdefault((name, which), []).append(run(command, folder, os.path.join(folder, "cache")))
    rows = []
    for (name, which), each in times.items():
        wall, cpu, memory = (statistics.median(column) for column in zip(*each, strict=True))
        rows.append((name, which, f"{wall:.2f}", f"{cpu:.2f}", f"{memory:.0f}"))
    print(markdown(("", "", "wall [s]", "CPU [s]", "memory [MiB]"), rows, left=2))


if __name__ == "__main__":
    main()
