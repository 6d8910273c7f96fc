"""Tasks: which gains of a stack make it swing, from the recorded errors of its tasks.

All tasks have the same drives, and no rate of their loop is larger than the largest gain (docs/theory.md): the gain
that one task tolerates is a limit of all, whatever their units, weights and levels.
"""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.diagnosis.diagnose import diagnose
from cnclik.record import record

ALIKE = 0.1  # relative difference, at most, between the periods of one mode
ALONG = 1e-3  # share of a mode below which a task with an unknown gain only swings along
NEAR = 1.25  # factor above the recommended gain up to which a gain may stay


@record
class StackDiagnosis:
    """What the logs of several tasks show.

    Attributes:
      tasks: {name: `Diagnosis`}. share: {name: its part of gain · error² in the mode that swings}, 0 where it does not.
      change: tasks whose gain is to be changed, that of the largest share first.
      recommended_alpha: the largest gain for any task [1/s], or None. factor: of the gains to be changed.
    """

    tasks: dict
    share: dict
    change: tuple
    recommended_alpha: float | None
    factor: dict

    def __str__(self):
        lines = []
        for name, one in self.tasks.items():
            words = (
                f"oscillates with {self.change[0]}"
                if self.change and one.rings and name not in self.change
                else str(one)
            )
            if name in self.change:
                words = (
                    f"{one.kind}, {100 * self.share[name]:.3g} % of the swing: {self.factor[name]:.3g} times its gain"
                )
            lines.append(f"{name}: {words}")
        if self.recommended_alpha is not None:
            lines.append(f"No task may have an alpha above {self.recommended_alpha:.4g} 1/s.")
        return "\n".join(lines)


def diagnose_tasks(signals, Ts: float, *, alpha=None) -> StackDiagnosis:
    """Diagnose a stack: which gains make it swing, and the largest gain that any task may have.

    Args:
      signals: {task: (N, k)} its errors. Ts: as for `diagnose`. alpha: {task: gain [1/s]} of those that are known.
    Raises: as `diagnose`, and for an alpha of a task that is not recorded.
    """
    if not isinstance(signals, dict) or not signals:
        raise errors.fail("signals", "be {task: errors}", f"is {type(signals).__name__}")
    if not isinstance(alpha, dict | None):
        raise errors.fail("alpha", "be {task: gain}", f"is {alpha!r}")
    known = {
        errors.one_of("alpha", n, signals): float(errors.number("alpha", a, positive=True))
        for n, a in (alpha or {}).items()
    }
    largest = max(known.values()) if len(known) == len(signals) else None  # no mode is faster
    each: dict = {}
    for name, signal in signals.items():
        with errors.within(name):
            each[name] = diagnose(signal, Ts, alpha=largest)
    swing = {n: one for n, one in each.items() if one.rings}
    share = dict.fromkeys(each, 0.0)
    if not swing:
        return StackDiagnosis(tasks=each, share=share, change=(), recommended_alpha=None, factor={})
    lead = max(swing.values(), key=lambda one: (one.confidence, one.growth**one.period))
    most = max(float(np.max(one.amplitude)) for one in swing.values()) or 1.0  # squares of tiny ones underflow
    sizes = {
        n: (known[n] if largest else 1.0) * float(np.sum((one.amplitude / most) ** 2))
        for n, one in swing.items()
        if abs(one.period / lead.period - 1) < ALIKE
    }
    share |= {n: size / sum(sizes.values()) for n, size in sizes.items()}
    factor = {n: lead.recommended_alpha / a for n, a in known.items() if a > NEAR * lead.recommended_alpha}
    factor |= {n: lead.factor for n in sizes if n not in known and share[n] > ALONG}
    change = tuple(sorted(factor, key=lambda n: -share[n]))
    return StackDiagnosis(
        tasks=each, share=share, change=change, recommended_alpha=lead.recommended_alpha, factor=factor
    )
