"""The figure of a tuning: the error over time, before and after."""

import matplotlib.pyplot as plt
import numpy as np

from cnclik.show import style

_BEFORE = {"color": "0.7", "linewidth": 2.6, "label": "before"}  # visible behind a coinciding one
_AFTER = {"color": style.BLUE, "linewidth": 1.2, "label": "after"}


def error(tuned):
    """Return a figure of the norm of position and orientation error; of a stack, of each task."""
    task, units = tuned.law.task, np.array(tuned.law.task.units)
    parts = {f"{name} [{', '.join(dict.fromkeys(units[at]))}]": at for name, at in task.each}
    parts = parts or {"position error [m]": list(task.lengths), "orientation error [rad]": list(task.angles)}
    parts = {name: at for name, at in parts.items() if units[at].size}
    size = (style.COLUMN, 0.6 + 1.5 * len(parts))
    figure, panels = plt.subplots(len(parts), 1, figsize=size, sharex=True, squeeze=False)
    for panel, (name, at) in zip(panels[:, 0], parts.items(), strict=True):
        norms = [np.linalg.norm(run.e[:, at], axis=1) for run in (tuned.before, tuned.after)]
        for norm, look in zip(norms, (_BEFORE, _AFTER), strict=True):
            panel.plot(tuned.after.t, np.where(norm > 0, norm, np.nan), **look)
        style.log_errors(panel, norms)
        panel.set_ylabel(name)
    panels[0, 0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2)
    panels[-1, 0].set_xlabel("time [s]")
    return figure
