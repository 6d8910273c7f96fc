"""`cnclik solve`: one loop on one robot, with its data, figures, a summary and a verdict."""

import functools
import itertools
from pathlib import Path

from cnclik.cli import progress
from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import numbers, print_json, print_table, problem
from cnclik.quantities import aloud, plainly
from cnclik.show.output import draw, load_ahead
from cnclik.writing import output_folder

TAKES = PROBLEM
_FIGURES = ("overview", "tip")


def run(
    robot: str,
    *,
    out: str = "solved",
    csv: bool = False,
    figures: bool = True,
    json: bool = False,
    overwrite: bool = False,
    **loop,
) -> None:
    """Run one loop. Writes trajectory.nc and figures; prints a summary, and in one sentence what the loop did.

    Args:
      out: folder for trajectory and figures.
      csv: also write trajectory.csv.
      figures: draw joint values, error, joint velocities, status and the path of the tip.
      json: print the answer as JSON: what was asked, the numbers, and the verdict with its remedy.
    """
    made = problem(robot, loop)
    load_ahead("h5netcdf", *["xarray", "cnclik.show.style"] * figures)
    files, pictures = ["trajectory.nc", *["trajectory.csv"] * csv], [f"{kind}.png" for kind in _FIGURES]
    names = dict(files=[*files, *pictures * figures], replaces=["trajectory.csv", *pictures])
    with output_folder(Path(out), overwrite=overwrite, **names) as folder:
        with progress.bar("steps"):
            trajectory = made.run()
        _answer(made, trajectory, out if json else None)
        from cnclik.measure.dataset import labelled
        from cnclik.measure.files import save_csv, save_labelled

        data = labelled(trajectory, made.law, config={"verb": "solve", "robot": robot} | numbers(loop))
        folder.write("trajectory.nc", functools.partial(save_labelled, data))
        if csv:
            folder.write("trajectory.csv", functools.partial(save_csv, list(_rows(data))))
    with progress.bar("figures") as report:
        written = folder.made + draw(_figures(data, made) if figures else {}, out, progress=report, overwrite=overwrite)
    if not json:
        print(f"Wrote {', '.join(sorted(written))} to {out}/.")


def _answer(made, trajectory, out) -> None:
    """Print what was asked, the verdict and the numbers, as JSON where `out` is a folder."""
    from cnclik.integrate.drive import Drive
    from cnclik.measure.files import plain
    from cnclik.problem import heading
    from cnclik.stability.ending import verdict

    with progress.bar("verdict"):
        loop = dict(method=made.method, stage=made.stage, drive=made.drive or Drive())
        judged = verdict(made.law, made.reference, trajectory, **loop, noise=made.noise)
    title = heading.robot_and_task(made.name, made.tip, made.law.task)
    title += f", N = {made.N} steps of Ts = {1e3 * made.Ts:g} ms"
    asked = [title, heading.loop_in_words(made), *heading.start_and_target(made)]
    answer, facts = f"{judged.sentence[0].upper()}{judged.sentence[1:]}", _summary(made, trajectory)
    if out is not None:
        verdict_ = plain(judged) | {"sentence": answer}
        print_json({"asked": asked, "facts": dict(facts), "verdict": verdict_, "out": out})
        return
    print("\n".join([*asked, answer]))
    print_table(facts, box=None, padding=(0, 2, 0, 0))


_COLUMNS = {  # of trajectory.csv: {variable of the dataset: (prefix of the names, dimension)}
    **{"time": ("time", None), "q": ("q_", "joint"), "x": ("x_", "axis"), "e": ("e_", "axis")},
    **{"qdot": ("qdot_", "joint"), "status": ("status", None), "task_status": ("status_", "task")},
    "walls": ("wall_", "wall"),
}


def _rows(data):
    """One row per instant; the values of a step are in the row of its beginning."""
    names, columns, arrays = [], [], data.variables | data.coords
    for variable, (prefix, dimension) in _COLUMNS.items():
        if variable in arrays:
            labels, values = [""] if dimension is None else arrays[dimension][1], arrays[variable][1]
            names += [f"{prefix}{label}" for label in labels]
            columns += values.reshape(len(values), -1).T.tolist()
    yield names
    yield from itertools.zip_longest(*columns, fillvalue="")


def _figures(data, made) -> dict:
    import xarray as xr

    from cnclik.show import run as pictures

    return {
        f"{kind}.png": (
            functools.partial(pictures.KINDS[kind], xr.Dataset(*data), made.law.chain),
            {"Title": f"{made.name}: {kind}", "Comment": data.attrs["config"]},
        )
        for kind in _FIGURES
    }


def _summary(made, trajectory):
    """((name, text), …): numbers of the run, with their units."""
    import numpy as np

    from cnclik.integrate.status import counted
    from cnclik.measure.metrics import measure_run

    law = made.law
    found = measure_run(trajectory, law, made.reference, ["chatter"])
    if law.task.tasks:
        each = [(f"{name} ", trajectory[name], law.task.alone(name)) for name, _ in law.task.tasks]
    else:
        each = [("", trajectory, law.task)]
    rows = [row for one in each for row in task_rows(*one)]
    rows += [] if trajectory.walls is None else _of_walls(trajectory, law)
    rows.append(("steps", counted(trajectory.status)))
    rows.append(("joint velocity", fastest(law.chain, np.asarray(trajectory.qdot, float))))
    what = "RMS joint velocity that reverses from one step to the next, second half of the run"
    rows.append(("chatter", f"{aloud(float(found.chatter), found.units['chatter'])} ({what})"))
    return rows


def fastest(chain, qdot):
    """The fastest joint, and the one with the largest share of its limit, in words."""
    import numpy as np

    most, limit = np.abs(qdot).max(axis=0), np.array(chain.velocity_limit, float)
    most = np.where(np.isnan(most), np.inf, most)
    limited = np.isfinite(limit)
    share = np.divide(most, np.maximum(limit, 1e-12), out=np.zeros_like(most), where=limited)
    i, k = int(np.argmax(most)), int(np.argmax(share))
    fast = f"up to {plainly(most[i])} {chain.units[i]}/s ({chain.joint_names[i]})"
    if not limited.any():
        return f"{fast}, no limits"
    part = f"{100 * share[k]:.3g} % of its limit" if share[k] < 10 else f"{plainly(share[k])} times its limit"
    return f"{fast}, {part}" if i == k else f"{fast}; {chain.joint_names[k]} up to {part}"


def task_rows(name, run, task):
    """Rows with the errors of a task and, in a stack, the number of steps with each status of the task."""
    import numpy as np

    from cnclik.integrate.status import OWN, counted

    kinds = ("position", "orientation")
    if hasattr(task.parts[0], "wanted"):
        kinds = ("prismatic joint", "revolute joint") if task.lengths and task.angles else ("joint", "joint")
    for part, unit, some in zip(kinds, ("m", "rad"), (task.lengths, task.angles), strict=True):
        if some:
            size = np.linalg.norm(np.asarray(run.e, float)[:, some], axis=1)
            size = np.where(np.isfinite(size), size, np.inf)
            rms, largest, last = (aloud(float(v), unit) for v in (np.sqrt(np.mean(size**2)), size.max(), size[-1]))
            yield f"{name}{part} error", f"RMS {rms}, largest {largest}, last {last}"
    if name:
        yield f"{name}steps", counted(np.asarray(run.status) & OWN)


def _of_walls(run, law):
    """Rows with the number of steps in which each wall is active, and how near the robot came or how far it passed."""
    import numpy as np

    from cnclik.integrate.status import rounding_of
    from cnclik.law.walls import wall_distance, wall_margin

    walls, q = law.limits.walls, np.asarray(run.q, float)
    room, most = np.asarray(run.walls), rounding_of(np.asarray(run.qdot))
    away, margin = wall_distance(law, q), wall_margin(law, run)
    for i, wall in enumerate(walls):
        unit, missed = wall.task.units[0], int(np.sum(room[:, i : i + 1] < -most))
        said = f"active in {int(np.sum(room[:, i : i + 1] <= most))} of {len(room)} steps"
        first, least = away[0, i], away[:, i].min()
        said += f", starts {aloud(-first, unit)} behind it" if first < 0 else ""
        said += f", nearest {aloud(least, unit)}" if least >= 0 else ""
        said += f", passed by up to {aloud(-least, unit)}" if least < min(first, 0.0) else ""
        said += f"; a step may pass it by {aloud(margin[i], unit)}" if margin[i] >= 1e-9 else ""
        said += f"; not kept in {missed} steps, by up to {aloud(-room[:, i].min(), f'{unit}/s')}" if missed else ""
        yield f"wall {wall.name}", said
