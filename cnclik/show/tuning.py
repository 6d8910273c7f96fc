"""Figures of a tuning: its history, the error before and after, where it works on the stability map, responses."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import ticker

from cnclik.show import style

_LEAST = 1e-16
_BEFORE = {"color": "0.55", "linewidth": 1.2, "label": "before"}
_AFTER = {"color": style.BLUE, "linewidth": 1.2, "label": "after"}


def history(tuned):
    """Loss and worst constraint against the number of evaluations."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(style.COLUMN, 3.2), sharex=True)
    loss, violation = np.asarray(tuned.history["loss"]), np.asarray(tuned.history["violation"])
    count = np.arange(1, len(loss) + 1)
    upper.semilogy(count, np.where(loss > _LEAST, loss, np.nan), color=style.BLUE)
    upper.set_ylabel("loss")
    upper.set_title(tuned.loss, loc="left")
    lower.plot(count, 100 * np.clip(violation, -1, 1), color=style.VERMILION)
    lower.axhline(0.0, **style.GUIDE)
    above = {"xytext": (0, 2), "textcoords": "offset points", "ha": "right"}
    lower.annotate("bound", (1, 0.0), xycoords=("axes fraction", "data"), **above, **style.NOTE)
    lower.set_ylabel("worst constraint,\nbeyond its bound [%]")
    lower.set_xlabel("evaluations with gradient")
    return figure


def error(tuned):
    """Norm of position and orientation error before and after."""
    count = len(tuned.law.task.position)
    parts = {"position error [m]": slice(count)} if count else {}
    if tuned.law.task.orientation:
        parts["orientation error [rad]"] = slice(count, None)
    size = (style.COLUMN, 0.6 + 1.5 * len(parts))
    figure, axes = plt.subplots(len(parts), 1, figsize=size, sharex=True, squeeze=False)
    for axis, (name, part) in zip(axes[:, 0], parts.items(), strict=True):
        for run, look in ((tuned.before.run, _BEFORE), (tuned.after.run, _AFTER)):
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
      field: Dataset over (Ts, alpha) with `radius`, see `tuning.radius_field`.
    """
    figure, axis = plt.subplots(figsize=(style.COLUMN, 2.8))
    levels = [0, 0.2, 0.4, 0.6, 0.8, 1.0, 1e9]
    shades = ["#eaf3fa", "#cfe3f2", "#a9cde6", "#7fb2d6", "#4f93c1", "0.82"]
    plane = field.alpha, field.Ts, field.radius
    axis.contourf(field.alpha, field.Ts, np.minimum(field.radius, 10), levels=levels, colors=shades)
    lines = axis.contour(*plane, levels=[0.2, 0.4, 0.6, 0.8], colors="0.35", linewidths=0.4)
    axis.clabel(lines, fontsize=6, fmt="%.1f")
    axis.contour(*plane, levels=[1.0], colors="black", linewidths=1.0)
    if tuned.margin < 1:
        axis.contour(*plane, levels=[tuned.margin], colors=style.VERMILION, linewidths=1.0, linestyles="--")
    axis.set(xscale="log", yscale="log", xlabel=f"{field.attrs['gain']} [1/s]", ylabel="sampling time [s]")
    axis.grid(False)
    low, high = float(field.alpha[0]), float(field.alpha[-1])
    point = {"linestyle": "none", "markersize": 6, "markeredgecolor": "white", "zorder": 5, "clip_on": False}
    for x, y, marker, color, label in (
        (tuned.before.z / field.attrs["Ts_before"], field.attrs["Ts_before"], "o", "0.35", "before"),
        (tuned.after.z / tuned.Ts, tuned.Ts, "D", style.VERMILION, "after"),
    ):
        if low <= x <= high:
            axis.plot(x, y, marker=marker, color=color, label=label, **point)
    edges = [(1.0, {"color": "black"}, "stable to here")]
    if tuned.margin < 1:
        edges.append((tuned.margin, {"color": style.VERMILION, "linestyle": "--"}, f"margin {tuned.margin:g}"))
    for level, look, label in edges:
        if float(field.radius.min()) < level < float(field.radius.max()):
            axis.plot([], [], linewidth=1.0, label=label, **look)
    axis.legend(ncols=2, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return figure


def front(tuned):
    """Loss of gains of other sizes, against the noise that they pass on and the further dead time that they bear."""
    data, kept = tuned.front, tuned.front["violation"] <= 1e-6
    figure, panels = plt.subplots(2, 1, figsize=(style.COLUMN, 3.8))
    names = (("noise_gain", "noise gain"), ("delay_margin", "dead time to spare [samples]"))
    for panel, (name, label) in zip(panels, names, strict=True):
        x = np.where(np.isfinite(data[name]), data[name], np.nan)
        y = np.where(np.isfinite(data["loss"]), data["loss"], np.nan)
        panel.plot(x, y, color="0.6", linewidth=0.8, zorder=1)
        for some, look, word in ((kept, style.COLORS[0], "kept"), (~kept, "white", "not kept")):
            panel.plot(x[some], y[some], "o", color=look, markeredgecolor=style.COLORS[0], markersize=4, label=word)
        after, word = getattr(tuned.after, name), "recommended" if tuned.satisfied else "exceeds least"
        panel.plot([after], [tuned.after.loss], "D", color=style.VERMILION, markersize=6, label=word, zorder=5)
        panel.set(xscale="log", yscale="log", xlabel=label, ylabel=f"loss: {tuned.loss}")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(ticker.FormatStrFormatter("%.3g"))
            axis.set_minor_formatter(ticker.NullFormatter())
    panels[0].legend(ncols=3, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return figure


def responses(data):
    """Step and sine test around the resting place, per task axis, and what the sine leaves as an error."""
    figure, panels = plt.subplots(3, 1, figsize=(style.COLUMN, 4.2))
    for panel, test in zip(panels[:2], ("step", "sine"), strict=True):
        one = data.sel(test=test).isel(time=slice(0, data.attrs["shown"] if test == "step" else None))
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
        look = {"color": style.COLORS[i % 6], "linestyle": style.DASHES[i % 6], "marker": marker, "zorder": 2}
        panel.plot(one.time, values.sel(axis=name), label=name, **look)


def drawings(tuned) -> dict:
    """{name: function of no arguments that draws it}, for what the result allows; see `cnclik.show.output.draw`."""
    from cnclik.tuning import end_responses, radius_field

    drawn = {"history": lambda: history(tuned)} if len(tuned.history["loss"]) else {}
    drawn["error"] = lambda: error(tuned)
    if tuned.status != "non-finite" and np.isfinite(np.asarray(tuned.after.run.q)[-1]).all():
        drawn["operating"] = lambda: operating(radius_field(tuned), tuned)
        if len(tuned.front["z"]):
            drawn["front"] = lambda: front(tuned)
        drawn["responses"] = lambda: responses(end_responses(tuned))
    return drawn
