"""`python -m tests.bench.reach`: how many targets `cnclik.reach` solves, how soon, and whether its answers are right.

Eight real robots (those of tests/integrate/test_real_robots.py), 10,000 random reachable poses each, every answer
checked by Pinocchio's kinematics; beside it, in turn and on the same targets, Pinocchio in C++ and Robotics Toolbox for
Python; single targets, paths, first answers, targets out of reach; and what each part of the search is worth. Each
section runs in a process of its own, held to one core, with libraries to one thread. Into results/reach: reach.json,
README.md and its figures (see `reach_page`).

    python -m tests.bench.reach                            # all: some 15 minutes
    python -m tests.bench.reach --only robots --targets 1000
    RTB_PYTHON=.../bin/python python -m tests.bench.reach  # an interpreter that has roboticstoolbox
"""

import argparse
import functools
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import jax
import numpy as np
import pinocchio

import cnclik as ck
from cnclik.reaching.result import count as counts
from cnclik.robot.posture import start_posture
from tests.bench import reach_more, reach_page
from tests.bench.cold import environment
from tests.bench.reach_peers import (
    CNCLIK,
    ROBOTS,
    PinocchioReach,
    Robot,
    Worker,
    micro,
    seconds_of,
    share,
    toolbox,
    warm,
)
from tests.bench.timing import processor

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "reach"
TARGETS, PEERS, ROUNDS = 10_000, 2000, 7
PAPERS = (5e-3, 0.05)  # [m], [rad]: what papers on GPUs call solved
THREADS = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
BATCHES = (1, 10, 100, 1000, 10_000, 100_000)


def say(*words):
    """A line of progress."""
    print(*words, file=sys.stderr, flush=True)


# --- sections: each gets how many targets are asked for, and returns what goes into the JSON ----------


def robots(count):
    """Solve rate, wrong answers, evaluations and time on eight robots."""
    rows = []
    for name in ROBOTS:
        robot = Robot(name)
        targets = robot.pose(robot.drawn(count))
        call = functools.partial(ck.reach, robot.chain, targets)
        cold, made = seconds_of(call)
        solved = made.status == 0
        wrong = solved & ~robot.right(made.q, targets)
        times, cpu = warm(call), warm(call, clock=time.process_time)
        spent = np.unique(np.round(np.geomspace(1, max(made.evaluations.max(), 2), 80)))
        rows.append(
            {
                "robot": name,
                "targets": count,
                "solved": share(solved),
                "wrong": share(wrong),
                "statuses": counts(made.status),
                "evaluations": round(float(made.evaluations.mean()), 2),
                "us": micro(times, count),
                "cpu_us": micro(cpu, count),
                "first_s": round(cold, 2),
                "curve": [[int(k), share(solved & (made.evaluations <= k))] for k in spent],
            }
        )
        say({k: v for k, v in rows[-1].items() if k != "curve"})
    return rows


def peers(count):
    """In turn, on the same targets: reach, reach without AVX-512, Pinocchio C++, Robotics Toolbox."""
    rows = []
    for name in ("Panda", "UR5"):
        robot = Robot(name)
        many = robot.pose(robot.drawn(count, seed=23))
        few = many[:PEERS]
        pinocchio = PinocchioReach(robot)
        options = pinocchio.best(few[:200])
        with tempfile.TemporaryDirectory() as scratch:
            bare = {"PATH": scratch}
            workers = {
                "reach, AVX2 only": Worker(robot, many, CNCLIK, scratch, environment={"CFLAGS": "-mno-avx512f"}),
                "reach, no C compiler": Worker(robot, many, CNCLIK, scratch, environment=bare),
                "Robotics Toolbox, ik_LM": toolbox(robot, few, scratch),
            }
            contenders = {
                f"reach, {count:,} at once": (many, timed_reach(robot.chain, many)),
                f"reach, {len(few):,} at once": (few, timed_reach(robot.chain, few)),
                "Pinocchio C++": (few, timed_pinocchio(pinocchio, few, options)),
            } | {label: (many if "reach" in label else few, w.run) for label, w in workers.items() if w}
            found = rounds_of(robot, contenders)
            told = {label: w.about for label, w in workers.items() if w} | {"Pinocchio C++": options._asdict()}
            for worker in filter(None, workers.values()):
                worker.close()
        for row in found:
            rows.append({"robot": name} | row | {"options": told.get(row["name"]) or {}})
            say(rows[-1])
    return rows


def timed_reach(chain, targets):
    """A call for (seconds, q, found), made once before."""

    def run():
        seconds, made = seconds_of(lambda: ck.reach(chain, targets))
        return seconds, made.q, made.solved

    run()
    return run


def timed_pinocchio(peer, targets, options):
    """A call for (seconds, q, found)."""

    def run():
        seconds, (q, found, _) = seconds_of(lambda: peer.run(targets, options))
        return seconds, q, found

    return run


def rounds_of(robot, contenders):
    """Rounds in turn: µs per target, and how many times as long as the first contender (medians, and all rounds)."""
    times = {label: [] for label in contenders}
    last = {}
    for _ in range(ROUNDS):
        for label, (targets, run) in contenders.items():
            seconds, *last[label] = run()
            times[label].append(seconds / len(targets))
    first = next(iter(times.values()))
    rows = []
    for label, (targets, _) in contenders.items():
        q, found = last[label]
        ratios = [t / f for t, f in zip(times[label], first, strict=True)]
        right = robot.right(q, targets)
        rows.append(
            {
                "name": label,
                "targets": len(targets),
                "solved": share(right),
                "wrong": share(found & ~right),
                "us": micro(statistics.median(times[label])),
                "ratio": round(statistics.median(ratios), 2),
                "rounds_us": [micro(t) for t in times[label]],
            }
        )
    return rows


def papers(count):
    """At the tolerance of papers on GPUs, the Panda."""
    robot, rows = Robot("Panda"), []
    targets = robot.pose(robot.drawn(max(count, PEERS), seed=29))
    for size in (1, PEERS, max(count, PEERS)):
        some = targets[:size]
        warm(functools.partial(ck.reach, robot.chain, some, tolerance=PAPERS), 3)
        made = ck.reach(robot.chain, some, tolerance=PAPERS)
        right = robot.right(made.q, some, PAPERS)
        if size == 1:
            each = iter(list(targets[:200]) * 2)
            seconds = warm(lambda each=each: ck.reach(robot.chain, next(each), tolerance=PAPERS), 300)
        else:
            seconds = warm(functools.partial(ck.reach, robot.chain, some, tolerance=PAPERS))
        row = {"batch": size, "solved": share(made.solved), "wrong": share(made.solved & ~right)}
        rows.append(row | {"us_per_target": micro(seconds, size), "us_per_batch": micro(seconds)})
        say(rows[-1])
    return rows


def single(count):
    """One target from Python, warm; steps along a line; and first answers in fresh processes."""
    out = {}
    for name in ("Panda", "UR5"):
        robot = Robot(name)
        targets = robot.pose(robot.drawn(400, seed=31))
        for T in targets[:4]:  # the quicker form is compiled when a chain has been asked of a few times
            ck.reach(robot.chain, T)
        times, found = zip(*(seconds_of(functools.partial(ck.reach, robot.chain, T)) for T in targets), strict=True)
        q = np.stack([f.q for f in found])
        solved = np.array([bool(f.solved) for f in found])
        row = {"us": micro(statistics.median(times)), "us_mean": micro(statistics.fmean(times))}
        row |= {"us_99": micro(float(np.quantile(times, 0.99))), "solved": share(solved)}
        row |= {"wrong": share(solved & ~robot.right(q, targets)), "near": near(robot)}
        row["cold"] = {str(k): cold(robot, targets[:1][0] if k == 1 else robot.pose(robot.drawn(k))) for k in (1, 1000)}
        out[name] = row
        say(name, row)
    return out


def near(robot, steps=200):
    """1 mm steps along a line, each from the answer before it."""

    def ask(T, q):
        return ck.reach(robot.chain, T, near=q, jump=0.1)

    q = start_posture(robot.chain, ck.pose())
    start = robot.pose(q[None])[0]
    line = np.tile(start, (steps, 1, 1))
    toward = -start[:3, 3] / np.linalg.norm(start[:3, 3])  # to the base: away from where the arm ends
    line[:, :3, 3] += 1e-3 * np.arange(1, steps + 1)[:, None] * toward
    warm(functools.partial(ask, line[0], q), 4)
    times, found, looks = [], [], []
    for T in line:
        seconds, made = seconds_of(functools.partial(ask, T, q))
        q = made.q if made.status == ck.ReachStatus.SOLVED else q
        times.append(seconds), found.append(made.q), looks.append(int(made.evaluations))
    right = robot.right(np.stack(found), line)
    us = {"us": micro(statistics.median(times)), "us_99": micro(float(np.quantile(times, 0.99)))}
    return us | {"right": share(right), "evaluations": statistics.fmean(looks)}


FIRST = """
import time; begun = time.perf_counter()
import sys, numpy as np, cnclik as ck
targets, chain = np.load(sys.argv[1]), ck.load_urdf(sys.argv[2], sys.argv[3])
ready = time.perf_counter()
made = ck.reach(chain, targets)
print(ready - begun, time.perf_counter() - ready)
"""


def cold(robot, targets, rounds=3):
    """Seconds of the import and of the first call, in fresh processes without compiled programs of others; medians."""
    said = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            np.save(f"{folder}/targets.npy", targets)
            tip = ROBOTS[robot.name][1]
            command = [sys.executable, "-c", FIRST, f"{folder}/targets.npy", str(robot.path), tip]
            run = subprocess.run(
                command, env=environment(f"{folder}/cache"), capture_output=True, text=True, check=True
            )
            said.append([float(s) for s in run.stdout.split()])
    imported, first = (round(statistics.median(s), 2) for s in zip(*said, strict=True))
    return {"import_s": imported, "first_s": first, "sum_s": round(imported + first, 2)}


def scaling(count):
    """µs per target of the Panda for batches of many sizes, on the cores this process may use."""
    robot = Robot("Panda")
    targets = robot.pose(robot.drawn(BATCHES[-1], seed=37))
    rows = []
    for size in reversed(BATCHES):
        call = functools.partial(ck.reach, robot.chain, targets[0] if size == 1 else targets[:size])
        warm(call, 4)
        rows.insert(0, [size, micro(warm(call, 41 if size < 100 else 5), size)])
        say(rows[0])
    return {str(len(os.sched_getaffinity(0))): rows}


more = reach_more.beyond, reach_more.path, reach_more.parts
SECTIONS = {f.__name__: f for f in (robots, peers, papers, single, *more, scaling)}


# --- the run ------------------------------------------------------------------------------------------


def machine():
    """What it ran on."""
    with open("/proc/cpuinfo") as info:
        flags = info.read()
    versions = {"jax": jax.__version__, "numpy": np.__version__, "pinocchio": pinocchio.__version__}
    wide = {"avx512": "avx512f" in flags, "cores": os.cpu_count(), "load": [round(v, 1) for v in os.getloadavg()]}
    return {"cpu": processor(), **wide, "python": sys.version.split()[0], **versions}


def apart(section, count, cores):
    """A section in a process of its own that may use so many cores."""
    every = os.sched_getaffinity(0)
    command = [sys.executable, "-m", "tests.bench.reach", "--targets", str(count), "--section", section]
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "JAX_PERSISTENT", "XLA_FLAGS"))}
    os.sched_setaffinity(0, sorted(every)[-cores:])  # which the process inherits, before it loads anything
    try:
        run = subprocess.run(command, env=kept | THREADS, stdout=subprocess.PIPE, text=True, check=True)
    finally:
        os.sched_setaffinity(0, every)
    return json.loads(run.stdout.splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=list(SECTIONS), default=list(SECTIONS), metavar="SECTION")
    parser.add_argument("--targets", type=int, default=TARGETS, metavar="N")
    parser.add_argument("--section", choices=[*SECTIONS, "machine"], help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.section:
        print(json.dumps(machine() if asked.section == "machine" else SECTIONS[asked.section](asked.targets)))
        return
    file = RESULTS / "reach.json"
    found = json.loads(file.read_text()) if file.exists() else {}
    for section in ("machine", *asked.only):
        say("---", section)
        found[section] = apart(section, asked.targets, 1)
        if section == "scaling" and len(os.sched_getaffinity(0)) > 1:
            found[section] |= apart(section, asked.targets, 2)
        RESULTS.mkdir(parents=True, exist_ok=True)
        file.write_text(reach_page.text(found))
    reach_page.write(found, RESULTS)


if __name__ == "__main__":
    main()
