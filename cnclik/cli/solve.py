"""`cnclik solve`: one loop on one robot, with its data, figures, a summary and a verdict."""

import functools
from pathlib import Path

from cnclik.cli import progress
from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import print_json, print_table, problem
from cnclik.problem.options import in_own_units
from cnclik.quantities import aloud, plainly
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.writing import output_folder

TAKES = PROBLEM
_FIGURES = ("overview", "tip")


def run(
    robot: str,
    *,
    out: str = "solved",
    figures: bool = True,
    json: bool = False,
    overwrite: bool = False,
    **loop,
) -> None:
    """Run one loop. Writes trajectory.nc and figures; prints a summary, and in one sentence what the loop did.

    Args:
      out: folder for trajectory and figures.
      figures: draw joint values, error, joint velocities, status and the path of the tip.
      json: print the answer as JSON: what was asked, the numbers, and the verdict with its remedy.
    """
    made = problem(robot, loop)
    load_ahead("h5netcdf", *["xarray", "cnclik.show.style"] * figures)
    pictures = [f"{kind}.png" for kind in _FIGURES]
    with output_folder(Path(out), overwrite=overwrite, files=["trajectory.nc", *pictures * figures]) as folder:
        trajectory = made.run()
        from cnclik.measure.dataset import labelled
        from cnclik.measure.files import save_netcdf

        data = labelled(trajectory, made.law, config={"verb": "solve", "robot": robot} | in_own_units(loop, made.Ts))
        try:  # before a reader of the answer may leave
            folder.write("trajectory.nc", functools.partial(save_netcdf, data))
        finally:  # on a full disk, too
            _answer(made, trajectory, out if json else None)
    about = {"Title": made.name, "Comment": data[2]["config"]}
    drawn = {f"{kind}.png": (drawn_by("run", "plot", trajectory, made.law, kind), about) for kind in _FIGURES}
    with progress.bar("figures") as report:
        written = ["trajectory.nc", *draw(drawn if figures else {}, out, progress=report, overwrite=overwrite)]
    if not json:
        print(f"Wrote {', '.join(sorted(written))} to {out}/.")


def _answer(made, trajectory, out) -> None:
    """Print what was asked, the verdict and the numbers, as JSON where `out` is a folder."""
    from cnclik.integrate.drive import Drive
    from cnclik.measure.files import plain
    from cnclik.stability.ending import verdict

    loop = dict(method=made.method, stage=made.stage, drive=made.drive or Drive())
    judged = verdict(made.law, made.reference, trajectory, **loop, noise=made.noise)
    answer, facts = f"{judged.sentence[0].upper()}{judged.sentence[1:]}", _facts(made.law, trajectory)
    if out is not None:
        judged = plain(judged) | {"sentence": answer}
        print_json({"asked": str(made).splitlines(), "facts": facts, "verdict": judged, "out": out})
        return
    print(made, answer, sep="\n")
    print_table(*facts.items(), left=2)


def _facts(law, run) -> dict:
    """Numbers of the run, with their units: {what: text}."""
    import numpy as np

    from cnclik.integrate.status import counted

    facts = {}
    for name in [name for name, _ in law.task.tasks] or [""]:
        of, task = (run[name], law.task.alone(name)) if name else (run, law.task)
        for unit, some in (("m", task.lengths), ("rad", task.angles)):
            if some:
                size = np.nan_to_num(np.linalg.norm(np.asarray(of.e, float)[:, some], axis=1), nan=np.inf)
                rms, largest, last = (aloud(float(v), unit) for v in (np.sqrt(np.mean(size**2)), size.max(), size[-1]))
                facts[f"{name} error [{unit}]".strip()] = f"RMS {rms}, largest {largest}, last {last}"
    most = np.nan_to_num(np.abs(np.asarray(run.qdot, float)).max(axis=0), nan=np.inf)
    limits = np.maximum(np.array(law.chain.velocity_limit, float), 1e-12)
    share = np.divide(most, limits, where=np.isfinite(limits), out=np.full_like(most, -1.0))  # −1 without a limit
    (i, k), names = (int(np.argmax(of)) for of in (most, share)), law.chain.joint_names
    whose = "its limit" if i == k else f"the limit of {names[k]}"
    limit = f"{plainly(100 * share[k])} % of {whose}" if share[k] >= 0 else "no limits"
    fast = f"up to {plainly(most[i])} {law.chain.units[i]}/s ({names[i]}), {limit}"
    return facts | {"steps": counted(run.status), "joint velocity": fast}
