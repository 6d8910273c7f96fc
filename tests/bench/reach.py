"""`python -m tests.bench.reach`: what `cnclik.reach` solves, whether its answers are right, and how soon, as tables.

Eight real robots, a Z1, a planar arm and Baxter's two arms; random reachable poses, every answer of the eight checked
by Pinocchio's kinematics. All times are CPU times of one process on one core, of
rounds in turn; medians. `--against TREE` has another checkout of cnclik in the same rounds: ratios are times of this
one over that. `docs/reach.md` has its tables.

    python -m tests.bench.reach                              # some 10 minutes
    python -m tests.bench.reach --only Panda UR5 --targets 2000 --against ../cnclik-0.3
"""

import argparse
import json
import os
import pathlib
import pickle
import statistics
import subprocess
import sys
import tempfile

import numpy as np

import cnclik as ck
from cnclik.reaching.result import count as counts
from cnclik.reaching.starts import spans
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from tests.bench import timing
from tests.bench.reach_peers import Robot
from tests.oracles import ARMS, robots
from tests.robot.test_trees import BAXTER, GRIPPERS

Z1 = "z1_description/urdf/z1.urdf"
OTHERS = ("Z1", "planar", "Baxter, two arms")
ROUNDS, ALONE, SOME = 5, 200, 2000
# The other process: it may be another version of cnclik.
WORKER = """
import json, pickle, resource, sys
import cnclik as ck

def spent():
    each = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(v.ru_utime + v.ru_stime for v in each)

def some(count):
    return {k: v[:count] for k, v in targets.items()} if isinstance(targets, dict) else targets[:count]

def one(k):
    return {name: v[k] for name, v in targets.items()} if isinstance(targets, dict) else targets[k]

for line in sys.stdin:
    verb, value = json.loads(line)
    begun = spent()
    if verb == "begin":
        build, task, targets = pickle.load(open(value, "rb"))
        chain, task = eval(build), eval(task)
        begun = spent()
        ck.reach(chain, one(0), task=task)
        answer = {"s": spent() - begun}
        ck.reach(chain, targets, task=task)
    elif verb == "many":
        made = ck.reach(chain, some(value), task=task)
        answer = {"s": spent() - begun, "q": made.q.tolist(), "status": made.status.tolist()}
    else:
        for k in range(value):
            ck.reach(chain, one(k), task=task)
        answer = {"s": spent() - begun}
    print(json.dumps(answer), flush=True)
"""


def tips(chain, q, tip=None):
    """4×4 transforms (B, 4, 4) of a tip."""
    at, made = At(modelled(chain), q), np.tile(np.eye(4), (len(q), 1, 1))
    made[:, :3, 3], made[:, :3, :3] = at.position(tip, None), at.rotation(tip, None)
    return made


def asked(name, count):
    """(how to build the robot, and its task, as Python; targets; the robot beside Pinocchio or None)"""
    if name in ARMS:
        robot, (file, tip, base) = Robot(name), ARMS[name]
        build = f"ck.load_urdf({str(robots() / file)!r}, {tip!r}, {base!r})"
        return build, "'pose'", robot.pose(robot.drawn(count)), robot
    build, task = "ck.planar_arm([0.5, 0.4, 0.3])", "ck.position('xy')"
    if name == "Z1":
        build, task = f"ck.load_urdf({str(robots() / Z1)!r}, 'gripperStator')", "'pose'"
    elif name != "planar":
        build = f"ck.load_urdf({str(BAXTER)!r}, tips={GRIPPERS!r})"
        task = "ck.stack(" + ", ".join(f"{tip}=ck.pose(tip={tip!r})" for tip in GRIPPERS) + ")"
    chain = eval(build, {"ck": ck})
    q = np.random.default_rng(17).uniform(*spans(chain), (count, chain.n))
    if name == "Baxter, two arms":
        return build, task, {tip: tips(chain, q, tip) for tip in GRIPPERS}, None
    made = tips(chain, q)
    return build, task, made[:, :3, 3] if name == "planar" else made, None


class Worker:
    """A process of its own that asks for the targets of one robot."""

    def __init__(self, tree, given):
        threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
        fresh = {"PYTHONPATH": str(tree), "JAX_ENABLE_COMPILATION_CACHE": "0"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", WORKER],
            env=os.environ | threads | fresh,
            cwd=tree,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.first = self.ask("begin", given)["s"]

    def ask(self, verb, value):
        """What it says; `s` are seconds of CPU time."""
        self.process.stdin.write(json.dumps([verb, value]) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())


def measured(name, count, trees, rounds):
    """A row of the table: a robot's numbers here, and times over those of the other tree if there is one."""
    build, task, targets, robot = asked(name, count)
    with tempfile.NamedTemporaryFile() as file:
        pickle.dump((build, task, targets), file)
        file.flush()
        workers = [Worker(tree, file.name) for tree in trees]
    kinds = (("many", count), ("many", min(SOME, count)), ("alone", min(ALONE, count)))
    times = np.array([[[w.ask(*kind)["s"] for w in workers] for kind in kinds] for _ in range(rounds)])
    last = [worker.ask("many", count) for worker in workers]
    for worker in workers:
        worker.process.stdin.close()
        worker.process.wait()
    own, status = last[0], np.array(last[0]["status"])
    right = "" if robot is None else f"{int(robot.right(np.array(own['q']), targets).sum()):,}"
    us = [f"{1e6 * statistics.median(times[:, k, 0]) / kind[1]:.3g}" for k, kind in enumerate(kinds)]
    row = [name, f"{int((status == 0).sum()):,}", right, *us, f"{workers[0].first:.2f}"]
    if len(trees) > 1:
        ratios = [f"{statistics.median(times[:, k, 0] / times[:, k, 1]):.2f}" for k in range(len(kinds))]
        row += [f"{int((np.array(last[1]['status']) == 0).sum()):,}", *ratios, f"{workers[1].first:.2f}"]
    return row, (counts(status) if (status != 0).any() else None)


COLUMNS = ["robot", "solved", "right by Pinocchio", "µs", "µs of 2000", "µs alone", "first call s"]
MORE = ["solved before", "µs over before", "of 2000", "alone", "first call before s"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=[*ARMS, *OTHERS], metavar="ROBOT")
    parser.add_argument("--targets", type=int, default=20_000, metavar="N")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--against", type=pathlib.Path, metavar="TREE")
    args = parser.parse_args()
    here = pathlib.Path(__file__).parents[2]
    trees = [here, args.against.resolve()] if args.against else [here]
    timing.one_core()
    columns = COLUMNS + MORE * (args.against is not None)
    print(f"| {' | '.join(columns)} |\n|{' --- |' * len(columns)}", flush=True)
    for name in args.only or [*ARMS, *OTHERS]:
        row, missed = measured(name, args.targets, trees, args.rounds)
        print(f"| {' | '.join(row)} |", *([missed] if missed else []), flush=True)


if __name__ == "__main__":
    main()
