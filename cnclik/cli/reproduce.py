"""`cnclik reproduce`: the paper's experiments, from the first step to the figures."""

import json
from dataclasses import dataclass
from pathlib import Path

from cnclik.paper import readings as paper


@dataclass(frozen=True, kw_only=True)
class Args:
    """Run the experiments of Drexler (2016), Section V, under all eight readings of its text."""

    out: Path = Path("results/paper")
    """Folder for figures, data, claims.json and claims.md."""

    reading: str = str(paper.DEFAULT)
    """What figures 1 to 12 show: on-path or printed / once or twice / consistent or printed."""


def run(args: Args) -> None:
    reading = str(paper.reading(args.reading))
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from cnclik.show.output import output_folder

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with output_folder(args.out) as folder, Progress(*columns, console=Console(stderr=True)) as progress:
        from cnclik.paper import claims
        from cnclik.paper import data as paper_data

        found = paper_data.everything(lambda arms: progress.track(arms, description="Running both arms "))
        judged = claims.judge(found.trajectories, found.passes)
        captions = _write(folder, found, judged, reading, lambda names: progress.track(names, description="Drawing"))
    _tell(Console(), found, judged)
    print(f"Wrote {len(captions)} figures, data and claims to {args.out}/; read {args.out / 'claims.md'} first.")


def _write(folder, found, judged, reading, track) -> dict:
    from cnclik.paper import figures as pictures
    from cnclik.paper import story as report

    drawn = pictures.figures(*found, reading)
    pictures.draw(drawn, folder, track)
    captions = {name: caption for name, (caption, *_) in drawn.items()}
    for name, data in found._asdict().items():
        packed = {v: {"zlib": True, "complevel": 6} for v in data.variables if data[v].dtype.kind in "fi"}
        data.to_netcdf(folder / f"{name}.nc", engine="h5netcdf", encoding=packed)
    # allow_nan: a claim that rests on a NaN must not pass as JSON.
    (folder / "claims.json").write_text(json.dumps(judged, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    text = report.story(judged, found.trajectories, found.methods, reading, captions)
    (folder / "claims.md").write_text(text, encoding="utf-8")
    return captions


def _tell(console, found, judged) -> None:
    from cnclik.paper import claims
    from cnclik.paper import story as report

    report.show(report.claim_table(judged, claims.undetermined(found.trajectories)), console)
    report.show(report.method_table(found.methods), console)
    report.show(report.picard_table(judged), console)
    console.print("* decided by rounding: starts 1e-12 rad apart give other digits.\n")
