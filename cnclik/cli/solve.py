"""`cnclik solve`: one loop on one robot, with its data, figures and a summary."""

import csv
import dataclasses
import math
import time
from pathlib import Path

import numpy as np

from cnclik.cli.problem import ProblemOptions, problem, table

PIECE = 2000  # steps between two looks at the clock


@dataclasses.dataclass(kw_only=True)
class Args(ProblemOptions):
    """Run one loop: trajectory.nc, figures and a summary."""

    out: Path = Path("solved")
    """Folder for trajectory and figures."""
    csv: bool = False
    """Also write trajectory.csv."""
    figures: bool = True
    """Draw joint paths, error, joint velocities and status."""


def run(args: Args) -> None:
    made = problem(args)
    from rich.console import Console

    from cnclik.show.output import output_folder

    config = {"verb": "solve", **{k: list(v) if isinstance(v, tuple) else v for k, v in table(args).items()}}
    progress = Console(stderr=True)
    with output_folder(args.out) as folder:
        trajectory, seconds = _march(made, progress)
        from cnclik.measure.dataset import to_dataset

        data = to_dataset(trajectory, made.law, config=config)
        data.to_netcdf(folder / "trajectory.nc", engine="h5netcdf")
        if args.csv:
            _write_csv(folder / "trajectory.csv", data)
        if args.figures:
            with progress.status("Drawing"):
                _draw(folder, data, made)
        written = sorted(p.name for p in folder.iterdir())
    print(_title(made))
    Console().print(_summary(made, data, seconds))
    print(f"Wrote {', '.join(written)} to {args.out}/.")


def _march(made, progress):
    """The whole trajectory, and the time per step once compiled; a bar where it takes a while."""
    import jax
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from cnclik.integrate.solve import solve

    size = min(made.N, PIECE)
    pieces = -(-made.N // size)  # the last one may run past N; what is beyond is cut off

    def piece(k, q):
        begin = time.perf_counter()
        t0 = k * size * made.Ts
        found = solve(made.law, made.reference, q, made.Ts, size, made.method, made.stage, t0=t0)
        return jax.block_until_ready(found), time.perf_counter() - begin

    with progress.status("Compiling"):
        first, _ = piece(0, made.q0)
    first, seconds = piece(0, made.q0)
    parts = [first]
    columns = (
        TextColumn("Solving"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} steps"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=progress, disable=pieces * seconds < 2, transient=True) as bar:
        task = bar.add_task("", total=made.N, completed=size)
        for k in range(1, pieces):
            part, more = piece(k, parts[-1].q[-1])
            parts.append(part)
            seconds += more
            bar.update(task, completed=min((k + 1) * size, made.N))
    from cnclik.integrate.trajectory import join, truncate

    return truncate(join(parts), made.N), seconds / (pieces * size)


def _write_csv(path, data) -> None:
    """One row per instant; what belongs to a step stands at its beginning."""
    joints, axes = data.joint.values, data.axis.values
    header = ["time", *(f"q_{j}" for j in joints), *(f"x_{a}" for a in axes), *(f"e_{a}" for a in axes)]
    header += [*(f"qdot_{j}" for j in joints), "status"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for k, t in enumerate(data.time.values):
            row = [t, *data.q.values[k], *data.x.values[k], *data.e.values[k]]
            last = k == data.sizes["step"]
            step = [""] * (len(joints) + 1) if last else [*data.qdot.values[k], int(data.status.values[k])]
            writer.writerow(
                [*(repr(float(v)) for v in row), *(v if isinstance(v, (str, int)) else repr(float(v)) for v in step)]
            )


def _draw(folder, data, made) -> None:
    from cnclik.show import run as pictures
    from cnclik.show import style

    with style.style():
        chain = made.law.chain
        drawn = {
            "joints": pictures.joint_paths(data, chain),
            "error": pictures.error(data),
            "velocities": pictures.joint_velocities(data, chain),
            "status": pictures.status(data),
        }
        for name, figure in drawn.items():
            style.save(
                figure, folder / f"{name}.png", {"Title": f"{made.name}: {name}", "Comment": data.attrs["config"]}
            )


def _summary(made, data, seconds):
    from rich.table import Table

    from cnclik.integrate.status import count
    from cnclik.measure.metrics import chatter
    from cnclik.stability.linear import stability_limit

    shown = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    units = data.axis_unit.values
    for unit, name in (("m", "position"), ("rad", "orientation")):
        part = data.e.values[:, units == unit]
        if part.size:
            norm = np.linalg.norm(part, axis=1)
            rms, largest, last = (_number(v) for v in (np.sqrt(np.mean(norm**2)), norm.max(), norm[-1]))
            shown.add_row(f"{name} error", f"RMS {rms}, largest {largest}, last {last} {unit}")
    shown.add_row("steps", ", ".join(f"{k} {v}" for k, v in count(data.status.values).items() if v))
    shown.add_row("joint velocity", _fastest(made.law.chain, data))
    late = chatter(data.qdot.values)
    shown.add_row("chatter", f"{_number(late)} (RMS joint speed taken back in the next step, second half of the run)")
    limit = stability_limit(made.method, made.stage)
    alpha = np.linalg.eigvals(made.law.alpha).real if made.law.alpha.ndim == 2 else np.atleast_1d(made.law.alpha)
    z = float(np.max(alpha)) * made.Ts
    where = "UNSTABLE" if z >= limit or np.min(alpha) < 0 else "stable" if np.min(alpha) > 0 else "errors stay"
    known = "any z" if math.isinf(limit) else f"z < {limit:.4g}"
    shown.add_row("z = alpha·Ts", f"{z:.4g}; {made.method} with {_stage(made)} is linearly stable for {known}: {where}")
    shown.add_row("time per step", f"{1e6 * seconds:.0f} µs")
    return shown


def _title(made):
    task = " ".join(made.law.task.names)
    return f"{made.name}: task {task}, N = {made.N} steps of Ts = {made.Ts:g} s"


def _stage(made):
    if not made.method.implicit:
        return "no stage"
    return f"{type(made.stage).__name__.lower()}({made.stage.M})"


def _fastest(chain, data) -> str:
    """The joint that comes nearest to (or farthest beyond) its velocity limit."""
    peak = np.max(np.abs(data.qdot.values), axis=0)
    limits = np.array(chain.velocity_limit)
    i = (
        int(np.argmax(np.where(np.isfinite(limits), peak / limits, 0.0)))
        if np.isfinite(limits).any()
        else int(np.argmax(peak))
    )
    unit = f"{data.joint_unit.values[i]}/s"
    if not np.isfinite(limits[i]):
        return f"{_number(peak[i])} {unit} at {chain.joint_names[i]}, which has no limit"
    share = f"{100 * peak[i] / limits[i]:.3g} % of its limit {limits[i]:g}"
    return f"{_number(peak[i])} {unit} at {chain.joint_names[i]}: {share}"


def _number(value) -> str:
    return f"{float(value):.4g}"
