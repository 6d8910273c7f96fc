"""`python -m tests.bench.reach_several`: `cnclik.reach` for both arms of a robot at once, as a table in Markdown.

Targets are poses of both grippers, and of G1's hands and feet, made by forward kinematics: of postures drawn within the
limits, and of such of which any share of the joints, from none to all, is at a limit. CPU time, one process; 10,000
targets each, of which 300 are also asked for one at a time, and 1,000 without a C compiler.

    python -m tests.bench.reach_several --robots baxter --targets 2000
"""

import argparse
import time

import numpy as np
from cnclik.reaching.seeds import spans

import cnclik as ck
from cnclik.reaching.result import count as counts
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from tests.oracles import robots

ARMS = {
    "baxter": ("baxter_description/urdf/baxter.urdf", "left_gripper", "right_gripper"),
    "pr2": ("pr2_description/urdf/pr2.urdf", "l_gripper_tool_frame", "r_gripper_tool_frame"),
    "talos": ("talos_data/robots/talos_full_v2.urdf", "gripper_left_base_link", "gripper_right_base_link"),
    "g1": (
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        *("left_rubber_hand", "right_rubber_hand", "left_ankle_roll_link", "right_ankle_roll_link"),
    ),
}
ALONE, BY_JAX, ROUNDS = 300, 1000, 3
COLUMNS = (
    "robot, its joints",
    "postures",
    "start",
    "solved",
    "else",
    "evaluations",
    "µs",
    "µs, one at a time",
    "µs by JAX",
)


def asked(name):
    """A robot, the task of its tips, and their poses at postures (B, n)."""
    file, *tips = ARMS[name]
    robot = ck.load_urdf(robots() / file, tips=tips)

    def poses(q):
        at = At(modelled(robot), q)
        return {tip: (at.position(tip), at.rotation(tip)) for tip in tips}

    return robot, ck.stack(**{tip: ck.pose(tip=tip) for tip in tips}), poses


def drawn(robot, count):
    """Joint values (count, n) within the limits, and with joints at limits."""
    low, high = spans(robot)
    rng = np.random.default_rng(7)
    q = rng.uniform(low, high, (count, robot.n))
    at_limit = rng.random(q.shape) < rng.random((count, 1))
    return {"within limits": q, "at limits": np.where(at_limit, np.where(rng.random(q.shape) < 0.5, low, high), q)}


def micro(call, count, rounds=1):
    """The least CPU time of a target [µs], and the last answer."""
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        made = call()
        times.append(time.process_time() - begun)
    return 1e6 * min(times) / count, made


def rows(name, count):
    """Lines of the table."""
    robot, task, poses = asked(name)
    bare, rng = ck.replace(robot), np.random.default_rng(8)

    def some(due, near, ids, chain=robot):
        part = {tip: (p[ids], r[ids]) for tip, (p, r) in due.items()}
        return ck.reach(chain, part, task=task, near=None if near is None else near[ids])

    for kind, q in drawn(robot, count).items():
        due, near = poses(q), np.clip(q + rng.uniform(-0.1, 0.1, q.shape), robot.lower, robot.upper)
        for start, at in (("its own", None), ("within 0.1 rad", near)):
            some(due, at, np.arange(1))
            batch, made = micro(lambda due=due, at=at: some(due, at, slice(None)), count, ROUNDS)
            single = [micro(lambda i=i, due=due, at=at: some(due, at, i), 1)[0] for i in range(min(ALONE, count))]
            with ck.use_engine("xla"):
                few = slice(0, min(BY_JAX, count))
                some(due, at, few, bare)
                by_jax, _ = micro(lambda due=due, at=at, few=few: some(due, at, few, bare), few.stop)
            rest = ", ".join(f"{n} {s}" for s, n in counts(made.status).items() if s != "SOLVED") or "–"
            share, looks = 100 * made.solved.mean(), made.evaluations.mean()
            numbers = f"{share:.2f} %", rest, f"{looks:.0f}", f"{batch:.1f}", f"{np.mean(single):.0f}", f"{by_jax:.0f}"
            yield f"{name}, {robot.n}", kind, start, *numbers


def main():
    """The table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--robots", nargs="+", choices=ARMS, default=list(ARMS))
    options.add_argument("--targets", type=int, default=10_000)
    given = options.parse_args()
    print("|", " | ".join(COLUMNS), "|\n|", " | ".join(["---"] * 3 + ["---:"] * 6), "|")
    for name in given.robots:
        for row in rows(name, given.targets):
            print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main()
