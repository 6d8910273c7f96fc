"""`cnclik diagnose`: whether the loop behind a log shakes, why, and the gain that stops it; or its drive."""

import dataclasses
import pathlib
import re
from typing import Literal

from cnclik import errors
from cnclik.cli.common import print_json
from cnclik.cli.log import read, sampled
from cnclik.show.output import draw, drawn_by
from cnclik.writing import output_folder

TAKES = ("log",)


def run(
    log: str,
    *,
    alpha: float | None = None,
    tasks: tuple[str, ...] = (),
    step: bool = False,
    command: Literal["position", "velocity"] = "position",
    out: str | None = None,
    json: bool = False,
    overwrite: bool = False,
    **columns,
) -> None:
    """Print the answer, and draw it.

    Args:
      alpha: gain of the loop [1/s], positive. With it the answer is surer; without it the gain that stops it comes with
        a factor.
      tasks: for a stack, NAME=ALPHA or NAME: the tasks whose errors are in columns NAME.x, NAME.y, ..., with their
        gains where known.
      step: fit a drive to recorded commands and motion: to joint_1_cmd and joint_1_pos, or to the two columns.
      command: with --step: what the commands are.
      out: folder for the figure diagnose.png.
    """
    for name, given in {"step": step, "columns": "columns" in columns, "alpha": alpha}.items() if tasks else ():
        if given:
            instead = "; gains are given as --tasks hands=20" * (name == "alpha")
            raise errors.fail(name, f"be left out with --tasks{instead}", "is given")
    if step and alpha is not None:
        raise errors.fail("alpha", "be left out with --step", "is given")
    found = read(log, **columns)
    Ts = sampled(found)
    if out is not None:
        with output_folder(pathlib.Path(out), overwrite=overwrite, files=["diagnose.png"]):
            pass  # it takes the figure
    each = {} if step else _tasks(found, tasks)
    with errors.called("signal", "LOG"):
        if step:
            fields, text, figure = _step(found, Ts, command)
        else:
            fields, text, figure = _stack(found, Ts, each) if each else _diagnose(found, Ts, alpha)
    if json:
        print_json(fields | {"Ts": Ts, "Ts_from": found.stamps})
    else:
        print(text)
        print(f"Ts = {1e3 * Ts:.4g} ms ({found.stamps}).")
    if out is not None:
        name = pathlib.Path(log).name
        about = {"Title": f"diagnosis of {name}", "Comment": f"cnclik diagnose {name}"}
        draw({"diagnose.png": (figure, about)}, out, overwrite=overwrite)
        if not json:
            print(f"Wrote diagnose.png to {out}/.")


def _diagnose(log, Ts, alpha) -> tuple:
    """(numbers, text, function that draws) of one loop."""
    from cnclik.diagnosis import diagnose

    places = log.chosen or log.pairs()[1] or log.joints()
    signal, names = log.columns(places), [log.names[i] for i in places]
    found = diagnose(signal, Ts, alpha=alpha)
    sure = "" if found.confidence is None else f"\nConfidence: {found.confidence:.2g}."
    return _fields(found), f"{found}{sure}", drawn_by("diagnosis", "oscillation", signal, found, names)


def _stack(log, Ts, tasks) -> tuple:
    """(numbers, text, function that draws) of the tasks of a stack."""
    from cnclik.diagnosis import diagnose_tasks

    log.columns([i for places, _ in tasks.values() for i in places])  # whose rows are all finite, or named
    signals = {task: log.columns(places) for task, (places, _) in tasks.items()}
    known = {task: gain for task, (_, gain) in tasks.items() if gain is not None}
    with errors.called(f"{next(iter(tasks))}.signal", "LOG"):
        found = diagnose_tasks(signals, Ts, alpha=known)
    task = found.change[0] if found.change else next(iter(tasks))
    fields: dict = {"change": found.change, "recommended_alpha": found.recommended_alpha}
    fields["tasks"] = {name: _fields(each) for name, each in found.tasks.items()}
    names = [log.names[i] for i in tasks[task][0]]
    return fields, str(found), drawn_by("diagnosis", "oscillation", signals[task], found.tasks[task], names)


def _step(log, Ts, command_kind) -> tuple:
    """(numbers, text, function that draws) of the drive between commands and motion."""
    from cnclik.diagnosis import fit_drive

    places = log.chosen or [i for some in log.pairs() for i in some] or log.motions()
    if len(places) % 2 and log.chosen:
        raise errors.fail("columns", "name as many motions as commands", f"names {len(places)} columns")
    if not log.chosen and not log.pairs()[0] and len(places) != 2:
        raise errors.fail("columns", "name commands, then motions", f"is left out, and LOG has {', '.join(log.names)}")
    both, half = log.columns(places), len(places) // 2
    command, motion = both[:, :half], both[:, half:]
    with errors.called("command", "LOG"):  # which is no option here
        fit = fit_drive(None, command, motion, Ts, command_kind=command_kind)
    names = ("interval", "rms", "explained", "options", "gain", "drift", "recommended_alpha", "note")
    fields = _drive(fit.drive) | {name: getattr(fit, name) for name in names}
    moved = [log.names[i] for i in places[half:]]
    return fields, f"{fit.options}\n{fit}", drawn_by("diagnosis", "drive", Ts, command, motion, fit, moved)


def _tasks(log, words) -> dict:
    """{task: (indices of its columns, its gain or None)}, from --tasks."""
    tasks: dict = {}
    for word in words:
        task, _, gain = word.partition("=")
        named = re.compile(rf"{re.escape(task)}[._/]")
        places = [i for i, name in enumerate(log.names) if i not in log.left_out and named.match(name)]
        if task in tasks:
            raise errors.fail("tasks", "name each task once", f"names {task} twice")
        if not places:
            found = f"is {word!r}, and LOG has {', '.join(log.names)}"
            raise errors.fail("tasks", f"have columns such as {task}.x in LOG", found)
        try:
            tasks[task] = places, float(errors.number("tasks", float(gain), positive=True)) if gain else None
        except ValueError:
            raise errors.fail("tasks", "give gains as positive numbers, such as hands=20", f"is {word!r}") from None
    return tasks


def _fields(found) -> dict:
    """The numbers of a diagnosis, without its curves."""
    fields = {field.name: getattr(found, field.name) for field in dataclasses.fields(found)}
    drive = None if found.drive is None else _drive(found.drive)
    return {n: v for n, v in fields.items() if n not in ("fitted", "Ts")} | {"rings": found.rings, "drive": drive}


def _drive(drive) -> dict:
    """The numbers of a drive; those of another kind are None."""
    fields = {"kind": ("delay", "lag", "second-order")[drive.order], "command": drive.command, "delay": drive.delay}
    orders = {"lag": 1, "natural_frequency": 2, "damping_ratio": 2}
    return fields | {name: getattr(drive, name) if order == drive.order else None for name, order in orders.items()}
