"""Sections of `tests.bench.reach`: targets out of reach, paths, and what each part of the search is worth."""

import contextlib
import functools
import statistics
import sys
from unittest import mock

import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.spatial

import cnclik as ck
from cnclik.reaching import many, native, step, strategy
from cnclik.reaching.result import ReachStatus
from cnclik.reaching.result import count as counts
from cnclik.robot.model import frames, modelled
from cnclik.robot.posture import arm_length, start_posture
from tests.bench.reach_peers import PinocchioOptions, PinocchioReach, Robot, micro, seconds_of, share

POSTURES, CHUNK, REFINED = 3_000_000, 100_000, 8  # of the brute-force search, and how many of them go downhill
CHECKED = 50
STEP = step.damped_step
LONG = PinocchioOptions(1e-9, 0.1, 30, 1000)  # a long search: did reach miss an answer?


# --- out of reach -------------------------------------------------------------------------------------


def beyond(count):
    """Positions beyond an arm's length and all about one, and poses that only postures beyond the limits have."""
    panda, icub, some = Robot("Panda"), Robot("iCub arm"), min(1000, count)
    return {
        "Panda, positions beyond the arm's length": positions(panda, about(panda, some, 1.02, 1.5)),
        "iCub arm, positions all about": positions(icub, about(icub, some, 0.0, 1.0)),
        "Panda, poses of postures beyond the limits": holes(panda, some),
    }


def about(robot, some, least, most):
    """Positions (some, 3) in all directions from the first joint, between such shares of the arm's length."""
    rng = np.random.default_rng(41)
    toward = rng.normal(size=(some, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    middle = np.array(robot.chain.joints[0].origin.position)
    return middle + toward * arm_length(robot.chain) * rng.uniform(least, most, (some, 1))


def positions(robot, targets):
    """What becomes of position targets (B, 3), and how near the nearest posture is beside a brute-force search."""
    ck.reach(robot.chain, targets[:100], task="position")
    seconds, made = seconds_of(functools.partial(ck.reach, robot.chain, targets, task="position"))
    whole = np.tile(np.eye(4), (len(targets), 1, 1))
    whole[:, :3, 3] = targets
    solved = made.status == 0
    wrong = solved & ~robot.right(made.q, whole, turn=False)
    ids = np.flatnonzero(~solved)[:CHECKED]
    own = np.linalg.norm(robot.pose(made.q[ids])[:, :3, 3] - targets[ids], axis=1)
    brute = Brute(robot)
    best = np.array([brute.nearest(targets[k]) for k in ids])
    row = {"targets": len(targets), "statuses": counts(made.status), "wrong": share(wrong)}
    row |= {"us": micro(seconds, len(targets)), "evaluations": round(float(made.evaluations.mean()), 1)}
    if len(ids):
        within = (own <= 1.01 * best + 1e-6).mean()
        row |= {"searched": len(ids), "within_1_percent": round(float(within), 4)}
        row |= {"largest_ratio": round(float((own / best).max()), 4), "missed": int((best < 1e-6).sum())}
        row |= {"least_ratio": round(float((own / best).min()), 6)}
        row |= {"told_stationary": share(made.status[ids] != int(ReachStatus.OUT_OF_BUDGET))}
    print(row, file=sys.stderr, flush=True)
    return row


class Brute:
    """The nearest of millions of random postures, and from the best of them downhill with Pinocchio's Jacobian."""

    def __init__(self, robot):
        self._robot, (low, high) = robot, robot.range()
        rng, chain = np.random.default_rng(43), modelled(robot.chain)
        self._postures = low + (high - low) * rng.random((POSTURES, len(low)))
        parts = [frames(chain, self._postures[i : i + CHUNK]).position for i in range(0, POSTURES, CHUNK)]
        self._tree = scipy.spatial.cKDTree(np.concatenate(parts))
        self._bounds = list(zip(low, high, strict=True))

    def nearest(self, target):
        """Distance [m] of a position (3,) from the nearest posture found."""

        def half_square(q):
            at, rows = self._robot.position(q)
            return 0.5 * np.sum((at - target) ** 2), rows.T @ (at - target)

        _, ids = self._tree.query(target, k=REFINED)
        tight = {"ftol": 1e-16, "gtol": 1e-12, "maxiter": 500}
        runs = (
            scipy.optimize.minimize(half_square, q, jac=True, method="L-BFGS-B", bounds=self._bounds, options=tight)
            for q in self._postures[ids]
        )
        return np.sqrt(2 * min(run.fun for run in runs))


def holes(robot, some):
    """Poses of postures of which a joint at least is beyond its limits: which have an answer within them?"""
    q = np.random.default_rng(42).uniform(-np.pi, np.pi, (4 * some, robot.chain.n))
    q = q[((q < robot.lower) | (q > robot.upper)).any(axis=1)][:some]
    targets = robot.pose(q)
    ck.reach(robot.chain, targets[:100])
    seconds, made = seconds_of(functools.partial(ck.reach, robot.chain, targets))
    solved = made.status == 0
    left = np.flatnonzero(~solved)
    answer, found, _ = PinocchioReach(robot).run(targets[left], LONG)
    row = {"targets": len(targets), "statuses": counts(made.status)}
    row |= {"wrong": share(solved & ~robot.right(made.q, targets)), "us": micro(seconds, len(targets))}
    row |= {"evaluations": round(float(made.evaluations.mean()), 1), "searched": len(left)}
    row["missed"] = int((found & robot.right(answer, targets[left])).sum())
    row["called_out_of_reach"] = int((made.status == ReachStatus.OUT_OF_REACH).sum())
    print(row, file=sys.stderr, flush=True)
    return row


# --- paths --------------------------------------------------------------------------------------------


def path(count):
    """A closed curve through so many waypoints, each from the answer before it, with jump = 0.2."""
    return {name: curve(Robot(name), count) for name in ("Panda", "UR5")}


def curve(robot, count, jump=0.2):
    """Largest joint step between waypoints that follow one another, and jumps told."""
    q = start_posture(robot.chain, ck.pose())
    start, t = robot.pose(q[None])[0], np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    targets = np.tile(start, (count, 1, 1))
    targets[:, :3, 3] += 0.12 * np.stack([np.cos(t) - 1, np.sin(2 * t), 0.5 * np.sin(3 * t)], 1)
    turn = 0.3 * np.stack([np.sin(t), np.sin(2 * t), np.cos(t) - 1], 1)
    targets[:, :3, :3] = start[:3, :3] @ scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
    for _ in range(2):  # the first compiles
        seconds, made = seconds_of(lambda: ck.reach(robot.chain, targets, near="previous", jump=jump))
    solved = made.status == 0
    both = solved[1:] & solved[:-1]
    steps = np.abs(np.diff(made.q, axis=0)).max(axis=1)[both]
    closed = float(np.abs(made.q[-1] - made.q[0]).max())
    row = {"waypoints": count, "statuses": counts(made.status), "wrong": share(solved & ~robot.right(made.q, targets))}
    row |= {"largest_step": float(f"{steps.max():.4g}"), "mean_step": float(f"{steps.mean():.4g}"), "jump": jump}
    row |= {"evaluations": round(float(made.evaluations.mean()), 2), "us": micro(seconds, count)}
    return row | {"from_last_to_first": round(closed, 4)}


# --- what each part is worth --------------------------------------------------------------------------


def _clipped(rows, e, cost, q, low, high, trust):
    """In place of `step.damped_step`: joints at limits stay in."""
    return STEP(rows, e, cost, q, low - jnp.inf, high + jnp.inf, trust)


NEAREST = "nearest(a, target, aim, number % SETS)"
AT_RANDOM = native.SEARCH.replace(
    NEAREST, "a->postures + (number % SETS * SIZE + (number + target) * 40503 % SIZE) * N"
)
PARTS = {  # what is another in the C source, or in the traced step
    "as it is": {},
    "seeds at random, not the nearest": {(native, "SEARCH"): AT_RANDOM},
    "joints at limits clipped only, not taken out": {(step, "damped_step"): _clipped},
    "later tries plain, too": {(strategy, "PLAIN"): 1000},
    "all tries careful": {(strategy, "PLAIN"): 0},
    "first tries of 24 steps, not 9": {(strategy, "STEPS"): 24},
    "by JAX, not as C": {(many, "native_for"): lambda *_: None},
}


@contextlib.contextmanager
def changed(changes):
    """The search with parts changed."""
    with contextlib.ExitStack() as stack:
        for (module, name), value in changes.items():
            stack.enter_context(mock.patch.object(module, name, value))
        yield


def parts(count, rounds=5):
    """Solve rate, evaluations and time of the Panda's targets without one part of the search at a time, in turn."""
    robot = Robot("Panda")
    targets = robot.pose(robot.drawn(count, seed=47))
    chains = {name: ck.replace(robot.chain) for name in PARTS}  # each keeps the code that is built for it
    times, last = {name: [] for name in PARTS}, {}
    for k in range(rounds + 1):
        for name, changes in PARTS.items():
            with changed(changes):
                seconds, last[name] = seconds_of(functools.partial(ck.reach, chains[name], targets))
            if k:
                times[name].append(seconds)
    first, rows = times["as it is"], []
    for name, made in last.items():
        ratios = [t / f for t, f in zip(times[name], first, strict=True)]
        row = {"part": name, "solved": share(made.status == 0), "evaluations": round(float(made.evaluations.mean()), 2)}
        row["wrong"] = share((made.status == 0) & ~robot.right(made.q, targets))
        rows.append(
            row | {"us": micro(statistics.median(times[name]), count), "ratio": round(statistics.median(ratios), 3)}
        )
    return rows
