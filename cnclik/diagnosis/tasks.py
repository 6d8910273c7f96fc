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
    """Answer of `diagnose_tasks`: what the logs of several tasks show.

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
        for name, found in self.tasks.items():
            words = f"oscillates with {self.change[0]}" if self.change and found.rings else str(found)
            if name in self.factor:
                part = f"{100 * self.share[name]:.3g} % of the swing"
                words = f"{found.kind}, {part}: {self.factor[name]:.3g} times its gain"
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
    gains = {
        errors.one_of("alpha", n, signals): float(errors.number("alpha", a, positive=True))
        for n, a in (alpha or {}).items()
    }
    largest = max(gains.values()) if len(gains) == len(signals) else None  # no mode is faster
    tasks: dict = {}
    for name, signal in signals.items():
        with errors.within(name):
            tasks[name] = diagnose(signal, Ts, alpha=largest)
    swing = {n: found for n, found in tasks.items() if found.rings}
    share, factor, best = dict.fromkeys(tasks, 0.0), {}, None
    if swing:
        lead = max(swing.values(), key=lambda found: (found.confidence, found.growth**found.period))
        best = lead.recommended_alpha
        unit = max(np.max(found.amplitude) for found in swing.values()) or 1.0  # squares of tiny ones underflow
        along = [n for n, found in swing.items() if abs(found.period / lead.period - 1) < ALIKE]
        power = {n: (gains[n] if largest else 1.0) * np.sum((tasks[n].amplitude / unit) ** 2) for n in along}
        share |= {n: float(each / sum(power.values())) for n, each in power.items()}
        factor = {n: best / gain for n, gain in gains.items() if gain > NEAR * best}
        factor |= {n: lead.factor for n in along if n not in gains and share[n] > ALONG}
    change = tuple(sorted(factor, key=lambda n: -share[n]))
    return StackDiagnosis(tasks=tasks, share=share, change=change, recommended_alpha=best, factor=factor)
