"""`python -m tests.bench.limits`: what limits cost on one core, and how many passes bounded() makes (5 minutes).

Random postures of the Panda and of G1 (five tips, 30 coordinates; 29 joints, or 35 with those of a free base that has
no limits), a quarter of the joints next to a limit; what is asked is 0.03 to 10 times what the joints do (`draws` of
tests/law/test_bounded.py). Times are CPU time of an evaluation, rows of J included, by `ck.lanes`, medians of rounds in
turn; passes are counted lane by lane.
"""

import functools

import jax
import numpy as np

import cnclik as ck
from cnclik.law.bounded import Problem, descent
from cnclik.law.law import resolve, rows_at
from cnclik.robot.model import modelled
from tests.bench import timing
from tests.law.test_bounded import capped, draws, robot_and_task

COUNT, ROUNDS, SHORTEST = 60_000, 9, 0.2  # [1, 1, s]
DAMPING = 0.05
TIP, PILLAR = ck.panda().tips[0].name, ck.capsule(None, 0.1, (0.5, 0.3, 0.0), (0.5, 0.3, 0.6))
WALLS = [ck.wall(ck.position(axis), above=least) for axis, least in (("z", 0.0), ("x", -0.5), ("y", -0.6))]
WALLS += [ck.wall(ck.distance(ck.sphere(TIP, 0.08), PILLAR), above=0.01)]
LIMITS = {"none": None, "bounded": ck.bounded(), "walls": ck.bounded(walls=WALLS)}
TIMED = {"panda": ("none", "bounded", "walls"), "g1": ("none", "bounded"), "g1_free": ("none", "bounded")}


def passes(name, damping):
    """Of each draw."""
    drawn = draws(name, COUNT, seed=0)

    def one(rows, velocity, null, low, high):
        asked = ck.damped(damping)(rows).apply(velocity)
        found = descent(Problem(rows / damping, velocity / damping, null, low, high), asked, 60)
        return found.passes, found.settled, ((found.qdot <= low) | (found.qdot >= high)).any()

    made = jax.jit(jax.vmap(one))(*(jax.device_put(v) for v in drawn[:5]))
    return map(np.asarray, made)


def evaluation(name, limits, dtype):
    """A call that evaluates the law for all draws, and how many they are."""
    robot, task = robot_and_task(name)
    robot = ck.replace(robot, velocity_limit=tuple(capped(robot).tolist()))
    law = ck.Law(robot, task, alpha=1.0, inverse=ck.damped(DAMPING), limits=LIMITS[limits])
    law = ck.replace(law, chain=modelled(robot))
    with jax.enable_x64(True):
        drawn = draws(name, COUNT, seed=0)
    asked = drawn.velocity / np.asarray(law.task.weights)

    def one(q, velocity):
        return resolve(law, q, rows_at(law, q), velocity, None).qdot

    return functools.partial(ck.lanes(one, cores=1), drawn.q.astype(dtype), asked.astype(dtype))


def main():
    """Print both tables."""
    print("| robot | λ | passes, mean | 99.9 % | most | not settled | at a bound |\n| --- " + "| ---: " * 6 + "|")
    with jax.enable_x64(True):
        for name in TIMED:
            for damping in (0.05, 1e-3):
                count, settled, limited = passes(name, damping)
                row = f"{count.mean():.2f} | {np.quantile(count, 0.999):.0f} | {count.max()} | {(~settled).sum()}"
                print(f"| {name} | {damping:g} | {row} | {limited.mean():.0%} |", flush=True)
    print("\n| robot | dtype | limits | ns an evaluation | more than without |\n| --- | --- | --- | ---: | ---: |")
    for name, every in TIMED.items():
        for dtype in ("float32", "float64"):
            with jax.enable_x64(dtype == "float64"):
                calls = {limits: evaluation(name, limits, dtype) for limits in every}
                for call in calls.values():
                    call()
                times = {k: 1e9 * np.array(v) / COUNT for k, v in timing.in_turn(calls, ROUNDS, SHORTEST).items()}
                for limits in every:
                    own, more = (np.median(times[limits] - sub * times["none"]) for sub in (0, 1))
                    print(f"| {name} | {dtype} | {limits} | {own:.0f} | {more:.0f} |", flush=True)


if __name__ == "__main__":
    main()
