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
_STEPS = [1, 2, 2.5, 5, 10]
_CASES = {"reach": "Case I, reaching a point", "track": "Case II, tracking a line"}


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
        panel.yaxis.set_major_locator(MaxNLocator(3, steps=_STEPS))
        panel.margins(x=0.01, y=0.12)
    return _over_time(figure, panels)


def errors(run):
    """Error per axis and its norm, the norm on a logarithmic scale, a line per method (paper, Figs. 2, 5, 8, 11)."""
    count = run.sizes["axis"] + 1
    figure, panels = plt.subplots(count, 1, sharex=True, figsize=(style.COLUMN, 0.62 + 1.1 * count))
    for i, method in enumerate(run.method.values):
        look, one = style.line(method, markevery=(2 * i, 6)), run.sel({"method": method})
        for panel, axis in zip(panels, run.axis.values, strict=False):
            panel.plot(run.time, one.e.sel({"axis": axis}), **look)
        panels[-1].semilogy(run.time, one.error_norm.where(one.error_norm > _ROUNDING), **look)
    for panel, axis, unit in zip(panels, run.axis.values, run.axis_unit.values, strict=False):
        panel.set_ylabel(f"$e_{axis}$ [{unit}]")
        panel.ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
        panel.yaxis.set_major_locator(MaxNLocator(4, steps=_STEPS))
        panel.axhline(0, **style.GUIDE)
    panels[-1].set_ylabel(f"$\\|e\\|$ [{run.error_norm.units}]")
    panels[-1].yaxis.set_minor_formatter(NullFormatter())
    return _over_time(figure, panels)


def _over_time(figure, panels):
    """Return a figure of panels over time with its time axis and one legend."""
    panels[-1].set_xlabel("time $t$ [s]")
    figure.align_ylabels(panels)
    style.legend(figure, panels[0])
    return figure


def work(methods):
    """Error against evaluations of f(q, t), all methods, both arms: tracking above, reaching below."""
    figure, grid = plt.subplots(2, len(ARMS), sharex=True, sharey="row", figsize=(style.PAGE, 4.3))
    for column, arm in zip(grid.T, ARMS, strict=True):
        for panel, case, quantity in zip(column, ("track", "reach"), ("rms_error", "mean_error"), strict=True):
            for method in methods.method.values:
                at = methods.sel({"arm": arm, "case": case, "method": method})
                panel.loglog(at.evaluations, at[quantity], **style.line(method))
        column[1].set_yscale("linear")  # within a factor of two: a logarithmic axis would show nothing
        column[0].set_title(f"{ARMS[arm]} arm")
        column[1].set_xlabel("evaluations of $f(q, t)$ in 3 s")
    grid[0, 0].set_ylabel("tracking: RMS $\\|e\\|$ [m]")
    grid[1, 0].set_ylabel("reaching: mean $\\|e\\|$ [m]")
    style.legend(figure, grid[0, 0])
    return figure


def orders(methods):
    """RMS tracking error against the sampling time, implicit stages converged, with slopes to compare."""
    figure, panels = plt.subplots(1, len(ARMS), sharey=True, figsize=(style.PAGE, 2.9))
    Ts = methods.Ts.values
    for panel, arm in zip(panels, ARMS, strict=True):
        rms = methods.rms_converged.sel(arm=arm)
        for method in methods.method.values:
            panel.loglog(Ts, rms.sel({"method": method}), **style.line(method))
        for order, anchor in ((1, "EE"), (2, "CN"), (4, "RK4")):
            guide = 2.2 * float(rms.sel({"method": anchor, "Ts": Ts[0]})) * (Ts / Ts[0]) ** order
            panel.loglog(Ts, guide, **style.GUIDE)
            panel.annotate(f"order {order}", (Ts[-1], guide[-1]), (0, 9), textcoords="offset points", **style.NOTE)
        panel.set_title(f"{ARMS[arm]} arm, tracking")
        panel.set_xlabel("sampling time $T_s$ [s]")
        panel.set_xticks(Ts, [f"{t:g}" for t in Ts])
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.minorticks_off()
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
    panels[0].set_ylabel("RMS $\\|e\\|$ [m], stages converged")
    style.legend(figure, panels[0])
    return figure


def picard(data):
    """Worst last change of the joint increment over a run's steps, pass by pass; a line per case and reading."""
    figure, panels = plt.subplots(1, len(ARMS), sharey=True, figsize=(style.PAGE, 2.9))
    looks = [{"linestyle": "-", "marker": "o"}, {"linestyle": (0, (4, 1.5)), "marker": "s"}]
    for panel, arm in zip(panels, ARMS, strict=True):
        panel.axvline(paper.M, **style.GUIDE)
        panel.axhline(claims.SETTLED, **style.GUIDE)
        for reading, look in zip(data.reading.values, looks, strict=True):
            for case, color, face in zip(data.case.values, style.COLORS, ("white", style.VERMILION), strict=False):
                worst = data.residual.sel({"arm": arm, "case": case, "reading": reading}).max(("step", "method"))
                look |= {"color": color, "label": f"{case}, Ts {reading.split('/')[1]}"}
                worst = worst.where(worst > _ROUNDING)
                panel.semilogy(worst["pass"], worst, markerfacecolor=face, lw=1, markevery=2, **look)
        panel.set_title(f"{ARMS[arm]} arm")
        panel.set_xlabel("passes")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        note, right = {"textcoords": "offset points"} | style.NOTE, panel.get_xlim()[1]
        panel.annotate(f"M = {paper.M}", (paper.M, 1), (3, 0), **note)
        panel.annotate("converged", (right, claims.SETTLED), (0, 2), ha="right", **note)
    panels[0].set_ylabel("worst last change [rad]")
    style.legend(figure, panels[0])
    return figure


def overview(run, methods):
    """The loop in one picture: an arm following its path (q, x), and how far each method stays behind."""
    figure = plt.figure(figsize=(style.PAGE, 3.4))
    axes = figure.subplot_mosaic([["arm", "work"], ["error", "work"]], width_ratios=(1.45, 1), height_ratios=(1.15, 1))
    arm, error, work = axes["arm"], axes["error"], axes["work"]
    instants = np.linspace(0, paper.N, 7).astype(int)
    for i, q in enumerate(run.q.values[instants]):
        # Base, joints and tip: links of 1 m that turn clockwise from +y.
        points = np.zeros((2, len(q) + 1))
        points[:, 1:] = np.cumsum([np.sin(np.cumsum(q)), np.cos(np.cumsum(q))], axis=1)
        shade = str(0.8 * (1 - i / (len(instants) - 1)) ** 0.8)
        arm.plot(*points, color=shade, lw=1.6, marker="o", ms=4, markerfacecolor="white", zorder=3 + i)
    tip, seconds = run.x.values, paper.N * paper.TS
    length = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()
    arm.plot(tip[:, 0], tip[:, 1], color=style.VERMILION, lw=2.4, zorder=20, solid_capstyle="round")
    arm.plot(0, 0, marker="s", ms=7, color=style.BLACK, zorder=21)
    words = f"path of the tip: {length:.2g} m in {seconds:.2g} s"
    arm.annotate(words, tip[0], (0, -11), textcoords="offset points", ha="right", color=style.VERMILION)
    arm.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]", title=f"a {len(q)}-joint arm follows a line")
    arm.margins(x=0.03, y=0.12)
    for i, method in enumerate(methods.method.values):
        at = methods.sel({"method": method})
        norm = at.error_norm.where(at.error_norm > _ROUNDING)
        error.semilogy(at.time, norm, **style.line(method, markevery=(i + 1, 7), markersize=2.6))
        work.loglog(at.evaluations, at.rms_error, **style.line(method))
    error.set(xlabel="time [s]", ylabel="$\\|e\\|$ [m]", title=f"its error at {1 / paper.TS:.3g} steps per second")
    work.set(xlabel="evaluations of $J$ and its inverse", ylabel="RMS $\\|e\\|$ [m]", title="what an error costs")
    for panel in (error, work):
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
        panel.yaxis.set_minor_locator(NullLocator())
    style.legend(figure, work)
    return figure


def figures(trajectories: xr.Dataset, methods: xr.Dataset, passes: xr.Dataset) -> dict:
    """Return {file name: (function that draws it, the description in the file)} for `cnclik.show.output.draw`."""
    made, runs = {}, trajectories.sel(reading=str(DEFAULT))

    def add(name, caption, data, make, *args, **options):
        about = {"Title": caption, "Config": data.attrs["config"]}
        made[f"{name}.png"] = functools.partial(make, data, *args, **options), about

    for arm, size in ARMS.items():
        for case, what in _CASES.items():
            run = runs.sel(arm=arm, case=case, joint=[f"q{i + 1}" for i in range(size.n)])
            about, first = f"{size} arm, {what}", len(made) + 1
            add(f"fig{first:02d}", f"{about}: joint paths", run, joints, "q")
            add(f"fig{first + 1:02d}", f"{about}: error of the end effector: x, y, and norm", run, errors)
            add(f"fig{first + 2:02d}", f"{about}: joint velocities", run, joints, "qdot")
    followed = passes.sel(reading=[f"on-path/{Ts}/consistent" for Ts in ("once", "twice")]).isel({"pass": slice(0, 31)})
    add("fig13", "Error against evaluations, all methods", methods, work)
    add("fig14", "Observed orders, stages converged", methods, orders)
    add("fig15", "Convergence of the Picard iteration, Ts once and twice", followed, picard)
    where = {"arm": "5dof", "case": "track"}
    run = runs.sel({**where, "method": "CN"})
    add("overview", "An arm following a line, and the error of each method", run, overview, methods.sel(where))
    return made
