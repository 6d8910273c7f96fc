"""Drexler (2016): its experiments under every reading of its text, its claims, its figures.

run = paper.experiment("5dof", "track", "CN")     # one of its runs
found = paper.reproduce("reproduced")             # all of them, with data, claims and figures in a folder
"""

import lazy_loader

from cnclik.paper import choices
from cnclik.paper.choices import DEFAULT, READINGS, reading

__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={"claims": ["judge"], "readings": ["experiment"]})
__all__ = ["DEFAULT", "READINGS", "experiment", "judge", "reading", "reproduce"]


def reproduce(out=None, *, reading=str(DEFAULT), progress=None, overwrite=False):
    """All experiments of Section V under all eight readings of its text, in float64; half a minute, mostly to compile.

    Args:
      out: folder for data, claims.json, claims.md and, after them, figures; None: nothing is written.
      reading: what figures 1 to 12 show.
      progress: called as progress(done, total, note).
      overwrite: write also into a folder of others.

    Returns: datasets `trajectories`, `methods` and `passes`; `judge` makes claims of the first and the last.
    Raises: ArgumentError for an unknown reading or an unusable folder; FigureError where figures could not be drawn,
      with data and claims in place.
    """
    from cnclik.paper.data import Results, everything

    shown = str(choices.reading(reading))
    if out is None:
        return everything(progress)
    from cnclik.show.output import draw
    from cnclik.writing import output_folder

    files = [*(f"{name}.nc" for name in Results._fields), "claims.json", "claims.md", *choices.FIGURES]
    with output_folder(out, overwrite=overwrite, files=files) as folder:
        found = everything(progress)
        judged = _write(folder, found)
        from cnclik.paper import figures, tables  # by now the data are safe

        pictures = figures.figures(*found, shown)
        captions = {name: about.get("Title", "") for name, (_, about) in pictures.items()}
        folder.write_text("claims.md", tables.page(judged, found, shown, captions))
    draw(pictures, out, progress=progress, overwrite=overwrite)
    return found


def _write(folder, found):
    """Write the data and the claims; returns these."""
    import functools
    import json

    from cnclik.measure.files import save_netcdf
    from cnclik.paper.claims import judge

    for name, data in found._asdict().items():
        folder.write(f"{name}.nc", functools.partial(save_netcdf, data))
    judged = judge(found.trajectories, found.passes)
    # allow_nan: a claim that rests on a NaN must not pass as JSON.
    folder.write_text("claims.json", json.dumps(judged, indent=1, allow_nan=False) + "\n")
    return judged
