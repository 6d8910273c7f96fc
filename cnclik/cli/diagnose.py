"""`cnclik diagnose`: whether the loop behind a log shakes, why, and the gain that stops it; or its drive."""

import pathlib
from typing import Literal

from cnclik import errors
from cnclik.cli.common import print_json
from cnclik.cli.log import read, sampled
from cnclik.quantities import number
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
      tasks: for a stack, NAME or NAME=ALPHA: the tasks whose errors are in columns NAME.x, NAME.y, ..., with their
        gains where known.
      step: fit a drive to recorded commands and motion: to joint_1_cmd and joint_1_pos, or to the two columns.
      command: with --step: what the commands are.
      out: folder for the figure diagnose.png.
    """
    if alpha is not None and (tasks or step):
        raise errors.fail("alpha", f"be left out with --{'tasks' if tasks else 'step'}", "is given")
    if step and tasks:
        raise errors.fail("step", "be left out with --tasks", "is given")
    if command != "position" and not step:
        raise errors.fail("command", "come with --step", "comes without")
    recorded = read(log, **columns)
    Ts = sampled(recorded)
    if out is not None:
        with output_folder(pathlib.Path(out), overwrite=overwrite, files=["diagnose.png"]):
            pass  # it takes the figure
    with errors.called("signal", "LOG"), errors.called("command", "LOG"):
        if step:
            fields, text, figure = _step(recorded, Ts, command)
        else:
            fields, text, figure = _stack(recorded, Ts, tasks) if tasks else _diagnose(recorded, Ts, alpha)
    if json:
        print_json(fields | {"Ts": Ts, "Ts_from": recorded.stamps})
    else:
        print(f"{text}\nTs = {1e3 * Ts:.4g} ms ({recorded.stamps}).")
    if out is not None:
        name = pathlib.Path(log).name
        about = {"Title": f"diagnosis of {name}", "Comment": f"cnclik diagnose {name}"}
        draw({"diagnose.png": (figure, about)}, out, overwrite=overwrite)
        if not json:
            print(f"Wrote diagnose.png to {out}/.")


def _diagnose(log, Ts, alpha) -> tuple:
    """(numbers, text, function that draws) of one loop."""
    from cnclik.diagnosis import diagnose

    places = log.moved()
    signal, names = log.columns(places), [log.names[i] for i in places]
    found = diagnose(signal, Ts, alpha=alpha)
    sure = "" if found.confidence is None else f"\nConfidence: {found.confidence:.2g}."
    return _fields(found), f"{found}{sure}", drawn_by("diagnosis", "oscillation", signal, found, names)


def _stack(log, Ts, words) -> tuple:
    """(numbers, text, function that draws) of the tasks of a stack."""
    from cnclik.diagnosis import diagnose_tasks

    gains, among = dict(word.partition("=")[::2] for word in words), log.chosen or log.motion
    if len(gains) < len(words):
        raise errors.fail("tasks", "name each task once", f"is {' '.join(words)}")
    places = {task: [i for i in among if log.names[i].startswith((f"{task}.", f"{task}/"))] for task in gains}
    for task, some in places.items():
        if not some:
            found = f"is {task!r}, and LOG has {', '.join(log.names[i] for i in log.chosen) or ', '.join(log.names)}"
            raise errors.fail("tasks", f"have columns such as {task}.x in LOG", found)
    log.columns([i for some in places.values() for i in some])  # whose rows are all finite, or named
    signals = {task: log.columns(some) for task, some in places.items()}
    known = {task: gain if (value := number(gain)) is None else value for task, gain in gains.items() if gain}
    with errors.called("alpha", "tasks"):
        found = diagnose_tasks(signals, Ts, alpha=known)
    task = found.change[0] if found.change else next(iter(gains))
    fields = {"change": found.change, "recommended_alpha": found.recommended_alpha}
    names = [log.names[i] for i in places[task]]
    figure = drawn_by("diagnosis", "oscillation", signals[task], found.tasks[task], names)
    return fields | {"tasks": {name: _fields(each) for name, each in found.tasks.items()}}, str(found), figure


def _fields(found) -> dict:
    """The numbers of a diagnosis, without its curves."""
    from cnclik.record import fields_of  # which loads NumPy

    return {name: value for name, value in fields_of(found).items() if name not in ("fitted", "Ts")}


def _step(log, Ts, command_kind) -> tuple:
    """(numbers, text, function that draws) of the drive between commands and motion."""
    from cnclik.diagnosis import fit_drive

    places = log.chosen or [i for some in log.pairs() for i in some] or log.motion
    if len(places) % 2 and log.chosen:
        raise errors.fail("columns", "name as many motions as commands", f"names {len(places)} columns")
    if not log.chosen and not log.pairs()[0] and len(places) != 2:
        raise errors.fail("columns", "name commands, then motions", f"is left out, and LOG has {', '.join(log.names)}")
    both, half = log.columns(places), len(places) // 2
    command, motion = both[:, :half], both[:, half:]
    fit = fit_drive(None, command, motion, Ts, command_kind=command_kind)
    names = ("interval", "rms", "explained", "options", "gain", "drift", "recommended_alpha", "note")
    fields = {name: getattr(fit, name) for name in ("drive", *names)}
    moved = [log.names[i] for i in places[half:]]
    return fields, f"{fit.options}\n{fit}", drawn_by("diagnosis", "drive", Ts, command, motion, fit, moved)
