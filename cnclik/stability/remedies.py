"""Remedies: what would have made a run better, as numbers under the names of a problem's options, and in words."""

import math

import numpy as np

from cnclik.integrate.stage import Picard
from cnclik.law.bounded import Bounded
from cnclik.law.inverse import Damped, Levels, Pseudoinverse
from cnclik.record import record, replace
from cnclik.robot.model import forward
from cnclik.robot.posture import arm_length, beyond_arm
from cnclik.stability import reasons
from cnclik.stability.case import LEAST, PLENTY, WILD
from cnclik.stability.loop import resting
from cnclik.stability.reasons import REVERSING
from cnclik.stability.spectrum import leaky
from cnclik.stability.tasks import bounded_rates, half_shares, stable_shares

MARGIN = 2.0  # of the time that a longer run is given: a loop may be slower where that ends
ENOUGH = 2.0  # of the loop's own time constants, from which on a shrinking error is believed to shrink on
INSIDE = 0.97  # of the way to the edge of what can be reached, where a target is brought to
SMALL = 0.05  # joint step that is gentle [rad, m]
ARRIVES = math.log(1e3)  # time constants in which an error is gone
HARDLY = 1e-3  # share of a gain that is none
GENTLE = 0.2  # of an error that a step takes, at a gain that hardly any loop is too late for


@record
class Remedy:
    """One change that makes a run better; a verdict's remedies are alternatives.

    Attributes:
      change: {option: value}, by the names and in the units of `cnclik.problem.OPTIONS`, as plain data; also "speed",
        the share of the path's speed, "null_gain", that of the null-space velocity, and "shift", by which the whole
        path moves [m], and "damping_share", that of the damping of each level.
      words: the same as a sentence's part; options are written as Python takes them, `N=400`, `limits=bounded()`.
      mends: what gets better: "error", "motion" (shaking, swinging), "velocity" of joints, or "verdict", which a
        longer run decides, or "limits", which joints leave.
    """

    change: dict
    words: str
    mends: str = "error"


# --- a longer run -------------------------------------------------------------------------------------


def longer(case, times=1) -> tuple:
    """The run that decides: enough of the loop's time constants, and all of the path; none where nobody knows it."""
    if reasons.open_ended(case):
        return ()
    spans = ENOUGH if case.moving else PLENTY
    more = ", or more where limits hold the joints back," if case.law.limits is not None else ""
    return (_steps(case, spans, "verdict", f"run for N={{}} steps{more} to decide", times),)


def to_the_end(case, times=1) -> tuple:
    """The run in which a shrinking error is gone."""
    return (_steps(case, ARRIVES, "error", "run for N={} steps", times),)


def _steps(case, spans, mends, words, times):
    seen, Ts = case.seen, case.loop[0]
    size = max(float(np.median(seen.late)), 1e-300)
    fall = math.log(max(float(np.median(seen.before)) / size, 1.0)) / max(len(seen.late), 1)
    # The run's own, where limits or a clamp make it slower than its step is at rest.
    slower = 1 / fall if seen.shrinks and seen.largest > 0.1 * seen.size[0] and fall > 0 else 0.0
    steps = (
        max(MARGIN * spans * max(case.fold, case.null_fold, slower), LEAST)
        + max(case.steps, math.ceil(case.path / Ts))
        + case.dead
    )
    steps = times * max(steps, 2 * case.steps)
    digit = 10 ** max(math.floor(math.log10(steps)) - 1, 0)
    N = digit * math.ceil(steps / digit)  # to two digits, from above
    if not case.period:
        return Remedy(change={"N": N}, words=words.format(N), mends=mends)
    words = f"{words.format(N)}, with period={case.period:.6g} s (left out, it grows with N)"
    return Remedy(change={"N": N, "period": case.period}, words=words, mends=mends)


# --- gain ---------------------------------------------------------------------------------------------


def lower(case) -> tuple:
    """What stops a loop that shakes or diverges: less gain, by what is stable at rest at both ends of the run, of which
    the last may be where it has gone astray."""
    law, (Ts, method, stage, drive) = case.law, case.loop
    ends = [at for at in (case.end, case.start) if np.abs(at.q).max() <= WILD]
    within = less_null(case.null_radius) if case.null_unstable else ()
    shares = [at.stable_share(Ts) for at in ends]
    share = min(shares, default=1.0)
    if share == 0 and drive.feedback == "rebased":
        words = 'begin each position command at the last one (feedback="commanded"): no smaller gain is stable'
        return (Remedy(change={"feedback": "commanded"}, words=words, mends="motion"),)
    if 0 < share < 1:
        best, why = ends[int(np.argmin(shares))].fastest_share(Ts, share), "settles soonest"
        if law.task.tasks:  # what settles soonest is what the slowest of its tasks asks for
            share = _share_by_task(case, ends, share)
            best, why = np.where(share < 1, 0.5 * share, 1.0), "is half of that"
        change = {"alpha": _gain(law, best)} | (within[0].change if within else {})
        words = f"reduce {_words(law, share, 'below')} ({_amount(law, best)} {why})"
        words += f" and {within[0].words}" if within else ""
        made = (Remedy(change=change, words=words, mends="motion"),)
        if within or not drive.prompt:
            return made
        if method.implicit and isinstance(stage, Picard):
            words = "use stage=chord(2)"
            return *made, Remedy(change={"stage": "chord", "M": 2}, words=words, mends="motion")
        words = 'use method="EXP-MIDPOINT", which has no such limit'
        other = Remedy(change={"method": "EXP-MIDPOINT"}, words=words, mends="motion")
        return made if method.exponential else (*made, other)
    if leaky(law) and case.radius <= 1:  # more damping lets it pull more
        return less_null()
    return within or (() if case.moving else gentle(case, "motion"))  # what it clamps may not keep up with a path


def _share_by_task(case, ends, share):
    """`share` of one gain for all; where tasks have gains, shares (m,) of those alone that make the loop unstable."""
    if np.ndim(case.law.alpha) == 0:
        return share
    loops = _of_tasks(case, ends)
    shares = stable_shares(loops, case.loop[0]) if loops else 1.0
    return shares if np.any(shares < 1) else share


def _of_tasks(case, ends) -> list:
    """The loops at rest there of a stack of `bounded_rates`, without a null-space velocity; [] of another."""
    law = replace(case.law, null_velocity=None)  # whose part in it `less_null` is about
    loops = [resting(law, at.q, *case.loop[1:]) for at in ends] if bounded_rates(law) else []
    return loops if all(at.rates is not None for at in loops) else []


def faster(case) -> tuple:
    """The gain, at most the present one, with which the loop settles soonest; of a stack half of what is stable.

    What settles soonest is there what the slowest of its tasks asks for.
    """
    ends, Ts = (case.end, case.start), case.loop[0]
    share, why = min(at.fastest_share(Ts) for at in ends), "settles soonest"
    loops = _of_tasks(case, ends[:1])
    if loops and np.any((shares := half_shares(loops[0], Ts)) < 1):
        share, why = shares if np.ndim(case.law.alpha) else shares[0], "is half of what is stable at any posture"
    elif case.law.task.tasks and share > 0.9:
        share, why = 0.5 * min(at.stable_share(Ts) for at in ends), "is half of what is stable"
    words = f"reduce {_words(case.law, share, 'to about')}, which {why}"
    helps = HARDLY < np.min(share) < 1  # below, no gain settles
    return (Remedy(change={"alpha": _gain(case.law, share)}, words=words, mends="motion"),) if helps else ()


def raised(case) -> tuple:
    """More gain, where that makes the loop at rest faster: as much as does, up to four times."""
    share = case.end.fastest_share(case.loop[0], 4.0)
    if not case.loop[-1].prompt:
        share /= 2  # what settles soonest through a drive overshoots
    if share <= 1.2:
        return ()
    return (Remedy(change={"alpha": _gain(case.law, share)}, words=f"raise {_words(case.law, share, 'to')}"),)


def quicker(case) -> tuple:
    """What gets an error there that takes too long at rest, and a run in which it is gone: an inverse that moves the
    slowest direction of the task, or more gain."""
    law, (Ts, _, _, drive) = case.law, case.loop
    if not (reasons.slow(case) and law.task.of_one_tip) or isinstance(law.inverse, Levels):
        return ()
    weak = float(f"{np.linalg.svd(case.rows, compute_uv=False)[-1]:.2g}")
    rate = float(np.max(np.abs(np.asarray(law.alpha, float))))
    share = GENTLE / ((Ts + float(np.max(drive.late_by(Ts)))) * rate)
    other = weak < float(np.max(getattr(law.inverse, "damping", 0.0)))
    if other and weak < float(law.near_singular):
        return ()
    share = min(share, max(share / 100, 1.0)) if other else share  # as it is, where that is neither much nor nothing
    taken = share * rate * Ts * (0.5 if other else 1.0)  # of the slowest direction by a step
    N = math.ceil(float(f"{case.steps + case.dead + MARGIN * ARRIVES / taken:.2g}"))
    change = {"damping": weak} if other else {}
    words = [f"use inverse=damped({weak:.2g})"] * other
    if share != 1:
        change |= {"alpha": _gain(law, share)}
        words.append(f"{'raise' if share > 1 else 'reduce'} {_words(law, share, 'to')}")
    return (Remedy(change=change | {"N": N}, words=f"{' and '.join(words)}, and run for N={N} steps"),)


def _gain(law, share):
    """The law's gains times a share, or shares (m,) that are the same within each task."""
    alpha = np.asarray(law.alpha, float)
    return (alpha * (np.asarray(share)[..., None] if alpha.ndim == 2 else share)).tolist()


def _amount(law, share):
    """Gains as a share of the law's: in 1/s for each task that has one, as a share where they are a matrix."""
    if np.ndim(law.alpha) == 2:
        each = {name: float(share[at][0]) for name, at in law.task.each} if np.ndim(share) else {"": float(share)}
        lower = {f" for {name}" if name else "": one for name, one in each.items() if one < 1 or not name}
        return " and ".join(f"{one:.2g} of what it is{whose}" for whose, one in lower.items())
    alpha = share * np.asarray(law.alpha, float)
    less = np.broadcast_to(share, alpha.shape) < 1
    each = [(name, at) for name, at in law.task.each if alpha.ndim and less[at].any()]
    every = [(f" for {name}", alpha[at]) for name, at in each] or [("", np.atleast_1d(alpha))]
    each = [(whose, [f"{v:.3g}" for v in own]) for whose, own in every if own.any()]
    return " and ".join(f"{', '.join(v[:1] if len(set(v)) == 1 else v)} 1/s{whose}" for whose, v in each)


def _words(law, share, word):
    return f"alpha {word} {_amount(law, share)} at this Ts"


def less_null(radius=None, share=0.3) -> tuple:
    """A slower null-space velocity; where its spectral radius is known, so slow that a step leaves half of it."""
    share = float(share if radius is None else min(0.5 / (1 + radius), 0.5))
    words = f"reduce the gain of the null-space velocity to {share:.2g} of what it is"
    return (Remedy(change={"null_gain": share}, words=words, mends="motion"),)


# --- far targets, singularities, limits ---------------------------------------------------------------


def gentle(case, mends="error") -> tuple:
    """Damping and a clamp with which a step from anywhere is small and within the velocity limits: ‖q̇‖ ≤ alpha ‖e‖/(2λ)
    of what the clamp leaves of e."""
    law, Ts, size = case.law, case.loop[0], min(1.0, arm_length(case.law.chain))
    if isinstance(law.inverse, Levels):  # one damping for all would take their priority
        return ()
    rate = float(np.max(np.abs(np.asarray(law.alpha, float))))
    damping = max(0.1 * size, 3 * float(np.max(np.asarray(getattr(law.inverse, "damping", 0.0)))))
    most = min(float(np.min(np.array(law.chain.velocity_limit, float))), SMALL / Ts)
    clamp = float(f"{min(0.1 * size, 1.4 * damping * most / rate if rate else np.inf):.2g}")
    words = f"use inverse=damped({damping:.2g}) with error_clamp=({clamp:.2g}, {clamp:.2g})"
    change = {"damping": float(f"{damping:.2g}"), "error_clamp": [clamp, clamp]}
    return (Remedy(change=change, words=words, mends=mends),)


def nearer(case) -> tuple:
    """The nearest target in reach, or a loop that stops quietly before this one."""
    made, (m, n) = case.reached, case.rows.shape
    if m > n:
        fewer = "".join(case.law.task.names[:n])
        return (Remedy(change={"task": fewer}, words=f"ask for fewer coordinates, such as {fewer}"),)
    found = []
    turns = case.law.task.orientation
    if made is not None and np.isfinite(made.q).all() and not (turns and case.moving):
        tip = np.asarray(forward(case.law.chain, made.q).position, float)
        if reasons.beyond(case) > 0 and not turns:  # a little inside: the edge itself is singular
            base = np.array([float(v) for v in case.law.chain.joints[0].origin.position])
            tip = base + INSIDE * (tip - base)
        if case.moving:
            found += _shifted(case, tip)
        elif not turns or case.reach_to(tip).solved:  # turned as it is wanted, which the nearest posture is not
            found.append(Remedy(change={"target": tip.tolist()}, words=f"bring the target to {_point(tip)} m"))
    if case.seen.visible and case.seen.reversing > REVERSING and not case.seen.shrinks:
        found += gentle(case, "motion")
    return tuple(found)


def _shifted(case, tip) -> tuple:
    """The path moved as far as it is out of reach, where that brings all of it nearer than the stretched arm."""
    axes = list(case.law.task.linear) if len(case.target) < 3 else [0, 1, 2]
    shift = np.zeros(3)
    shift[axes] = tip[axes] - case.target
    if np.max(beyond_arm(case.law.chain, case.wanted + shift[axes], tuple(axes))) > case.seen.floor:
        return ()
    return (Remedy(change={"shift": shift.tolist()}, words=f"move the path by at least {_point(shift)} m"),)


def _point(values):
    least = 1e-4 * np.max(np.abs(values))
    return "(" + ", ".join(f"{v if abs(v) > least else 0:.4g}" for v in values) + ")"


def elsewhere(case) -> tuple:
    """A start from which the loop gets there: beside a posture that has the target."""
    made = case.reached
    if made is None or not made.solved:
        return ()
    q = np.round(np.asarray(made.q, float), 4)
    words = f"start elsewhere, such as near the posture ({', '.join(f'{v:.4g}' for v in q)}), which reaches the target"
    return (Remedy(change={"q0": q.tolist()}, words=words),)


def slower_path(case, share, mends="error") -> tuple:
    if case.period:
        period = float(f"{case.period / share:.2g}")
        N = math.ceil(case.steps * abs(period) / case.path)  # the same part of it
        words = f"follow a slower path: one that takes {abs(period):g} s, not {case.path:.3g} s, with N={N} steps"
        return (Remedy(change={"period": period, "N": N}, words=words, mends=mends),)
    N = math.ceil(case.steps / share)
    words = f"follow the path at {share:.2g} of its speed, with N={N} steps"
    return (Remedy(change={"speed": share, "N": N}, words=words, mends=mends),)


def slower_joints(case) -> tuple:
    """What to do about a loop that asks for more than its joints can."""
    law, excess = case.law, case.seen.excess
    names = (
        ()
        if law.limits is not None
        else ("velocity-scaling",) * (not reasons.outside(case)) + ("bounded",) * _damped(law)
    )
    found = [
        Remedy(change={"limits": name}, words=f"use limits={name.replace('-', '_')}()", mends="velocity")
        for name in names
    ]
    within = reasons.null_excess(case)
    if case.seen.fast_singular:
        return *gentle(case, "velocity"), *found
    if within > 0.7 * excess:
        return *found, *(replace(one, mends="velocity") for one in less_null(share=0.5 / within))
    if excess <= 1 or law.null_velocity is not None or not case.loop[-1].prompt:  # drives move as they will
        return tuple(found)
    if case.path:  # where it is not the path that is too fast, gain and path have a share in it
        return *(() if case.seen.by_error else slower_path(case, 0.8 / excess, "velocity")), *found
    words = f"reduce {_words(law, 0.9 / excess, 'to')}"
    return *found, Remedy(change={"alpha": _gain(law, 0.9 / excess)}, words=words, mends="velocity")


def freer(case) -> tuple:
    """What keeps the tasks of a stack nearer to their targets within the limits: joints that share the motion, or a
    path that asks for less."""
    shared = Remedy(change={"limits": "bounded"}, words="use limits=bounded()")
    slows = not isinstance(case.law.limits, Bounded) and _damped(case.law) and case.seen.at_velocity.any()
    slower = slower_path(case, 0.5) if case.moving and case.path and case.seen.at_velocity.any() else ()
    return ((shared,) if slows else ()) + slower


def inside(case) -> tuple:
    """Limits that keep joints inside theirs, where all of them began there and no drive carries them farther."""
    q, chain = case.q0, case.law.chain
    began = np.all((q >= np.array(chain.lower)) & (q <= np.array(chain.upper)))
    if reasons.keeps_positions(case.law) or not (began and case.loop[-1].prompt and _damped(case.law)):
        return ()
    words = "keep the joints inside with limits=bounded()"
    return (Remedy(change={"limits": "bounded"}, words=words, mends="limits"),)


def _damped(law) -> bool:
    """Whether `bounded`, which needs damping, works with the law's inverse."""
    return not isinstance(law.inverse, Pseudoinverse)


def less_damping(case) -> tuple:
    """A tenth of the damping of a stack, which may keep tips from targets that can be had."""
    inverse, words = case.law.inverse, "a tenth of the damping"
    if isinstance(inverse, Levels):
        return (Remedy(change={"damping_share": 0.1}, words=f"use {words} of each level"),)
    if not isinstance(inverse, Damped):
        return ()
    less = float(f"{0.1 * float(np.max(np.asarray(inverse.damping))):.2g}")
    return (Remedy(change={"damping": less}, words=f"use inverse=damped({less:g}), {words}"),)


def less_pull(case) -> tuple:
    """What ends the pull of a null-space velocity at the task."""
    exact: tuple = (Remedy(change={"inverse": "pseudoinverse", "damping": None}, words="use inverse=pseudoinverse()"),)
    exact = () if isinstance(case.law.limits, Bounded) else exact  # which needs damping
    slower = Remedy(change={"null_gain": 0.3}, words="slow the null-space velocity to 0.3 of what it is")
    damping = getattr(case.law.inverse, "damping", None)
    if damping is None:
        return (*exact, slower)
    less = 0.3 * float(np.max(np.asarray(damping)))
    return (*exact, Remedy(change={"damping": less}, words=f"less damping, inverse=damped({less:.2g})"), slower)
