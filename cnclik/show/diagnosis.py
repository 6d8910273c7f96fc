"""Figures of recordings: what was found in them, and a drive beside the motion that it was fitted to."""

import matplotlib.pyplot as plt
import numpy as np

from cnclik.show import style

MOST = 8  # largest number of columns shown; those that move most are chosen
_DOTS = {"color": "0.55", "markersize": 3.5, "markerfacecolor": "white", "markeredgewidth": 0.5}


def oscillation(signal, found, names):
    """The recording and the oscillation in it, if there is one; a panel for each column.

    Args:
      signal: (N, k). found: `Diagnosis` of it. names: of the columns.
    """
    shown = np.sort(np.argsort(-np.std(signal, axis=0), kind="stable")[:MOST])
    figure, panels = _panels(len(shown))
    t = found.Ts * np.arange(len(signal))
    for panel, i in zip(panels, shown, strict=True):
        panel.plot(t, signal[:, i], "o", **_DOTS, label="recorded")
        if found.period is not None:
            panel.plot(t, found.fitted[:, i], color=style.BLUE, label="fitted")
        panel.set_ylabel(f"{names[i]} [rad or m]")
    style.legend(figure, panels[0])
    return figure


def drive(Ts, command, motion, fit, names):
    """Command, motion, and the motion of the drive that was fitted; a panel for each joint.

    Args:
      Ts: [s]. command, motion: (N, k). fit: `DriveFit`. names: of the motions.
    """
    figure, panels = _panels(min(motion.shape[1], MOST))
    t, positions = Ts * np.arange(len(motion)), fit.drive.command == "position"
    look = {"color": style.BLACK, "linestyle": style.DOT, "label": "command"}
    for i, panel in enumerate(panels):
        right = panel if positions else panel.twinx()
        right.step(t, command[:, i], where="post", **look)
        panel.plot(t, motion[:, i], "o", **_DOTS, label="recorded motion")
        panel.plot(t, fit.motion[:, i], color=style.BLUE, label="motion of the fitted drive")
        panel.set_ylabel(f"{names[i]} [rad or m]")
        if not positions:
            right.set_ylabel("command [rad or m per s]")
            right.grid(False)
            right.spines["right"].set_visible(True)
            panel.plot([], [], **look)
    style.legend(figure, panels[0])
    return figure


def _panels(n):
    figure, panels = plt.subplots(n, 1, sharex=True, squeeze=False, figsize=(style.PAGE, 0.9 + 1.5 * n))
    panels[-1, 0].set_xlabel("time $t$ [s]")
    return figure, panels[:, 0]
