"""Figures of a tuning: its history, the error before and after, where it works on the stability map, responses."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from cnclik.show import style

_LEAST = 1e-16
_BEFORE = {"color": "0.55", "linewidth": 1.2, "label": "before"}
_AFTER = {"color": style.BLUE, "linewidth": 1.2, "label": "after"}
_COLORS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.PURPLE, style.SKY)
_DASHES = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 2)))


def history(tuned):
    """Loss and worst constraint against the number of evaluations."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(style.COLUMN, 3.2), sharex=True)
    loss, violation = np.asarray(tuned.history["loss"]), np.asarray(tuned.history["violation"])
    count = np.arange(1, len(loss) + 1)
    upper.semilogy(count, np.where(loss > _LEAST, loss, np.nan), color=style.BLUE)
    upper.set_ylabel("loss")
    upper.set_title(tuned.loss, loc="left")
    lower.plot(count, tuned.margin * (1 + np.clip(violation, -1, 1)), color=style.VERMILION)
    lower.axhline(tuned.margin, **style.GUIDE)
    lower.annotate(
        "bound", (1, tuned.margin), xytext=(0, 2), textcoords="offset points", ha="right",
        xycoords=("axes fraction", "data"), fontsize=6.5, color="0.35",
    )  # fmt: skip
    lower.set_ylabel("worst constraint,\nas a radius")
    lower.set_xlabel("evaluations with gradient")
    return figure


def error(tuned, task):
    """Norm of position and orientation error before and after."""
    count = len(task.position)
    parts = [
        (name, part)
        for name, part, size in (
            ("position error [m]", slice(0, count), count),
            ("orientation error [rad]", slice(count, None), task.m - count),
        )
        if size
    ]
    figure, axes = plt.subplots(
        len(parts), 1, figsize=(style.COLUMN, 0.6 + 1.5 * len(parts)), sharex=True, squeeze=False
    )
    for axis, (name, part) in zip(axes[:, 0], parts, strict=True):
        for run, look in ((tuned.before, _BEFORE), (tuned.after, _AFTER)):
            norm = np.linalg.norm(np.asarray(run.e)[:, part], axis=1)
            shown = np.where(np.isfinite(norm) & (norm > _LEAST), norm, np.nan)
            axis.semilogy(np.asarray(run.t), shown, **look)
        axis.set_ylabel(name)
    axes[0, 0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2)
    axes[-1, 0].set_xlabel("time [s]")
    return figure


def operating(field, tuned):
    """Spectral radius of the linear loop over gain and sampling time, with the operating points.

    Args:
      field: Dataset over (Ts, alpha) with `radius`.
    """
    figure, axis = plt.subplots(figsize=(style.COLUMN, 2.8))
    levels = [0, 0.2, 0.4, 0.6, 0.8, 1.0, 1e9]
    shades = ["#eaf3fa", "#cfe3f2", "#a9cde6", "#7fb2d6", "#4f93c1", "0.82"]
    axis.contourf(field.alpha, field.Ts, np.minimum(field.radius, 10), levels=levels, colors=shades)
    lines = axis.contour(
        field.alpha, field.Ts, field.radius, levels=[0.2, 0.4, 0.6, 0.8], colors="0.35", linewidths=0.4
    )
    axis.clabel(lines, fontsize=6, fmt="%.1f")
    axis.contour(field.alpha, field.Ts, field.radius, levels=[1.0], colors="black", linewidths=1.0)
    bound = axis.contour(
        field.alpha, field.Ts, field.radius, levels=[tuned.margin], colors=style.VERMILION, linewidths=1.0
    )
    bound.set_linestyle("--")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.grid(False)
    low, high = float(field.alpha[0]), float(field.alpha[-1])
    point = {"linestyle": "none", "markersize": 6, "markeredgecolor": "white", "zorder": 5, "clip_on": False}
    for x, y, marker, color, label in (
        (tuned.z_before / field.attrs["Ts_before"], field.attrs["Ts_before"], "o", "0.35", "before"),
        (tuned.z / tuned.Ts, tuned.Ts, "D", style.VERMILION, "after"),
    ):
        if low <= x <= high:
            axis.plot(x, y, marker=marker, color=color, label=label, **point)
    axis.plot([], [], color="black", linewidth=1.0, label="stable to here")
    axis.plot([], [], color=style.VERMILION, linestyle="--", linewidth=1.0, label=f"margin {tuned.margin:g}")
    axis.legend(ncols=2, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    axis.set_xlabel(f"{field.attrs['gain']} [1/s]")
    axis.set_ylabel("sampling time [s]")
    return figure


def responses(data):
    """Step and sine test around the resting place, per task axis, and what the sine leaves as an error."""
    figure, panels = plt.subplots(3, 1, figsize=(style.COLUMN, 4.2))
    for panel, test in zip(panels[:2], ("step", "sine"), strict=True):
        one = data.sel(test=test).isel(time=slice(0, 26 if test == "step" else None))
        panel.plot(one.time, one.wanted[0], color="0.55", linewidth=2.4, label="wanted", zorder=1)
        _lines(panel, one, one.response, "." if test == "step" else "")
        panel.set_ylabel(f"{test} response")
    sine = data.sel(test="sine")
    _lines(panels[2], sine, sine.wanted - sine.response, "")
    panels[2].set_ylabel("sine error")
    panels[2].ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
    panels[2].set_xlabel("time [s]")
    panels[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return figure


def _lines(panel, one, values, marker):
    for i, name in enumerate(one.axis.values):
        look = {"color": _COLORS[i % 6], "linestyle": _DASHES[i % 6], "marker": marker, "zorder": 2}
        panel.plot(one.time, values.sel(axis=name), label=name, **look)


_WAYS = {
    "hand": ("0.45", "s"),
    "grid": (style.ORANGE, "^"),
    "Nelder": (style.GREEN, "v"),
    "gradient": (style.BLUE, "D"),
}


def rivals(rows):
    """What each way to find a gain reached, and how long it took.

    Args:
      rows: `study.rivals.Row`s. Hollow where a constraint is broken.
    """
    places = list(dict.fromkeys((r.case, r.gain) for r in rows))
    figure, panels = plt.subplots(1, 2, figsize=(style.PAGE, 0.9 + 0.3 * len(places)), sharey=True)
    for panel, value, label in (
        (panels[0], lambda r: r.loss, "RMS error [m, rad]"),
        (panels[1], lambda r: r.seconds if r.evaluations > 1 else 0.0, "CPU time, compilation included [s]"),
    ):
        for name, (color, marker) in _WAYS.items():
            for r in (r for r in rows if r.way.startswith(name) and value(r) > 0 and np.isfinite(value(r))):
                y = places.index((r.case, r.gain)) + 0.16 * (list(_WAYS).index(name) - 1.5)
                face = color if r.satisfied else "white"
                panel.plot(value(r), y, marker, color=color, markerfacecolor=face, markersize=4.5)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_xlabel(label)
        for y in range(1, len(places)):
            panel.axhline(y - 0.5, color="0.9", linewidth=0.5, zorder=0)
        panel.grid(False, axis="y")
    panels[0].set_yticks(range(len(places)), [f"{case}, {gain}" for case, gain in places])
    panels[0].set_ylim(len(places) - 0.5, -0.5)
    named = {name: next((r.way for r in rows if r.way.startswith(name)), None) for name in _WAYS}
    for name, (color, marker) in _WAYS.items():
        if named[name]:
            panels[0].plot([], [], marker, color=color, markersize=4.5, label=named[name])
    if not all(r.satisfied for r in rows):
        panels[0].plot([], [], "o", color="0.3", markerfacecolor="white", markersize=4.5, label="constraint broken")
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=5, loc="outside upper center")
    return figure


def pictures(tuned, task, field, data) -> dict:
    """All figures by name."""
    drawn = {"history": history(tuned)} if len(tuned.history["loss"]) else {}
    drawn["error"] = error(tuned, task)
    if field is not None:
        drawn["operating"] = operating(field, tuned)
    if data is not None:
        drawn["responses"] = responses(data)
    return drawn
