"""Figures of the paper's experiments and of what stands beside them: data -> Figure."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

from cnclik.paper.readings import ARMS
from cnclik.show import style

_ROUNDING = 1e-13  # [m, rad] what is smaller is left out of logarithmic axes


def joints(run, name):
    """Joint paths (name "q") or velocities ("qdot"), a panel for each joint, a line per method (Figs. 1, 3 …)."""
    n = run.sizes["joint"]
    rows, columns = (n, 1) if n <= 3 else (-(-n // 2), 2)
    size = (style.COLUMN if columns == 1 else style.PAGE, 0.5 + 0.95 * rows)
    figure, grid = plt.subplots(rows, columns, sharex=True, squeeze=False, figsize=size)
    panels = grid.T.ravel()
    for panel in panels[n:]:  # an odd joint's neighbour; the panel above it has the time axis
        panel.set_axis_off()
        panels[n - 1].tick_params(labelbottom=True)
        panels[n - 1].set_xlabel("time $t$ [s]")
    for i, panel in enumerate(panels[:n]):
        for k, method in enumerate(run.method.values):
            one, look = run[name].sel({"method": method}).values[:, i], style.line(method, markevery=(2 * k, 6))
            if name == "q":
                panel.plot(run.time, one, **look)
            else:
                plain = {key: value for key, value in look.items() if not key.startswith("mark")}
                panel.stairs(one, run.time.values, baseline=None, **plain | {"linewidth": 1.0})
        panel.set_title(str(run.joint.values[i]), loc="left", pad=2)
        panel.set_ylabel({"q": "$q$ [rad]", "qdot": r"$\dot q$ [rad/s]"}[name])
        panel.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
        panel.margins(x=0.01, y=0.12)
        if i % rows == rows - 1:
            panel.set_xlabel("time $t$ [s]")
    figure.align_ylabels(grid)
    style.legend(figure, panels[0])
    return figure


def errors(run):
    """Error per axis and its norm, the norm on a logarithmic scale, a line per method (paper, Figs. 2, 5, 8, 11)."""
    count = run.sizes["axis"] + 1
    figure, panels = plt.subplots(count, 1, sharex=True, figsize=(style.COLUMN, 0.62 + 1.1 * count))
    for i, method in enumerate(run.method.values):
        look = style.line(method, markevery=(2 * i, 6))
        one = run.sel({"method": method})
        for panel, axis in zip(panels, run.axis.values, strict=False):
            panel.plot(run.time, one.e.sel({"axis": axis}), **look)
        panels[-1].semilogy(run.time, one.error_norm.where(one.error_norm > _ROUNDING), **look)
    for panel, axis, unit in zip(panels, run.axis.values, run.axis_unit.values, strict=False):
        panel.set_ylabel(f"$e_{axis}$ [{unit}]")
        panel.ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
        panel.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
        panel.axhline(0, **style.GUIDE)
    panels[-1].set_ylabel(f"$\\|e\\|$ [{run.error_norm.units}]")
    panels[-1].yaxis.set_minor_formatter(NullFormatter())
    panels[-1].set_xlabel("time $t$ [s]")
    figure.align_ylabels(panels)
    style.legend(figure, panels[0])
    return figure


def work(methods):
    """Error against evaluations of f(q, t), all methods, both arms: tracking above, reaching below."""
    figure, grid = plt.subplots(2, methods.sizes["arm"], sharex=True, sharey="row", figsize=(style.PAGE, 4.3))
    for column, arm in zip(grid.T, methods.arm.values, strict=True):
        for panel, (case, quantity) in zip(column, (("track", "rms_error"), ("reach", "mean_error")), strict=True):
            for method in methods.method.values:
                at = methods.sel({"arm": arm, "case": case, "method": method})
                panel.loglog(at.evaluations, at[quantity], **style.line(method))
            if case == "reach":  # within a factor of two: a logarithmic axis would show nothing
                panel.set_yscale("linear")
        column[0].set_title(f"{ARMS[str(arm)]} arm")
        column[1].set_xlabel("evaluations of $f(q, t)$ in 3 s")
    grid[0, 0].set_ylabel("tracking: RMS $\\|e\\|$ [m]")
    grid[1, 0].set_ylabel("reaching: mean $\\|e\\|$ [m]")
    style.legend(figure, grid[0, 0])
    return figure


def orders(methods):
    """RMS tracking error against the sampling time, implicit stages converged, with slopes to compare."""
    figure, panels = plt.subplots(1, methods.sizes["arm"], sharey=True, figsize=(style.PAGE, 2.9))
    Ts = methods.Ts.values
    for panel, arm in zip(panels, methods.arm.values, strict=True):
        for method in methods.method.values:
            at = methods.sel({"arm": arm, "method": method})
            panel.loglog(Ts, at.rms_converged, **style.line(method))
        for order, anchor in ((1, "EE"), (2, "CN"), (4, "RK4")):
            first = float(methods.rms_converged.sel({"arm": arm, "method": anchor, "Ts": Ts[0]}))
            guide = 2.2 * first * (Ts / Ts[0]) ** order
            panel.loglog(Ts, guide, **style.GUIDE)
            panel.annotate(f"order {order}", (Ts[-1], guide[-1]), (0, 9), textcoords="offset points", **style.NOTE)
        panel.set_title(f"{ARMS[str(arm)]} arm, tracking")
        panel.set_xlabel("sampling time $T_s$ [s]")
        panel.set_xticks(Ts, [f"{t:g}" for t in Ts])
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.minorticks_off()
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
    panels[0].set_ylabel("RMS $\\|e\\|$ [m], stages converged")
    style.legend(figure, panels[0])
    return figure


def passes(residual, *, chosen, settled):
    """Worst last change of the joint increment over a run's steps, pass by pass of the Picard iteration.

    Args:
      residual: dims arm, reading, case, method, pass, step [rad]; one line per case and reading.
      chosen: the number of passes the run itself took, marked.
      settled: what counts as converged [rad], marked.
    """
    figure, panels = plt.subplots(1, residual.sizes["arm"], sharey=True, figsize=(style.PAGE, 2.9))
    looks = [{"linestyle": "-", "marker": "o"}, {"linestyle": (0, (4, 1.5)), "marker": "s"}]
    for panel, arm in zip(panels, residual.arm.values, strict=True):
        panel.axvline(chosen, **style.GUIDE)
        panel.axhline(settled, **style.GUIDE)
        for reading, look in zip(residual.reading.values, looks, strict=True):
            for case, color, face in zip(residual.case.values, style.COLORS, ("white", style.VERMILION), strict=False):
                worst = residual.sel({"arm": arm, "case": case, "reading": reading}).max(("step", "method"))
                look |= {"color": color, "label": f"{case}, Ts {reading.split('/')[1]}"}
                worst = worst.where(worst > _ROUNDING)
                panel.semilogy(worst["pass"], worst, markerfacecolor=face, lw=1, markevery=2, **look)
        panel.set_title(f"{ARMS[str(arm)]} arm")
        panel.set_xlabel("passes")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        right = panel.get_xlim()[1]
        panel.annotate(f"M = {chosen}", (chosen, 1), (3, 0), textcoords="offset points", **style.NOTE)
        panel.annotate("converged", (right, settled), (0, 2), textcoords="offset points", ha="right", **style.NOTE)
    panels[0].set_ylabel("worst last change [rad]")
    style.legend(figure, panels[0])
    return figure


def overview(run, methods, arm_points):
    """The loop in one picture: an arm following its path, and how far each method stays behind.

    Args:
      run: one run, with q of dims time, joint [rad] and x of dims time, axis [m].
      methods: all methods on that run: rms_error and evaluations of dims method, Ts; error_norm of method, time.
      arm_points: (K, n + 1, 2) base, joints and tip of the arm at K instants [m].
    """
    figure = plt.figure(figsize=(style.PAGE, 3.4))
    axes = figure.subplot_mosaic([["arm", "work"], ["error", "work"]], width_ratios=(1.45, 1), height_ratios=(1.15, 1))
    arm, error, work = axes["arm"], axes["error"], axes["work"]
    for i, points in enumerate(arm_points):
        shade = str(0.8 * (1 - i / (len(arm_points) - 1)) ** 0.8)
        arm.plot(*points.T, color=shade, lw=1.6, marker="o", ms=4, markerfacecolor="white", zorder=3 + i)
    tip = run.x.values
    length = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()
    seconds = float(run.time[-1] - run.time[0])
    rate, count = (run.sizes["time"] - 1) / seconds, run.sizes["joint"]
    arm.plot(tip[:, 0], tip[:, 1], color=style.VERMILION, lw=2.4, zorder=20, solid_capstyle="round")
    arm.plot(*arm_points[0, 0], marker="s", ms=7, color=style.BLACK, zorder=21)
    words = f"path of the tip: {length:.2g} m in {seconds:.2g} s"
    arm.annotate(words, tip[0], (0, -11), textcoords="offset points", ha="right", color=style.VERMILION)
    arm.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]", title=f"a {count}-joint arm follows a line")
    arm.margins(x=0.03, y=0.12)
    for i, method in enumerate(methods.method.values):
        at = methods.sel({"method": method})
        norm = at.error_norm.where(at.error_norm > _ROUNDING)
        error.semilogy(at.time, norm, **style.line(method, markevery=(i + 1, 7), markersize=2.6))
        work.loglog(at.evaluations, at.rms_error, **style.line(method))
    error.set(xlabel="time [s]", ylabel="$\\|e\\|$ [m]", title=f"its error at {rate:.3g} steps per second")
    work.set(xlabel="evaluations of $J$ and its inverse", ylabel="RMS $\\|e\\|$ [m]", title="what an error costs")
    for panel in (error, work):
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
        panel.yaxis.set_minor_locator(NullLocator())
    style.legend(figure, work)
    return figure
