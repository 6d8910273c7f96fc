"""Figures of the paper's experiments, and which of them `reproduce` draws: the paper's twelve, then ours."""

import functools

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

from cnclik.paper import claims
from cnclik.paper import readings as paper
from cnclik.paper.readings import ARMS, DEFAULT
from cnclik.show import style

_ROUNDING = 1e-13  # [m, rad] what is smaller is left out of logarithmic axes


def joints(run, name):
    """Joint paths (name "q") or velocities ("qdot"), a panel for each joint, a line per method (Figs. 1, 3 …)."""
    n, label = run.sizes["joint"], {"q": "$q$ [rad]", "qdot": r"$\dot q$ [rad/s]"}[name]
    figure, panels = plt.subplots(n, 1, sharex=True, figsize=(style.COLUMN, 0.5 + 0.95 * n))
    for i, panel in enumerate(panels):
        for k, method in enumerate(run.method.values):
            values, look = run[name].sel({"method": method}).values[:, i], style.line(method, markevery=(2 * k, 6))
            if name == "q":
                panel.plot(run.time, values, **look)
            else:
                plain = {key: value for key, value in look.items() if not key.startswith("mark")}
                panel.stairs(values, run.time.values, baseline=None, **plain | {"linewidth": 1.0})
        panel.set_title(str(run.joint.values[i]), loc="left", pad=2)
        panel.set_ylabel(label)
        panel.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
        panel.margins(x=0.01, y=0.12)
    return _finish(figure, panels)


def _finish(figure, panels):
    """Return a figure of panels over time with its time axis and one legend."""
    panels[-1].set_xlabel("time $t$ [s]")
    figure.align_ylabels(panels)
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
    return _finish(figure, panels)


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


def picard(residual):
    """Worst last change of the joint increment over a run's steps, pass by pass of the Picard iteration.

    Args:
      residual: dims arm, reading, case, method, pass, step [rad]; one line per case and reading.
    """
    figure, panels = plt.subplots(1, residual.sizes["arm"], sharey=True, figsize=(style.PAGE, 2.9))
    looks = [{"linestyle": "-", "marker": "o"}, {"linestyle": (0, (4, 1.5)), "marker": "s"}]
    for panel, arm in zip(panels, residual.arm.values, strict=True):
        panel.axvline(paper.M, **style.GUIDE)
        panel.axhline(claims.SETTLED, **style.GUIDE)
        for reading, look in zip(residual.reading.values, looks, strict=True):
            for case, color, face in zip(residual.case.values, style.COLORS, ("white", style.VERMILION), strict=False):
                worst = residual.sel({"arm": arm, "case": case, "reading": reading}).max(("step", "method"))
                look |= {"color": color, "label": f"{case}, Ts {reading.split('/')[1]}"}
                worst = worst.where(worst > _ROUNDING)
                panel.semilogy(worst["pass"], worst, markerfacecolor=face, lw=1, markevery=2, **look)
        panel.set_title(f"{ARMS[str(arm)]} arm")
        panel.set_xlabel("passes")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        note, right = {"textcoords": "offset points"} | style.NOTE, panel.get_xlim()[1]
        panel.annotate(f"M = {paper.M}", (paper.M, 1), (3, 0), **note)
        panel.annotate("converged", (right, claims.SETTLED), (0, 2), ha="right", **note)
    panels[0].set_ylabel("worst last change [rad]")
    style.legend(figure, panels[0])
    return figure


def overview(data):
    """The loop in one picture: an arm following its path, and how far each method stays behind.

    Args:
      data: of one run q [rad] and x [m] of dims time, joint and time, axis; of all methods on that run rms_error and
        evaluations of dims method, Ts, and error_norm of method, time.
    """
    figure = plt.figure(figsize=(style.PAGE, 3.4))
    axes = figure.subplot_mosaic([["arm", "work"], ["error", "work"]], width_ratios=(1.45, 1), height_ratios=(1.15, 1))
    arm, error, work = axes["arm"], axes["error"], axes["work"]
    instants = np.linspace(0, paper.N, 7).astype(int)
    for i, q in enumerate(data.q.values[instants]):
        # Base, joints and tip: links of 1 m that turn clockwise from +y.
        points = np.zeros((2, len(q) + 1))
        points[:, 1:] = np.cumsum([np.sin(np.cumsum(q)), np.cos(np.cumsum(q))], axis=1)
        shade = str(0.8 * (1 - i / (len(instants) - 1)) ** 0.8)
        arm.plot(*points, color=shade, lw=1.6, marker="o", ms=4, markerfacecolor="white", zorder=3 + i)
    tip = data.x.values
    length = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()
    seconds = float(data.time[-1] - data.time[0])
    arm.plot(tip[:, 0], tip[:, 1], color=style.VERMILION, lw=2.4, zorder=20, solid_capstyle="round")
    arm.plot(0, 0, marker="s", ms=7, color=style.BLACK, zorder=21)
    words = f"path of the tip: {length:.2g} m in {seconds:.2g} s"
    arm.annotate(words, tip[0], (0, -11), textcoords="offset points", ha="right", color=style.VERMILION)
    arm.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]", title=f"a {len(q)}-joint arm follows a line")
    arm.margins(x=0.03, y=0.12)
    for i, method in enumerate(data.method.values):
        at = data.sel({"method": method})
        norm = at.error_norm.where(at.error_norm > _ROUNDING)
        error.semilogy(at.time, norm, **style.line(method, markevery=(i + 1, 7), markersize=2.6))
        work.loglog(at.evaluations, at.rms_error, **style.line(method))
    rate = (data.sizes["time"] - 1) / seconds
    error.set(xlabel="time [s]", ylabel="$\\|e\\|$ [m]", title=f"its error at {rate:.3g} steps per second")
    work.set(xlabel="evaluations of $J$ and its inverse", ylabel="RMS $\\|e\\|$ [m]", title="what an error costs")
    for panel in (error, work):
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
        panel.yaxis.set_minor_locator(NullLocator())
    style.legend(figure, work)
    return figure


# --- all of them --------------------------------------------------------------------------------------

_CASES = {"reach": "Case I, reaching a point", "track": "Case II, tracking a line"}
_KINDS = {
    "joint paths": functools.partial(joints, name="q"),
    "error of the end effector: x, y, and norm": errors,
    "joint velocities": functools.partial(joints, name="qdot"),
}
PICARD_READINGS = ("on-path/once/consistent", "on-path/twice/consistent")


def figures(trajectories: xr.Dataset, methods: xr.Dataset, passes: xr.Dataset, reading: str) -> dict:
    """Return {file name: (function that draws it, the description in the file)} for `cnclik.show.output.draw`."""
    made = {}

    def add(name, caption, data, make):
        made[f"{name}.png"] = functools.partial(make, data), {"Title": caption, "Config": data.attrs["config"]}

    for arm, size in ARMS.items():
        for case, what in _CASES.items():
            run = trajectories.sel(arm=arm, case=case, reading=reading).sel(joint=[f"q{i + 1}" for i in range(size.n)])
            for kind, make in _KINDS.items():
                add(f"fig{len(made) + 1:02d}", f"{size} arm, {what}: {kind}", run, make)
    followed = passes[["residual"]].sel(reading=list(PICARD_READINGS)).isel({"pass": slice(0, 31)})
    add("fig13", "Error against evaluations, all methods", methods, work)
    add("fig14", "Observed orders, stages converged", methods, orders)
    caption = "Convergence of the Picard iteration, Ts once and twice"
    add("fig15", caption, followed, lambda data: picard(data.residual))
    where = {"arm": "5dof", "case": "track"}
    run = trajectories[["q", "x"]].sel({**where, "reading": str(DEFAULT), "method": "CN"}, drop=True)
    compared = methods[["rms_error", "evaluations", "error_norm"]].sel(where, drop=True)
    both = xr.merge([run, compared], combine_attrs="override", join="exact")
    add("overview", "An arm following a line, and the error of each method", both, overview)
    return made
