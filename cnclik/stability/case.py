"""Case: the evidence for a verdict: a run, its loop, and the linear loop at rest at the end of the run."""

import dataclasses
import functools

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.status import Status, rounding_of
from cnclik.law import reference as ref
from cnclik.law.law import Law
from cnclik.law.walls import names_of
from cnclik.record import replace
from cnclik.robot.model import one_off
from cnclik.robot.posture import beyond_arm
from cnclik.stability.driven import overshoot
from cnclik.stability.drives import side_by_side
from cnclik.stability.loop import UNSTABLE, LoopAtRest, resting
from cnclik.stability.observed import OFTEN, Observed, observe, rms
from cnclik.stability.reasons import SLOWEST
from cnclik.stability.spectrum import leaky, of_error, spectrum_of
from cnclik.stability.stacked import largest_in_words, together

WILD = 1e3  # [rad, m] a run with larger joint values is judged at its start
LOOKED_AT = 9  # number of instants of the last quarter whose targets are examined
PLENTY = 5.0  # after so many time constants an error that has not decreased is taken as permanent
LEAST = 50  # and steps
NEARLY = 0.95  # share of a path that counts as all of it; at a pace the last part may take very long
COUNTS = 0.05  # a smaller share of the last error does not count
YIELDS = 0.3  # nor of what walls miss: in float32 one of level 1 misses a tenth, or a fifth, of those of level 2
BRIEF = 16  # part of a path, or of half a run to a held target, over which velocities at a pace are averaged
UNMOVED = 1e-9  # a factor within this of 1 belongs to a direction that no joint moves


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    law: Law
    reference: ref.Reference
    loop: tuple  # Ts, method, stage, drive
    seen: Observed
    t: np.ndarray
    end: LoopAtRest  # where the run is judged: at its last instant, or at its first
    q0: np.ndarray  # (n,)
    wanted: np.ndarray | None  # (k, p) positions wanted over the last quarter
    wanted_velocity: np.ndarray  # (k, m) task velocities
    target: np.ndarray | None  # the one of these positions that is farthest beyond the stretched arm, else the last,
    turn: np.ndarray | None  # and the rotation wanted there
    behind: float  # how far the target moves in a step (RMS, last quarter)
    path: float  # time that the whole path takes [s], 0 where it is held or nobody knows
    period: float  # the same as an option, negative where a circle is followed in the other sense, 0 where it is none
    rows: np.ndarray  # J (m, n) at rest at the end
    radius: float  # spectral radii there, over the task and its null space
    null_radius: float
    overshoot: float  # how far beyond the target an error lands there, as a share of itself
    advance: float  # how far the path's time got in the last quarter's steps, of theirs: at a pace it waits
    fold: float  # steps in which the slowest part of what is left of the error falls, or grows, e-fold, at that pace
    e: np.ndarray  # weighted error at the end
    errors: np.ndarray  # (N + 1, m), up to the first that is not finite
    size: str  # of the last quarter's error, in words
    walls: list  # what walls do in most of its steps
    more: dict  # pace and noise of the run

    @property
    def steps(self):
        return len(self.t) - 1

    @property
    def dead(self):
        """Steps between a command and its first measured effect."""
        drive = self.loop[-1]
        return 0 if drive.prompt else int(np.ceil(drive.delay + drive.measurement_delay))

    @property
    def spans(self):
        """Length of the run in time constants of the loop."""
        return max(self.steps - self.dead, 0) / self.fold

    @property
    def stays(self):
        """Whether the run is long enough for an error that does not shrink to be one that stays: also for joints at
        their velocity limits, which take their time to turn half around."""
        settled = not self.stirred and not self.crawls
        slowest = self.loop[0] * float(np.min(np.array(self.law.chain.velocity_limit, float)))
        half_turn = np.pi / slowest if self.held_back else 0.0  # steps
        return self.spans >= PLENTY and self.steps >= max(LEAST, half_turn) and settled

    @property
    def stirred(self):
        """Whether a null-space velocity still moves the arm by more than the remaining error."""
        moved = np.linalg.norm(self.rows, 2) * self.seen.drift
        return self.law.null_velocity is not None and bool(moved > self.seen.largest)

    @property
    def held_back(self):
        """Whether the law's limits slow the joints down."""
        return self.law.limits is not None and self.seen.often(Status.AT_LIMIT)

    @property
    def crawls(self):
        """Whether they do so next to a singularity, where the loop at rest predicts nothing."""
        return self.held_back and self.seen.often(Status.NEAR_SINGULAR)

    @property
    def rounding(self):
        """Error at which a step is lost in the rounding of q, ulp(q)/2/(alpha·Ts), for the loop's own alpha·Ts."""
        q = self.end.q
        ulp = float(np.spacing(np.abs(q).max().astype(self.seen.dtype)))
        return np.linalg.norm(self.rows, 2) * np.sqrt(len(q)) * ulp / 2 * self.fold

    @property
    def null_fold(self):
        """Steps in which a null space that pulls at the task, or stirs it up, settles e-fold; 0 of another."""
        acts = leaky(self.law) or self.stirred
        return 1 / max(-np.log(self.null_radius), 1 / SLOWEST) if acts and 0 < self.null_radius < 1 else 0.0

    @property
    def null_unstable(self):
        return callable(self.law.null_velocity) and self.null_radius > UNSTABLE

    @property
    def moving(self):
        return self.behind > self.seen.floor

    @property
    def pace(self):
        return None

    @property
    def noise(self):
        """Root mean square of the noise of its measured error; 0 where there is none."""
        sigma = self.more["noise"]
        return 0.0 if sigma is None else float(np.linalg.norm(np.broadcast_to(sigma, len(self.e))))

    @property
    def follows(self):
        """Whether it is less than a sample behind its target, or than noise moves that, in the last quarter."""
        return rms(self.seen.late) <= max(self.behind, self.seen.floor, self.noise)

    @property
    def around(self):
        """Whether its path is closed."""
        return self.moving and _around(self.reference)

    @property
    def waits(self):
        return False

    @property
    def covered(self):
        """The part of the path that the run covers, in whole paths; 1 without a path, or for nearly all of it."""
        held = float(self.t[-1] - self.t[0]) / self.path if self.path else 1.0
        return 1.0 if NEARLY <= held < 1 else held

    @functools.cached_property
    def reached(self):
        """The result of `reach` for the last target, or targets of several tips; None where `reach` does not apply."""
        if self.law.task.of_one_tip:
            return self.reach_to(self.target)
        return None if self.together is None else self.together.made

    @functools.cached_property
    def together(self):
        """Of a stack what `reach` finds for the targets of all its tips over the last quarter, see `stacked`."""
        still = getattr(self.reference, "still", False)
        steps = len(self.t) - 1 if self.seen.bad is None else 0
        some = np.linspace(max(steps - len(self.seen.late) + 1, 0), steps, 1 if still else LOOKED_AT)
        return together(self, self.t[some.round().astype(int)])

    def reach_to(self, target):
        """The same for another position, turned alike."""
        from cnclik.reaching.public import reach  # imported here, because most runs do not need it

        chain, task = self.law.chain, replace(self.law.task, weights=None)
        able = task.of_one_tip and task.m <= chain.n and not chain.balls
        if not able or not all(map(errors.concrete, jax.tree.leaves(chain))):
            return None
        position, rotation = np.zeros(3), np.eye(3) if self.turn is None else self.turn
        if target is not None:
            position[list(task.linear) if len(target) < 3 else slice(None)] = target
        kept = self.law.limits is not None
        return reach(chain, (position, rotation), task=task, tolerance=(1e-4, 1e-4), limits=kept)

    @functools.cached_property
    def start(self) -> LoopAtRest:
        """The loop at rest where the run began."""
        return resting(self.law, self.q0, *self.loop[1:])

    def radius_at(self, at: LoopAtRest, share=1.0) -> float:
        """Spectral radius at rest there, of steps of which a pace leaves a share."""
        return float(at.share_radii([share], self.loop[0])[0])


def case_of(law, reference, run, dtype, Ts, method, stage, drive, **more) -> Case:
    """The evidence of one lane's run that was computed in a dtype."""
    seen = observe(law, run, Ts, dtype, 0)
    t, q, e = (np.asarray(v, float) for v in (run.t, run.q, run.e))
    wild = seen.bad is not None or np.abs(q[-1]).max() > WILD
    last = 0 if wild else len(run.residual)
    until = 0 if seen.bad is not None else len(run.residual)
    some = np.linspace(max(until - len(seen.late) + 1, 0), until, LOOKED_AT).round().astype(int)
    *wanted, speeds = (v if v is None else np.asarray(v) for v in targets(reference, law.task, t[some]))
    velocity = np.zeros((len(some), law.task.m)) if speeds is None else speeds
    at = farthest(law, wanted[0])
    weighted = e[last] * np.asarray(law.task.weight_of_each, float)
    end = resting(law, q[last], method, stage, drive)
    rest = _at_rest(end, weighted, Ts)
    advance = 1.0
    return Case(
        law=law,
        reference=reference,
        loop=(Ts, method, stage, drive),
        seen=seen,
        t=t,
        end=end,
        q0=q[0],
        wanted=wanted[0],
        wanted_velocity=velocity,
        target=None if wanted[0] is None else wanted[0][at],
        turn=None if wanted[1] is None else wanted[1][at],
        behind=rms(np.linalg.norm(velocity, axis=1)) * Ts,
        path=reference.duration,
        period=_period(reference),
        e=weighted,
        errors=e[: seen.bad],
        size=largest_in_words(law.task.units, e[: seen.bad][-len(seen.late) :]),
        walls=held_by(law, run, len(seen.late)),
        more=more,
        advance=advance,
        **rest | {"fold": rest["fold"] / advance},
    )


def held_by(law, run, late) -> list:
    """What walls do in most of the last steps: hold, or give way to others."""
    if run.walls is None:
        return []
    room, most = np.asarray(run.walls)[-late:], rounding_of(np.asarray(run.qdot)[-late:])
    least = np.minimum(-most, YIELDS * room.min(axis=1, keepdims=True))
    active, missed = ((room <= bound).mean(0) > OFTEN for bound in (most, least))
    each = zip(names_of(law.limits.walls), active, missed, strict=True)
    return [f"wall {name} {'gives way' if lost else 'holds'}" for name, there, lost in each if there]


def brief(reference, run, Ts, pace) -> int:
    return 0


def farthest(law, places) -> int:
    """The position, of (k, p), that is farthest beyond the stretched arm; the last one where none is."""
    if places is None:
        return -1
    away = np.asarray(beyond_arm(law.chain, places, (0, 1, 2) if places.shape[1] == 3 else law.task.linear), float)
    return int(np.argmax(away)) if away.max() > 0 else -1


def _around(reference) -> bool:
    several = isinstance(reference, ref.References)
    return any(map(_around, reference.each)) if several else hasattr(reference.curve, "period")


def _period(reference) -> float:
    """The time of a path as an option, 0.0 where it is none, or of each of several paths."""
    curve = getattr(reference, "curve", None)
    return float(getattr(curve, "period", getattr(curve, "duration", 0.0)))


@one_off
def targets(reference, task, t):
    """Position, rotation and task velocity of a reference at times t (k,), each None or an array (k, ...); the first
    two are known of a task of one tip's pose.
    """

    def one(t):
        aims, velocity = ref.sample(reference, task, t)
        found = {part.turns: aim for part, aim in zip(task.parts, aims, strict=True)} if task.of_one_tip else {}
        return found.get(False), found.get(True), velocity

    return jax.vmap(one)(t)


def _at_rest(end, e, Ts) -> dict:
    """The linear loop at rest at the end of the run: rows, radii, overshoot, time constant."""
    moved, rows = end.maps(np.ones(1), np.full(1, Ts))
    if not np.isfinite(moved[0]).all():
        return dict(rows=rows, radius=np.inf, null_radius=np.inf, overshoot=0.0, fold=1.0)
    found = spectrum_of(moved[0], rows)
    if end.drive.prompt:
        # |λ| to the power of the steps that half a turn takes.
        radius, sizes, angle = found.radius, np.minimum(np.abs(found.task), 1.0), np.abs(np.angle(found.task))
        beyond = np.max(np.where(angle > 0, sizes ** (np.pi / np.maximum(angle, 1e-9)), 0.0), initial=0.0)
    else:
        radius = float(end.share_radii([1.0], Ts)[0])
        steps = end.prompt.modes([end.rate * Ts], Ts)[0][0]
        beyond = overshoot(steps, side_by_side(end.drive), Ts) if radius < 1 else 1.0
    slowest = _slowest(moved[0], rows, e) if end.drive.prompt else radius
    fold = 1 / max(abs(np.log(max(radius if radius > 1 else slowest, 1e-3))), 1 / SLOWEST)
    return dict(rows=rows, radius=radius, null_radius=found.null_radius, overshoot=float(beyond), fold=float(fold))


def _slowest(moved, rows, e) -> float:
    """Largest |λ| of the error's own map among the directions that are left in the error, of those that move."""
    values, vectors = np.linalg.eig(of_error(moved, rows, np))
    size, moves = np.abs(values), np.abs(values - 1) > UNMOVED
    try:
        parts = np.abs(np.linalg.solve(vectors, e.astype(complex))) * np.linalg.norm(vectors, axis=0)
    except np.linalg.LinAlgError:
        parts = np.ones(len(size))
    counts = moves & (parts >= COUNTS * np.linalg.norm(e))
    return float(size[counts if counts.any() else moves].max(initial=0.0))
