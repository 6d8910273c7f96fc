"""Random loops whose verdict is held against what they do later: `python -m tests.stability.loops --loops 2000`.

A family is a program: robot, task, inverse, limits, method, drive and kind of path. Its loops differ in gain, sampling
time, start, target and number of steps N. Each is run twenty times as long as the longest of its family; what is
judged are its first N steps, and what is true stands in the rest. Each remedy is applied, as data, and run again.
With `--paced 0.2` a fifth of the loops go at a pace, all other draws being the same.
"""

import argparse
import dataclasses
import functools
import re
from collections import Counter
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

import cnclik as ck
import tests.conftest  # noqa: F401  its flags, before JAX computes anything
from cnclik.integrate.method import named
from cnclik.integrate.status import Status
from cnclik.integrate.trajectory import truncate
from cnclik.law.law import evaluate
from cnclik.law.reference import sample
from cnclik.problem.names import task_from
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length
from cnclik.stability import trial
from cnclik.stability.loop import resting
from cnclik.stability.observed import rms
from cnclik.stability.trial import Run, changed, only_longer, times

SHORT, LONG = 200, 20  # most steps that are judged, and how many times as many are run
MOST = 12_000  # steps that a remedy may ask for here
METHODS = ("EE", "IE", "CN", "TRAPEZOID", "HEUN", "RK4", "AB2", "EXP-MIDPOINT", "EXP-RK4", "EXP-AB2")
ROBOTS = {
    "two": (functools.partial(ck.planar_arm, [1.0, 0.8]), ("xy",)),
    "three": (functools.partial(ck.planar_arm, [1.0, 0.5, 0.3]), ("xy", "xyrz")),
    "five": (functools.partial(ck.planar_arm, [1.0] * 5), ("xy", "xyrz")),
    "ur5": (ck.ur5, ("position", "pose")),
    "panda": (ck.panda, ("position", "pose")),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Family:
    """A program."""

    number: int
    robot: str
    task: str
    inverse: str
    limits: str
    method: str
    stage: object
    drive: ck.Drive
    path: str
    feedforward: float
    clamp: bool
    null: str

    @property
    def method_record(self):
        return named(self.method)

    @functools.cached_property
    def chain(self):
        return ROBOTS[self.robot][0]()


def family(number: int, seed: int = 0) -> Family:
    """The family of this number."""
    rng = np.random.default_rng((seed, number))

    def pick(values, p=None):
        return values[rng.choice(len(values), p=p)]

    robot = pick(list(ROBOTS), [0.2, 0.2, 0.2, 0.2, 0.2])
    method = pick(METHODS, [0.25, 0.05, 0.05, 0.05, 0.05, 0.1, 0.1, 0.25, 0.05, 0.05])
    late = [ck.Drive(delay=float(rng.integers(1, 12))), ck.Drive(delay=2.0, lag=0.03), ck.Drive(lag=0.05)]
    late += [ck.Drive(natural_frequency=40.0, damping_ratio=0.8, command="position", delay=1.0)]
    return Family(
        number=number,
        robot=robot,
        task=pick(ROBOTS[robot][1]),
        inverse=pick(("pseudoinverse", "damped", "transpose"), [0.6, 0.3, 0.1]),
        limits=pick(("none", "velocity-scaling", "weighted-least-norm", "saturation"), [0.7, 0.15, 0.1, 0.05]),
        method=method,
        stage=pick((ck.picard(5), ck.chord(2))),
        drive=pick((ck.Drive(), pick(late)), [0.75, 0.25]),
        path=pick(("hold", "line", "circle"), [0.6, 0.2, 0.2]),
        feedforward=pick((1.0, 0.0), [0.8, 0.2]),
        clamp=bool(rng.random() < 0.15),
        null=pick(("", "posture"), [0.85, 0.15]),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Loop:
    """A loop of a family; `reachable` is None where nobody knows."""

    law: ck.Law
    reference: object
    q0: np.ndarray
    Ts: np.ndarray
    N: int
    reachable: bool | None
    pace: ck.Pace | None = None


def posture(chain, rng):
    low, high = (np.clip(np.array(v, float), -np.pi, np.pi) for v in (chain.lower, chain.upper))
    return low + (high - low) * rng.random(chain.n)


def draw(of: Family, number: int, seed: int = 0) -> Loop:
    """The loop of this number."""
    rng, chain, task = np.random.default_rng((seed, of.number, number)), of.chain, _task(of)
    low, high = np.clip(np.array(chain.lower), -7, 7), np.clip(np.array(chain.upper), -7, 7)
    q0 = posture(chain, rng)
    if rng.random() < 0.15:  # stretched, or a rounding beside it
        q0 = np.clip(np.zeros(chain.n) + rng.choice([0.0, 1e-6, 1e-2]) * rng.standard_normal(chain.n), low, high)
    z, Ts = 10 ** rng.uniform(-2.5, 0.7), 10 ** rng.uniform(-3, -1)
    N = round(10 ** rng.uniform(np.log10(3), np.log10(SHORT)))
    kind = rng.choice(["near", "anywhere", "far", "singular", "there"], p=[0.55, 0.25, 0.1, 0.05, 0.05])
    goal = {"near": np.clip(q0 + 10 ** rng.uniform(-2, -0.3) * rng.standard_normal(chain.n), low, high)}
    goal |= {"anywhere": posture(chain, rng), "singular": np.clip(np.zeros(chain.n), low, high), "there": q0}
    end = ck.forward(chain, goal.get(kind, q0))
    position, rotation = np.asarray(end.position, float), np.asarray(end.rotation, float)
    start = ck.forward(chain, q0)
    reachable = kind != "far"
    if not reachable:
        away = rng.standard_normal(3) * np.array([1, 1, 0 if of.robot in ("two", "three", "five") else 1])
        position = away / np.linalg.norm(away) * rng.uniform(1.1, 2.0) * _length(chain)
    if of.path == "hold":
        reference = ck.hold(position, rotation)
    elif of.path == "line":
        reference = ck.line(
            np.asarray(start.position, float),
            position,
            rotation=np.asarray(start.rotation, float),
            rotation_end=rotation,
            duration=jnp.asarray(10 ** rng.uniform(-0.5, 1.5)),
        )
    else:
        radius, normal = 10 ** rng.uniform(-2, -0.7), np.array([0.0, 0.0, 1.0])
        begin = np.asarray(start.position, float) + rng.choice([0.0, 0.05]) * np.array([1.0, 0.5, 0.0])
        inward = -begin / max(np.linalg.norm(begin[:2]), 1e-9) * np.array([1, 1, 0])
        inward = inward if np.linalg.norm(inward) > 0.5 else np.array([1.0, 0, 0])
        reference = ck.circle(
            begin + radius * inward,
            radius,
            period=jnp.asarray(10 ** rng.uniform(-0.3, 1.5)),
            normal=normal,
            phase=float(np.arctan2(-inward[1], -inward[0])),
            rotation=np.asarray(start.rotation, float),
        )
        reachable = None
    made = {
        "pseudoinverse": ck.pseudoinverse,
        "damped": lambda: ck.damped(jnp.asarray(10 ** rng.uniform(-2.5, -0.3))),
        "transpose": ck.transpose,
    }[of.inverse]()
    limits = {"none": None, "velocity-scaling": ck.velocity_scaling()}
    limits |= {"weighted-least-norm": ck.weighted_least_norm(), "saturation": ck.saturation()}
    law = ck.Law(
        chain,
        task,
        alpha=jnp.asarray(z / Ts),
        inverse=made,
        limits=limits[of.limits],
        feedforward=of.feedforward,
        error_clamp=np.array([0.1, 0.3]) if of.clamp else None,
        null_velocity=ck.posture(np.array(posture(chain, rng)), jnp.asarray(10 ** rng.uniform(-1, 1)))
        if of.null and chain.n > task.m
        else None,
    )
    return Loop(law=law, reference=reference, q0=q0, Ts=np.asarray(Ts), N=N, reachable=reachable)


def draw_pace(of: Family, number: int, seed: int, share: float):
    """The pace of the loop of this number, or None, from a stream of its own: velocities alone, accelerations too, or
    jerks as well; one in five goes on by the path's own clock."""
    rng = np.random.default_rng((seed, of.number, number, 1))
    if rng.random() >= share:
        return None
    velocity, smooth, wait = 10 ** rng.uniform(-0.5, 0.7), rng.integers(3), rng.random() < 0.8
    acceleration = velocity * 10 ** rng.uniform(0, 1.5)
    limits = (velocity, acceleration, acceleration * 10 ** rng.uniform(0.5, 2))[: smooth + 1]
    names = ("velocity", "acceleration", "jerk")
    waits = None if wait or of.path == "hold" else False
    return ck.Pace(wait=waits, **{k: jnp.asarray(v) for k, v in zip(names, limits, strict=False)})


def _length(chain):
    base = np.array([float(v) for v in chain.joints[0].origin.position])
    return arm_length(chain) + np.linalg.norm(base)


def _task(of):
    return task_from(of.task, of.chain)


@functools.partial(jax.jit, static_argnames=("N", "method", "stage", "drive"))
def _solved(law, reference, q0, Ts, pace, *, N, method, stage, drive):
    def one(law, reference, q0, Ts, pace):
        return ck.solve(law, reference, q0, Ts, N, method, stage, drive=drive.value, pace=pace)

    return jax.vmap(one)(law, reference, q0, Ts, pace)


@dataclasses.dataclass(frozen=True)
class _Known:
    """What is compiled in, hashed by what it says."""

    value: object

    def __hash__(self):
        return hash(repr(self.value))

    def __eq__(self, other):
        return repr(self.value) == repr(other.value)


def solved(loops, N, method, stage, drive):
    """The runs of loops of one structure, side by side, as NumPy arrays."""
    stacked = [
        jax.tree.map(lambda *v: jnp.stack([jnp.asarray(x, float) for x in v]), *each)
        for each in zip(*[(one.law, one.reference, one.q0, one.Ts, one.pace) for one in loops], strict=True)
    ]
    found = _solved(*stacked, N=N, method=method, stage=stage, drive=_Known(drive))
    found = jax.tree.map(np.asarray, found)
    return [jax.tree.map(lambda v, i=i: v[i], found) for i in range(len(loops))]


# --- what is true -------------------------------------------------------------------------------------

ARRIVED = 2e-3  # of the first error: what is smaller has arrived
PER_TURN = 16  # times that a path turns joints back and forth as it turns once, at most
VISIBLE = 1e-4  # joint steps, in rad or m, that are smaller are calm


def way(run):
    """Share of the path's own time that a run got along it."""
    return float((run.target_time[-1] - run.target_time[0]) / (run.t[-1] - run.t[0]))


def late(run):
    """Largest error of the last quarter as a verdict has it, of two instants at least; infinite where one is none."""
    return float(settled(run)[0])


def settled(run):
    """(largest, RMS) error of the last quarter; infinite where one is none."""
    N = len(run.e) - 1
    size = np.linalg.norm(run.e, axis=1)[-max(N // 4, min(N, 2), 1) :]
    return np.array([size.max(), rms(size)]) if np.isfinite(size).all() else np.full(2, np.inf)


def grown(run, other, least=1e-300):
    """How many times as large the other run's settled error is, its largest or its RMS value."""
    return times(*(np.minimum(settled(one), 1e300) for one in (run, other)), least).max()


def arrived(run):
    return late(run) <= max(ARRIVED * np.linalg.norm(run.e[0]), 1e-9)


def calm(run):
    """Whether joints hardly move in the last quarter."""
    steps = np.linalg.norm(run.qdot, axis=1)[-max(len(run.qdot) // 4, 1) :] * float(run.t[1] - run.t[0])
    return bool(np.isfinite(steps).all() and steps.max() < VISIBLE)


def rings(loop, run):
    """Whether a coordinate of the error swings to the other side and back and keeps some of itself each time, faster
    than the path turns."""
    large, t = 1e-3 * np.linalg.norm(run.e, axis=1).max(), run.target_time
    turn = abs(float(getattr(loop.reference.curve, "period", np.inf)))
    for e in run.e.T:
        kept = np.flatnonzero(np.abs(e) > large)
        ends = np.flatnonzero(e[kept][1:] * e[kept][:-1] < 0) + 1
        lobes = np.array([np.abs(lobe).max() for lobe in np.split(e[kept], ends) if len(lobe)])
        often = np.diff(t[kept[ends]]).min(initial=np.inf) < turn / 4
        if len(lobes) > 2 and (lobes[1:] / lobes[:-1]).max() > 0.3 and often:
            return True
    return False


def reverses(run):
    """Share of the joint speed that the next step reverses, in the last quarter (RMS)."""
    v = run.qdot[-max(len(run.qdot) // 4, 2) :]
    back = np.where(v[1:] * v[:-1] < 0, np.minimum(np.abs(v[1:]), np.abs(v[:-1])), 0.0)
    return float(np.linalg.norm(back) / max(np.linalg.norm(v), 1e-300))


def restless(loop, run):
    """The same at a pace that lets no joint reverse in a step: what its path does not turn, of a held target all."""
    if loop.pace is None or not loop.pace.smooth:
        return reverses(run)
    half = len(run.qdot) // 2
    v, t = run.qdot[half:], run.target_time[half:]
    period = abs(float(getattr(loop.reference.curve, "period", getattr(loop.reference.curve, "duration", 0.0))))
    turns = (t[-1] - t[0]) / period if period else 0.0
    power = np.abs(np.fft.rfft(v * np.hanning(len(v))[:, None], axis=0)) ** 2
    fast = int(PER_TURN * turns) + 3
    return float(np.sqrt(power[fast:].sum() / max(power.sum(), 1e-300)))


def ends(loop):
    """When the target stops, None for never."""
    curve = loop.reference.curve
    return 0.0 if hasattr(curve, "position") else float(curve.duration) if hasattr(curve, "duration") else None


def moving(loop, t):
    return ends(loop) is None or float(t) < ends(loop)


def reachable(loop, run):
    """Whether some postures, within the limits where the law keeps them, have the tip where it is to be in the last
    quarter of a run.

    SciPy's own search, where it isn't known from how the target was made.
    """
    N, t = len(run.t) - 1, run.target_time
    if not moving(loop, t[-1]):
        return loop.reachable
    return all(_found(loop, t[step]) for step in np.unique(np.linspace(N - N // 4, N, 5).round()).astype(int))


def _target(loop, t):
    """Position and rotation of a loop's target, None where the task has none."""
    task = loop.law.task
    aims = {
        part.turns: np.asarray(a) for part, a in zip(task.parts, sample(loop.reference, task, float(t))[0], strict=True)
    }
    return aims.get(False), aims.get(True)


def _found(loop, t):
    chain, target = loop.law.chain, ck.hold(*_target(loop, t))
    law = ck.replace(loop.law, limits=None, null_velocity=None, inverse=ck.damped(1.0))
    low, high = np.array(chain.lower, float), np.array(chain.upper, float)
    bounds = (low, high) if loop.law.limits is not None else (-np.inf, np.inf)
    rng, found = np.random.default_rng(0), False
    for _ in range(12):
        made = least_squares(lambda q: np.asarray(_error(law, target, q)), posture(chain, rng), bounds=bounds)
        found = found or made.cost < 1e-12
    return found


@jax.jit
def _error(law, target, q):
    return evaluate(modelled(law), target, jnp.zeros(()), q).e


def falsehood(loop, said, run, whole, of):
    """What is wrong with a verdict on the first N steps of a whole run; "" where nothing is."""
    kind, claimed, finally_ = str(said.kind), said.error, late(whole)
    if kind == "beyond the robot's limits":  # of the loop it says what it does apart from them
        kind = re.search(r"The loop is ([a-z ]+):", said.sentence)[1]
    N, t = loop.N, whole.target_time
    path, swings = moving(loop, t[N]), restless(loop, whole)
    floor = max(1e-9, ARRIVED * float(np.linalg.norm(run.e[0])))
    if not np.isfinite(finally_):
        stays = ("settled", "settled with lag", "converging", "held back by a limit", "no progress")
        return "it is lost in the end" if kind in stays else ""
    if kind in ("settled", "settled with lag"):
        if path and ends(loop) is not None:  # while the line lasts
            last = min(int(np.searchsorted(t, ends(loop), side="right")) - 1, len(whole.e) - 1)
            size = np.linalg.norm(whole.e, axis=1)[N : last + 1]
            if len(size) < 2:
                return ""
            finally_ = float(size.max())
        behind = float(np.max(np.linalg.norm(np.diff(whole.x, axis=0), axis=1)[-len(whole.x) // 4 :])) if path else 0.0
        if finally_ > max((5 if path else 2) * claimed, floor) + behind:
            return f"{finally_:.2g} later"
        if kind == "settled with lag" and path and finally_ < 0.2 * claimed:
            return f"the lag is {finally_:.2g} later"
    if kind == "settled" and not path and not calm(whole) and swings > 0.15:
        return "it shakes later"
    if kind == "converging" and finally_ > max((0.9 if "slowly" in said.sentence else 0.5) * claimed, floor):
        return f"{finally_:.2g} later"
    rests = calm(whole) and not path
    if kind == "diverging" and (rests or arrived(whole) or finally_ < 0.3 * claimed) and spectral(loop, whole, of) < 1:
        return f"{finally_:.2g} later"
    if kind == "shaking" and (calm(whole) or swings < 0.02) and spectral(loop, whole, of) < 1:
        return "it is calm later"
    if kind == "ringing" and not rings(loop, run):
        return "the error does not swing"
    stays = 0.7 * claimed <= finally_ <= 2 * claimed + floor
    if kind in ("held back by a limit", "no progress") and not moving(loop, t[round(0.75 * N)]) and not stays:
        return f"{finally_:.2g} later"
    if kind == "out of reach" and ((arrived(whole) and not path) or reachable(loop, run)):
        return f"it is in reach, {finally_:.2g} later"
    return ""


def spectral(loop, run, of):
    """Spectral radius at rest where a run ends."""
    if not (np.isfinite(run.q[-1]).all() and np.abs(run.q[-1]).max() < 1e3):
        return np.inf
    how = of.method_record, of.stage, of.drive
    return float(resting(loop.law, run.q[-1], *how).share_radii([1.0], float(loop.Ts))[0])


# --- whether remedies mend ----------------------------------------------------------------------------


def mended(loop, of, remedy, end):
    """The loop and the family with a remedy's change, taken as data. Args: end: time on the path of its last step."""
    _, turn = _target(loop, end)
    how = dict(N=loop.N, method=of.method, stage=of.stage, drive=of.drive, turn=turn, pace=loop.pace)
    made = changed(Run(law=loop.law, reference=loop.reference, q0=loop.q0, **how), remedy.change)
    loop = dataclasses.replace(loop, law=made.law, reference=made.reference, q0=made.q0, N=made.N, pace=made.pace)
    return loop, dataclasses.replace(of, method=made.method, stage=made.stage, drive=made.drive)


def excess(law, run):
    """Joint velocity over its limit, at most; 0 where no step is told to be too fast."""
    fast = np.any(run.status & int(Status.OVER_VELOCITY) != 0)
    ratio = np.max(np.abs(run.qdot) / np.array(law.chain.velocity_limit, float))
    return fast * float(max(ratio, 1.0))  # through a drive they may not have moved yet


def outside(law, run):
    """By how much a joint is beyond its limits, at most."""
    return float(np.maximum(run.q - np.array(law.chain.upper), np.array(law.chain.lower) - run.q).max(initial=0.0))


def chatter(loop, run):
    """Largest joint speed that the next step reverses, in the second half; at a pace what is restless."""
    if loop.pace is not None and loop.pace.smooth:
        return restless(loop, run) * float(np.linalg.norm(run.qdot[len(run.qdot) // 2 :], axis=1).max())
    v = run.qdot[len(run.qdot) // 2 - 1 :]
    return float(np.max(np.where(v[1:] * v[:-1] < 0, np.minimum(np.abs(v[1:]), np.abs(v[:-1])), 0.0), initial=0.0))


def duration(loop):
    """Time that a loop's path takes, 0 of a held target."""
    curve = loop.reference.curve
    return float(getattr(curve, "period", getattr(curve, "duration", 0.0)))


def farther(loop, run, whole, after, whole_after):
    """Whether the error is larger in the end, or, along a path, in the run's own last quarter: of several times."""
    floor = max(ARRIVED * float(np.linalg.norm(whole.e, axis=1).max()), 1e-9)
    path = moving(loop, run.target_time[round(0.75 * loop.N)])
    floor += float(np.linalg.norm(np.diff(whole.x, axis=0), axis=1).max()) if path else 0.0  # a step behind
    pairs = [(whole, whole_after), (run, after)][: 1 + path]
    return any(late(other) > 2.5 * max(late(one), floor) for one, other in pairs)


def strains(law, run, after):
    """Whether joints go farther beyond their limits than they did."""
    faster = excess(law, after) > 1.2 * max(excess(law, run), 1.0)
    return faster or outside(law, after) > 1.2 * outside(law, run) + 1e-6


def improves(remedy, loop, run, whole, other, after, whole_after, of):
    """Whether what a remedy is to mend is better in the run that it makes."""
    if remedy.mends == "verdict":
        return str(said_of(other, after, of).kind) != "too short to tell"
    if not (np.isfinite(after.e).all() and np.isfinite(after.q).all()):
        return False
    if not np.isfinite(run.e).all():
        return True
    if remedy.mends in ("velocity", "limits"):
        slower = excess(loop.law, after) < 0.8 * excess(loop.law, run)
        kept = outside(loop.law, after) < 1e-6 < 1e3 * outside(loop.law, run)
        return (slower if remedy.mends == "velocity" else kept) and not farther(loop, run, whole, after, whole_after)
    if not only_longer(remedy.change, duration(loop)) and strains(loop.law, run, after):
        return False
    waits, arrives = loop.pace is not None and run.path_time is not None, ARRIVED * np.linalg.norm(run.e[0])
    behind = max(float(np.linalg.norm(np.diff(run.x + run.e, axis=0), axis=1).max()), arrives)
    if waits and grown(run, after, behind) <= 2 and way(after) > 1.1 * way(run):  # what crawls has a small error
        return True
    if remedy.mends == "motion":  # calmer, and not worse
        spans = (5 * loop.N, len(whole.e))  # in the end the target may be out of reach
        least = [grown(truncate(whole, N), truncate(whole_after, N)) for N in spans]
        shakes = times(chatter(loop, run), chatter(loop, after), 1e-3 * VISIBLE / float(loop.Ts))
        better = min(shakes, *least) < 0.5
        calmer = better or (calm(whole_after) > calm(whole)) or (arrived(whole_after) > arrived(whole))
        path = moving(loop, run.target_time[round(0.75 * loop.N)])
        as_near = not path or grown(run, after, behind) <= 1.2
        return calmer and as_near and grown(whole, whole_after, max(2 * arrives, 1e-9)) <= 1.2
    if grown(whole, whole_after) < 0.95 and not set(remedy.change) & {"N", "shift"}:  # in the end
        return True
    longer = only_longer(remedy.change, duration(loop))
    return grown(run, after) < (0.3 if longer else 0.95) or arrived(after)


def said_of(loop, run, of):
    how = dict(Ts=float(loop.Ts), method=of.method, stage=of.stage, drive=of.drive, pace=loop.pace)
    return ck.verdict(loop.law, loop.reference, run, **how)


def cut(loop, of, run):
    """The loop's first N steps; of a line at a pace, which knows its end only as far as it runs, those of its own."""
    if loop.pace is None or not hasattr(loop.reference.curve, "duration"):
        return truncate(run, loop.N)
    how = loop.law, loop.reference, loop.q0, float(loop.Ts), loop.N, of.method, of.stage
    return jax.tree.map(np.asarray, ck.solve(*how, drive=of.drive, pace=loop.pace))


def grouped(pairs):
    """Lists of (loop, family, more) that share a program."""
    groups = {}
    for loop, of, *more in pairs:
        N = SHORT * LONG if loop.N <= SHORT * LONG else MOST
        key = jax.tree.structure((loop.law, loop.reference, loop.pace)), of.method, str(of.stage), repr(of.drive)
        groups.setdefault((key, N), []).append((loop, of, *more))
    for (_, N), group in groups.items():
        of = group[0][1]
        runs = solved([one[0] for one in group], N, of.method, of.stage, of.drive)
        for one, run in zip(group, runs, strict=True):
            yield *one, run


@mock.patch.object(trial, "SHORTEST", trial.MOST_TRIED)  # no loop here was run by a program of its own
def judge(of: Family, numbers, seed: int = 0, remedies: bool = True, paced: float = 0.0):
    """Of these loops of a family a dict each: what it is, its verdict, what is false, what each remedy made of it."""
    found, others = [], []
    drawn = [dataclasses.replace(draw(of, i, seed), pace=draw_pace(of, i, seed, paced)) for i in numbers]
    for loop, _, number, whole in grouped([(one, of, i) for one, i in zip(drawn, numbers, strict=True)]):
        run = cut(loop, of, whole)
        said = said_of(loop, run, of)
        size = np.linalg.norm(whole.e, axis=1)
        about = f"z={float(loop.law.alpha * loop.Ts):.3g} N={loop.N} {size[0]:.2g} {size[loop.N]:.2g} {late(whole):.2g}"
        about += "" if loop.pace is None else f" {loop.pace}"
        found.append(
            dict(
                family=of.number,
                number=number,
                about=about,
                kind=str(said.kind),
                said=str(said),
                false=falsehood(loop, said, run, whole, of),
                remedies=[],
            )
        )
        for one in said.remedies if remedies else ():
            other, under = mended(loop, of, one, run.target_time[-1])
            if other.N <= MOST:
                others.append((other, under, one, loop, run, whole, found[-1]))
    for other, under, one, loop, run, was, record, whole in grouped(others):
        after = cut(other, under, whole)
        good = improves(one, loop, run, was, other, after, whole, under)
        told = dict(change=str(one.change), mends=one.mends, good=good, after=late(after))
        record["remedies"].append(told)
    return found


def main():
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--loops", type=int, default=2000)
    asked.add_argument("--each", type=int, default=50, help="loops of a family")
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--only", type=int, nargs="*", help="these families alone")
    asked.add_argument("--paced", type=float, default=0.0, help="share of the loops that go at a pace")
    asked.add_argument("--remedies", action=argparse.BooleanOptionalAction, default=True)
    args = asked.parse_args()
    jax.config.update("jax_enable_x64", True)
    kinds, wrong, tried, vain = Counter(), Counter(), Counter(), Counter()
    for number in range(-(-args.loops // args.each)) if args.only is None else args.only:
        of = family(number, args.seed)
        print(
            f"# {number} {of.robot} {of.task} {of.inverse} {of.limits} {of.method} {of.stage} {of.path} "
            f"ff{of.feedforward:g} d{of.drive.delay:g} {of.drive.order} {'clamp' * of.clamp} {of.null}",
            flush=True,
        )
        for one in judge(of, range(args.each), args.seed, args.remedies, args.paced):
            kinds[one["kind"]] += 1
            wrong[one["kind"]] += bool(one["false"])
            for told in one["remedies"]:
                key = one["kind"] + ": " + told["mends"] + " " + "+".join(eval(told["change"]))
                tried[key] += 1
                vain[key] += not told["good"]
            bad = [told for told in one["remedies"] if not told["good"]]
            if one["false"] or bad:
                print(
                    f"{number}.{one['number']} {one['about']}: {one['false'] and 'FALSE ' + one['false']}\n   ",
                    one["said"],
                    *(f"\n    VAIN {told}" for told in bad),
                    flush=True,
                )
        jax.clear_caches()
    print({k: f"{wrong[k]} of {v}" for k, v in kinds.most_common()}, sum(wrong.values()))
    for key, count in sorted(tried.items()):
        print(f"{vain[key]} of {count}  {key}")


if __name__ == "__main__":
    main()
