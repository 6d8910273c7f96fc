"""Figures of a tuning: its history, the error before and after, where it works on the stability map, responses."""

import matplotlib.pyplot as plt
import numpy as np

from cnclik.show import style
from cnclik.show.stability import radii

_LEAST = 1e-16  # a loss below it is rounding
_APART = 1e-3  # of the step: what is less is within the width of a line
_BEFORE = {"color": "0.7", "linewidth": 2.6, "label": "before"}  # visible behind a coinciding one
_AFTER = {"color": style.BLUE, "linewidth": 1.2, "label": "after"}


def history(tuned):
    """Loss and worst constraint against the number of evaluations."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(style.COLUMN, 3.2), sharex=True)
    loss, violation = np.asarray(tuned.history["loss"]), np.asarray(tuned.history["violation"])
    count = np.arange(1, len(loss) + 1)
    upper.plot(count, np.where(loss > _LEAST, loss, np.nan), color=style.BLUE)
    style.log_scale(upper.yaxis, loss)
    upper.set_ylabel("loss")
    upper.set_title(tuned.loss, loc="left")
    lower.plot(count, 100 * np.clip(violation, -1, 1), color=style.BLUE)
    lower.axhline(0.0, **style.GUIDE)
    above = {"xytext": (0, 2), "textcoords": "offset points", "ha": "right"}
    lower.annotate("bound", (1, 0.0), xycoords=("axes fraction", "data"), **above, **style.NOTE)
    lower.set_ylabel("worst constraint,\nbeyond its bound [%]")
    lower.set_xlabel("evaluations with gradient")
    return figure


def error(tuned):
    """Norm of position and orientation error before and after; of a stack that of each task."""
    task = tuned.law.task
    parts = {"position error [m]": task.lengths, "orientation error [rad]": task.angles}
    if task.tasks:
        units = np.array(task.units)
        parts = {f"{name} [{', '.join(dict.fromkeys(units[at]))}]": [*range(task.m)[at]] for name, at in task.each}
    parts = {name: part for name, part in parts.items() if part}
    size = (style.COLUMN, 0.6 + 1.5 * len(parts))
    figure, axes = plt.subplots(len(parts), 1, figsize=size, sharex=True, squeeze=False)
    for axis, (name, part) in zip(axes[:, 0], parts.items(), strict=True):
        norms = [np.linalg.norm(np.asarray(made.run.e)[:, part], axis=1) for made in (tuned.before, tuned.after)]
        for made, norm, look in zip((tuned.before, tuned.after), norms, (_BEFORE, _AFTER), strict=True):
            axis.plot(np.asarray(made.run.t), np.where(norm > 0, norm, np.nan), **look)
        style.log_errors(axis, norms)
        axis.set_ylabel(name)
    axes[0, 0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2)
    axes[-1, 0].set_xlabel("time [s]")
    return figure


def operating(field, tuned):
    """Spectral radius of the linear loop over gain and sampling time, with the operating points.

    Args:
      field: Dataset over (Ts, alpha) with `radius`, see `tuning.radius_field`.
    """
    figure, axis = plt.subplots(figsize=(style.COLUMN, 2.8))
    plane = field.alpha, field.Ts, field.radius
    radii(axis, *plane)
    if tuned.margin < 1:
        axis.contour(*plane, levels=[tuned.margin], colors="black", linewidths=1.0, linestyles=[style.DASH])
    axis.set(xlabel=f"{field.attrs['gain']} [1/s]", ylabel="sampling time [s]")
    low, high = float(field.alpha[0]), float(field.alpha[-1])
    point = {"linestyle": "none", "markeredgecolor": "white", "zorder": 5, "clip_on": False}
    for x, y, marker, size, color, label in (
        (tuned.before.z / field.attrs["Ts_before"], field.attrs["Ts_before"], "o", 9, "0.35", "before"),
        (tuned.after.z / tuned.Ts, tuned.Ts, "D", 5, style.FINE if tuned.satisfied else style.WARNING, "after"),
    ):
        if low <= x <= high:
            axis.plot(x, y, marker=marker, markersize=size, color=color, label=label, **point)
    edges = [(1.0, {"linewidth": 1.4}, "stability limit")]
    if tuned.margin < 1:
        edges.append((tuned.margin, {"linewidth": 1.0, "linestyle": style.DASH}, f"margin {tuned.margin:g}"))
    for level, look, label in edges:
        if float(field.radius.min()) < level < float(field.radius.max()):
            axis.plot([], [], color="black", label=label, **look)
    axis.legend(ncols=2 if len(edges) > 1 else 3, loc="lower left", bbox_to_anchor=(-0.1, 1), borderaxespad=0.2)
    return figure


def front(tuned):
    """Loss of smaller and larger gains over their noise gain and their dead-time margin."""
    data, kept = tuned.front, tuned.front["violation"] <= 1e-6
    figure, panels = plt.subplots(2, 1, figsize=(style.COLUMN, 3.8))
    names = (("noise_gain", "noise gain"), ("delay_margin", "dead-time margin [samples]"))
    for panel, (name, label) in zip(panels, names, strict=True):
        x = np.where(np.isfinite(data[name]), data[name], np.nan)
        y = np.where(np.isfinite(data["loss"]), data["loss"], np.nan)
        panel.plot(x, y, color="0.6", linewidth=0.8, zorder=1)
        for some, look, word in ((kept, style.BLUE, "constraints kept"), (~kept, "white", "violated")):
            panel.plot(x[some], y[some], "o", color=look, markeredgecolor=style.BLUE, markersize=4, label=word)
        after, word = getattr(tuned.after, name), "recommended" if tuned.satisfied else "least violation"
        color = style.FINE if tuned.satisfied else style.WARNING
        panel.plot([after], [tuned.after.loss], "D", color=color, markersize=6, label=word, zorder=5)
        panel.set_xlabel(label)
        style.log_scale(panel.xaxis, x, decades=4)
        style.log_scale(panel.yaxis, y)
    figure.supylabel(f"loss: {tuned.loss}")
    style.legend(figure, panels[0])
    return figure


def responses(data):
    """Step and sine response around the resting posture for each task axis, and the error of the sine."""
    figure, panels = plt.subplots(3, 1, figsize=(style.COLUMN, 4.2))
    together = _together(data)
    for panel, test in zip(panels[:2], ("step", "sine"), strict=True):
        one = data.sel(test=test).isel(time=slice(0, data.attrs["shown"] if test == "step" else None))
        panel.plot(one.time, one.wanted[0], color="0.55", linewidth=2.4, label="target", zorder=1)
        _lines(panel, one, one.response, "." if test == "step" else "", together)
        panel.set_ylabel(f"{test} response\n(target: {'1' if test == 'step' else '±1'})")
    panels[1].set_title(f"sine of {1 / data.attrs['period']:.3g} Hz", loc="left", pad=2)
    sine = data.sel(test="sine")
    _lines(panels[2], sine, sine.wanted - sine.response, "", together)
    panels[2].set_ylabel("error of the sine\n(target: ±1)")
    panels[2].ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
    panels[2].set_xlabel("time [s]")
    panels[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return figure


def _lines(panel, one, values, marker, together):
    for i, names in enumerate(together):
        look = style.series(i, marker=marker, markerfacecolor=None, zorder=2)
        panel.plot(one.time, values.sel(axis=names[0]), label=", ".join(names), **look)


def _together(data):
    """Names of the axes, those whose responses can't be told apart in one group."""
    groups = []
    for name in data.axis.values:
        own = data.response.sel(axis=name)
        for group in groups:
            if float(np.abs(own - data.response.sel(axis=group[0])).max()) < _APART:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def drawings(tuned) -> dict:
    """{name: function of no arguments that draws it}, for what the result allows; see `cnclik.show.output.draw`."""
    from cnclik.tuning import end_responses, radius_field

    drawn = {"history": lambda: history(tuned)} if len(tuned.history["loss"]) else {}
    drawn["error"] = lambda: error(tuned)
    if tuned.status != "non-finite" and np.isfinite(np.asarray(tuned.after.run.q)[-1]).all():
        drawn["operating"] = lambda: operating(radius_field(tuned), tuned)
        if len(tuned.front["z"]):
            drawn["front"] = lambda: front(tuned)
        if not tuned.law.task.tasks:
            drawn["responses"] = lambda: responses(end_responses(tuned))
    return drawn
