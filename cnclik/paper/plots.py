"""Figures of runs: joint paths, errors, joint velocities; work, orders and passes. Each draws one dataset.

Datasets have the dimensions of `cnclik.measure.dataset.to_dataset` and `method` beside them.
"""

import hashlib

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

from cnclik.show import style

_ROUNDING = 1e-13  # [m, rad] what is smaller is left out of logarithmic axes


_NOTE = {"fontsize": 6.5, "color": "0.35"}


def fingerprint(data) -> str:
    """SHA-256 of a dataset's numbers and labels: what ties a figure to the data it was drawn from."""
    digest = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        values = data[name].values
        raw = values.tobytes() if values.dtype.kind in "fiub" else "\n".join(map(str, values.ravel())).encode()
        digest.update(f"{name} {data[name].dims} {values.shape}\n".encode() + raw)
    return digest.hexdigest()


# --- runs in time -------------------------------------------------------------------------------------


def joint_paths(run):
    """Joint values against time, one panel per joint (paper, Figs. 1, 4, 7, 10)."""
    figure, panels = _panels(run.sizes["joint"])
    for panel, joint in zip(panels, run.joint.values, strict=True):
        for i, method in enumerate(run.method.values):
            at = run.q.sel({"joint": joint, "method": method})
            panel.plot(run.time, at, **style.line(method, markevery=_every(i, run)))
        panel.set_ylabel(f"${_symbol(joint)}$ [{_unit(run, joint)}]")
    return _finish(figure, panels)


def errors(run):
    """Error per axis and its norm, the norm on a logarithmic scale (paper, Figs. 2, 5, 8, 11)."""
    figure, panels = _panels(run.sizes["axis"] + 1, height=1.1)
    for i, method in enumerate(run.method.values):
        look = style.line(method, markevery=_every(i, run))
        for panel, axis in zip(panels, run.axis.values, strict=False):
            panel.plot(run.time, run.e.sel({"axis": axis, "method": method}), **look)
        norm = run.error_norm.sel({"method": method})
        panels[-1].semilogy(run.time, norm.where(norm > _ROUNDING), **look)
    for panel, axis in zip(panels, run.axis.values, strict=False):
        panel.set_ylabel(f"$e_{axis}$ [m]")
        panel.ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
        panel.axhline(0, **style.GUIDE)
    panels[-1].set_ylabel("$\\|e\\|$ [m]")
    panels[-1].yaxis.set_minor_formatter(NullFormatter())
    return _finish(figure, panels)


def joint_velocities(run):
    """Joint velocities, held during each step, one panel per joint (paper, Figs. 3, 6, 9, 12)."""
    figure, panels = _panels(run.sizes["joint"])
    edges = run.time.values
    for panel, joint in zip(panels, run.joint.values, strict=True):
        for method in run.method.values:
            at = run.qdot.sel({"joint": joint, "method": method}).values
            look = style.line(method, marker="", linewidth=1.0)
            panel.stairs(
                at, edges, baseline=None, **{k: look[k] for k in ("label", "color", "linestyle", "linewidth", "zorder")}
            )
        panel.set_ylabel(f"$\\dot{{q}}_{{{_number(joint)}}}$ [{_unit(run, joint)}/s]")
    return _finish(figure, panels)


def _panels(count, height=0.82):
    figure, panels = plt.subplots(
        count, 1, sharex=True, figsize=(style.COLUMN, 0.62 + max(height, 1.9 / count) * count), squeeze=False
    )
    return figure, panels[:, 0]


def _finish(figure, panels):
    panels[-1].set_xlabel("time $t$ [s]")
    for panel in panels:
        panel.margins(x=0.02)
        if panel.get_yscale() == "linear":
            panel.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    figure.align_ylabels(panels)
    _legend(figure, panels[0])
    return figure


def _legend(figure, panel, columns=None):
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns or len(labels))


def _every(i, run):
    """Markers at every sixth sample, staggered, so that coinciding lines stay distinguishable."""
    return (2 * i, 6) if run.sizes["method"] <= 3 else (i, 7)


def _number(joint):
    return str(joint).lstrip("q") if str(joint).startswith("q") else str(joint)


def _symbol(joint):
    return f"q_{{{_number(joint)}}}"


def _unit(run, joint):
    return str(run.joint_unit.sel(joint=joint).item()) if "joint_unit" in run.coords else "rad"


# --- methods compared ---------------------------------------------------------------------------------


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
        column[0].set_title(f"{arm.replace('dof', '-dof')} arm")
        column[1].set_xlabel("evaluations of $f(q, t)$ in 3 s")
    grid[0, 0].set_ylabel("tracking: RMS $\\|e\\|$ [m]")
    grid[1, 0].set_ylabel("reaching: mean $\\|e\\|$ [m]")
    _legend(figure, grid[0, 0])
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
            panel.annotate(f"order {order}", (Ts[-1], guide[-1]), xytext=(0, 9), textcoords="offset points", **_NOTE)
        panel.set_title(f"{arm.replace('dof', '-dof')} arm, tracking")
        panel.set_xlabel("sampling time $T_s$ [s]")
        panel.set_xticks(Ts, [f"{t:g}" for t in Ts])
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.minorticks_off()
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
    panels[0].set_ylabel("RMS $\\|e\\|$ [m], stages converged")
    _legend(figure, panels[0])
    return figure


def passes(residual, *, chosen, settled):
    """Worst last change of the joint increment over a run's steps, pass by pass of the Picard iteration.

    Args:
      residual: dims arm, reading, case, method, pass, step [rad]; one line per case and reading.
      chosen: the number of passes the run itself took, marked.
      settled: what counts as converged [rad], marked.
    """
    figure, panels = plt.subplots(1, residual.sizes["arm"], sharey=True, figsize=(style.PAGE, 2.9))
    colors = dict(zip(residual.case.values, (style.BLUE, style.VERMILION), strict=False))
    dashes = dict(zip(residual.reading.values, ("-", (0, (4, 1.5))), strict=False))
    markers = dict(zip(residual.reading.values, ("o", "s"), strict=False))
    for panel, arm in zip(panels, residual.arm.values, strict=True):
        panel.axvline(chosen, **style.GUIDE)
        panel.axhline(settled, **style.GUIDE)
        for reading in residual.reading.values:
            for case in residual.case.values:
                worst = residual.sel({"arm": arm, "case": case, "reading": reading}).max(("step", "method"))
                worst = worst.where(worst > _ROUNDING)
                look = {"color": colors[case], "linestyle": dashes[reading], "marker": markers[reading]}
                label = f"{case}, Ts {reading.split('/')[1]}"
                panel.semilogy(worst["pass"], worst, label=label, markerfacecolor="white", lw=1, markevery=2, **look)
        panel.set_title(f"{arm.replace('dof', '-dof')} arm")
        panel.set_xlabel("passes")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        right = panel.get_xlim()[1]
        panel.annotate(f"M = {chosen}", (chosen, 1), xytext=(3, 0), textcoords="offset points", **_NOTE)
        panel.annotate("converged", (right, settled), (0, 2), textcoords="offset points", ha="right", **_NOTE)
    panels[0].set_ylabel("worst last change [rad]")
    _legend(figure, panels[0])
    return figure


def overview(run, methods, arm_points):
    """The loop in one picture: an arm following its path, and how far each method stays behind.

    Args:
      run: one run, with x of dims time, axis [m].
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
    arm.plot(tip[:, 0], tip[:, 1], color=style.VERMILION, lw=2.4, zorder=20, solid_capstyle="round")
    arm.plot(*arm_points[0, 0], marker="s", ms=7, color=style.BLACK, zorder=21)
    arm.annotate(
        "path of the tip: 1 m in 3 s",
        tip[0],
        (0, -11),
        textcoords="offset points",
        ha="right",
        color=style.VERMILION,
    )
    arm.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]", title="a 5-joint arm follows a line")
    arm.margins(x=0.03, y=0.12)
    for i, method in enumerate(methods.method.values):
        at = methods.sel({"method": method})
        norm = at.error_norm.where(at.error_norm > _ROUNDING)
        error.semilogy(at.time, norm, **style.line(method, markevery=(i + 1, 7), markersize=2.6))
        work.loglog(at.evaluations, at.rms_error, **style.line(method))
    error.set(xlabel="time [s]", ylabel="$\\|e\\|$ [m]", title="its error at 10 steps per second")
    work.set(xlabel="evaluations of $J$ and its inverse", ylabel="RMS $\\|e\\|$ [m]", title="what an error costs")
    for panel in (error, work):
        panel.yaxis.set_major_locator(LogLocator(numticks=12))
        panel.yaxis.set_minor_locator(NullLocator())
    _legend(figure, work)
    return figure
