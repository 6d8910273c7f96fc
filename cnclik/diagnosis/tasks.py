"""Tasks: which gain of a stack to change, from the recorded errors of its tasks.

A stack's loop at rest is e[k+1] = e[k] − Ts J J# K e[k−d], with one dead time for all. With K^½ J J# K^½ u = z u
(weighted, symmetric), a mode's z depends on the gain k of a task by ∂ log z/∂ log k, the task's part of ‖u‖², and thus
of K e². The task with the largest part causes the mode; the others oscillate with it. As z ≤ Ts max(K), gains below
the limit of one task suffice, whatever the units, weights and levels by which errors compare.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cnclik import errors
from cnclik.diagnosis.advice import NEAR
from cnclik.diagnosis.diagnose import LONGEST, Diagnosis, diagnose
from cnclik.precision import of_numbers
from cnclik.record import record, replace

ALIKE = 0.1  # relative difference, at most, between the periods of one mode
ALONG = 0.1  # part of a mode below which a task only oscillates with another one
UNKNOWN = 1e-3  # the same where a gain is unknown: errors in rad and in m, or of two levels, compare badly


@record
class TaskDiagnosis:
    """The result for the errors of one task.

    Attributes:
      found: `Diagnosis` of them alone, with the gain of the task that makes their swing. share: its share of the mode
        in which it oscillates; 1 if no other task does. z changes by this many per cent for one per cent of its gain,
        for tasks of one level, in one unit and with equal weights.
      along: the task with which it oscillates, whose gain should be changed, or "".
      alpha, recommended_alpha: present gain, if given, and recommended one [1/s]. factor: their ratio. None where the
        gain may be kept or nothing is known.
      words: what to do.
    """

    found: Diagnosis
    share: float
    along: str
    alpha: float | None
    recommended_alpha: float | None
    factor: float | None
    words: str


@record
class StackDiagnosis:
    """The result for a recording of several tasks.

    Attributes:
      tasks: {name: `TaskDiagnosis`}. change: tasks whose gain should be changed, the surest first.
      delay: dead time of the surest oscillation [samples], or None.
    """

    tasks: dict
    change: tuple
    delay: float | None

    def __str__(self):
        return "\n".join(f"{name}: {one.words}" for name, one in self.tasks.items())


@of_numbers
def diagnose_tasks(signals, Ts: float, *, alpha=None, longest: float = LONGEST, progress=None) -> StackDiagnosis:
    """Which task of a stack oscillates because of its own gain, and the gain that stops it.

    Args:
      signals: {task: (N, k)} its errors, in one unit and with equal weights where they are to be compared.
      Ts, longest, progress: as for `diagnose`. alpha: {task: gain [1/s]} of those that are known, or None.
    Raises: as `diagnose`, and for an alpha of a task that is not recorded.
    """
    if not isinstance(signals, dict) or not signals:
        raise errors.fail("signals", "be {task: errors}", f"is {type(signals).__name__}")
    if not isinstance(alpha, dict | None):
        raise errors.fail("alpha", "be {task: gain}", f"is {alpha!r}")
    gains: dict[str, Any] = dict.fromkeys(signals) | dict(alpha or {})
    for name in gains:
        errors.one_of("alpha", name, signals)
    each = {}
    for i, (name, signal) in enumerate(signals.items()):
        with errors.within(name):
            one = diagnose(signal, Ts, alpha=gains[name], longest=longest)
            if (other := _maker(one, gains)) is not None:
                one = diagnose(signal, Ts, alpha=other, longest=longest)
            each[name] = one
        if progress is not None:
            progress(i + 1, len(signals), name)
    known = None not in gains.values()  # otherwise gains do not compare
    largest = max(float(np.max(one.amplitude)) for one in each.values()) or 1.0  # squares of tiny ones underflow
    sizes = {n: (gains[n] if known else 1.0) * float(np.sum((one.amplitude / largest) ** 2)) for n, one in each.items()}
    seen = {name: _seen(name, each, gains, sizes) for name in each}
    lead = max((one for one in each.values() if one.rings and one.recommended is not None), key=_surest, default=None)
    if lead is not None:
        most = lead.recommended / lead.Ts
        if known:  # z ≤ Ts max(alpha), unless measurement or drive change the gain
            most /= max(1.0, lead.z / (lead.Ts * max(gains.values())))
        seen = {name: _borne(one, most, one.found is lead) for name, one in seen.items()}
    factors = {name: one.factor for name, one in seen.items() if one.factor is not None}
    return StackDiagnosis(
        tasks=seen,
        change=tuple(sorted(factors, key=lambda name: (seen[name].found is not lead, factors[name]))),
        delay=None if lead is None else lead.delay,
    )


def _maker(one, gains) -> float | None:
    """The larger gain of another task that makes the swing of this one; None if its own may, or if there is none."""
    if not one.rings or one.recommended is not None or one.alpha is None or not (one.z or 0) > one.alpha * one.Ts:
        return None
    apart = {a: abs(np.log(one.z / (a * one.Ts))) for a in gains.values() if a is not None}
    nearest = min(apart, key=lambda a: apart[a])
    return nearest if apart[nearest] < np.log(NEAR) and nearest != one.alpha else None


def _surest(one):
    """The order in which the dead time of all tasks is read: by confidence, and then the slowest to end."""
    return round(one.confidence, 1), one.growth**one.period


def _seen(name, each, gains, sizes) -> TaskDiagnosis:
    """One task beside those that oscillate with the same period."""
    own = each[name]
    made = dict(found=own, alpha=gains[name], along="", share=1.0, recommended_alpha=None, factor=None)
    if not own.rings:
        return TaskDiagnosis(**made, words=str(own))
    mode = [n for n, one in each.items() if one.rings and abs(one.period - own.period) <= ALIKE * own.period]
    made["share"] = sizes[name] / max(sum(sizes[n] for n in mode), np.finfo(float).tiny)
    lead = max(mode, key=lambda n: sizes[n])
    known = None not in gains.values()
    if made["share"] < (ALONG if known else UNKNOWN):
        made["along"] = lead
        words = f"oscillates with {lead}, and has {100 * made['share']:.2g} % of the swing."
        words += "" if gains[name] is not None else " With the gains of all tasks the answer is surer."
        return TaskDiagnosis(**made, words=words)
    made |= dict(recommended_alpha=own.recommended_alpha, factor=own.factor)
    return TaskDiagnosis(**made, words=str(own))


def _borne(one, most, leads) -> TaskDiagnosis:
    """Compares a task's gain with the largest [1/s] at the dead time of the surest oscillation, which all tasks share.

    Gains up to it suffice, whatever the units, weights and levels of the tasks.
    """
    if one.alpha is None:
        return one
    if one.alpha <= most * NEAR:
        words = f"{one.words} Keep its gain." if one.along else one.words
        if one.found.rings and not one.along:
            words = f"{one.found.kind}, but {one.alpha:g} 1/s do not overshoot at this dead time. Keep its gain."
        return replace(one, recommended_alpha=None, factor=None, words=words)
    if leads and one.factor is not None and one.recommended_alpha <= most * NEAR:
        return one
    much = f"At this dead time any task overshoots above {most:.4g} 1/s."
    return replace(one, recommended_alpha=most, factor=most / one.alpha, words=f"{one.words} {much}")
