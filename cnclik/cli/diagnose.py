"""`cnclik diagnose`: whether the loop behind a log shakes, why, and the gain that stops it; or its drive."""

import dataclasses
import pathlib
import re
from typing import Literal

from cnclik import errors
from cnclik.cli.arguments import option
from cnclik.cli.common import print_json
from cnclik.cli.log import LogOptions, read, sampled
from cnclik.show.output import draw
from cnclik.writing import output_folder


@dataclasses.dataclass(kw_only=True)
class Args(LogOptions):
    alpha: float | None = option(None, unit="1/s")
    """Gain of the loop [1/s]. With it the answer is surer; without it the gain that stops it comes with a factor."""
    tasks: tuple[str, ...] | None = option(None, metavar="NAME[=ALPHA] ...")
    """For a stack: the tasks whose errors are in columns NAME.x, NAME.y, ..., with their gains [1/s] where known."""
    step: bool = False
    """Fit a drive to recorded commands and motion: to joint_1_cmd and joint_1_pos, or to the two columns."""
    command: Literal["position", "velocity"] = "position"
    """With --step: what the commands are."""
    kind: Literal["delay", "lag", "second-order", "velocity PI"] | None = None
    """With --step: the model of the drive; default: the simplest that explains the log."""
    out: pathlib.Path | None = None
    """Folder for the figure diagnose.png."""
    overwrite: bool = False
    """Allow writing into folders, and over files, that cnclik did not make."""


def run(args: Args) -> None:
    """Print the answer, and draw it."""
    if not args.step and args.kind is not None:
        raise errors.fail("kind", "come with --step", "comes without")
    for name in ("step", "columns", "alpha") if args.tasks else ():
        if getattr(args, name):
            instead = "; gains are given as --tasks hands=20" * (name == "alpha")
            raise errors.fail(name, f"be left out with --tasks{instead}", "is given")
    if args.step and args.alpha is not None:
        raise errors.fail("alpha", "be left out with --step", "is given")
    log = read(args)
    Ts = sampled(log, args.Ts)
    if args.out is not None:
        with output_folder(args.out, overwrite=args.overwrite, files=["diagnose.png"]):
            pass  # it takes the figure
    tasks = {} if args.step else _tasks(args, log)
    verb = _step if args.step else _stack if tasks else _diagnose
    with errors.called("signal", "LOG"):
        fields, text, figure = verb(args, log, Ts, tasks)
    if args.json:
        print_json(fields | {"Ts": Ts, "Ts_from": log.stamps})
    else:
        print(text)
        print(f"Ts = {1e3 * Ts:.4g} ms ({log.stamps}).")
    if args.out is not None:
        about = {"Title": f"diagnosis of {args.log.name}", "Comment": f"cnclik diagnose {args.log.name}"}
        draw({"diagnose.png": (figure, about)}, args.out, overwrite=args.overwrite)
        if not args.json:
            print(f"Wrote diagnose.png to {args.out}/.")


def _diagnose(args, log, Ts, _) -> tuple:
    """(numbers, text, function that draws) of one loop."""
    from cnclik.diagnosis import diagnose

    _, motion = ([], []) if args.columns else log.pairs()
    errors_ = [] if args.columns else log.errors()
    places = log.chosen(args.columns) or errors_ or motion or log.joints()
    signal, names = log.columns(places), [log.names[i] for i in places]
    found = diagnose(signal, Ts, alpha=args.alpha)
    return _fields(found), _said(found, names), lambda: _figure(signal, found, names)


def _stack(args, log, Ts, tasks) -> tuple:
    """(numbers, text, function that draws) of the tasks of a stack."""
    from cnclik.diagnosis import diagnose_tasks

    whole, first, signals = log.columns([i for places, _ in tasks.values() for i in places]), 0, {}
    for task, (places, _) in tasks.items():
        signals[task] = whole[:, first : first + len(places)]
        first += len(places)
    known = {task: gain for task, (_, gain) in tasks.items() if gain is not None}
    with errors.called(f"{next(iter(tasks))}.signal", "LOG"):
        found = diagnose_tasks(signals, Ts, alpha=known)
    task = found.change[0] if found.change else next(iter(tasks))
    fields = {"tasks": {name: _fields(one) for name, one in found.tasks.items()}, "share": found.share}
    fields |= {name: getattr(found, name) for name in ("change", "recommended_alpha", "factor")}
    names = [log.names[i] for i in tasks[task][0]]
    return fields, str(found), lambda: _figure(signals[task], found.tasks[task], names)


def _step(args, log, Ts, _) -> tuple:
    """(numbers, text, function that draws) of the drive between commands and motion."""
    from cnclik.diagnosis import fit_drive

    sent, moved = log.pairs(args.columns)
    if not sent:
        sent, moved = [[place] for place in log.motions()] if len(log.motions()) == 2 else ([], [])
    if not sent:
        raise errors.fail("columns", "name commands, then motions", f"is left out, and LOG has {', '.join(log.names)}")
    both = log.columns([*sent, *moved])
    command, motion = both[:, : len(sent)], both[:, len(sent) :]
    fit = fit_drive(None, command, motion, Ts, kind=args.kind, command_kind=args.command)

    def figure():
        from cnclik.show.diagnosis import drive

        return drive(Ts, command, motion, fit, [log.names[i] for i in moved])

    names = ("interval", "rms", "explained", "options", "gain", "drift", "recommended_alpha", "note")
    fields = _drive(fit.drive) | {name: getattr(fit, name) for name in names}
    return fields, f"{fit.options}\n{fit}", figure


def _tasks(args, log) -> dict:
    """{task: (indices of its columns, its gain or None)}, from --tasks or from the file of `cnclik solve --csv`."""
    tasks: dict = {}
    for word in args.tasks or ():
        task, _, gain = word.partition("=")
        named = re.compile(rf"(e_)?{re.escape(task)}[._/]")
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
    if not args.tasks and not args.columns and args.alpha is None:
        for i, name in enumerate(log.names):
            if name.startswith("e_") and "." in name:
                tasks.setdefault(name[2:].partition(".")[0], ([], None))[0].append(i)
    return tasks if args.tasks or len(tasks) > 1 else {}


def _said(found, names) -> str:
    """A diagnosis in words, with its confidence."""
    lines = [str(found)]
    if found.cause == "wrong sign":
        size = found.path.max(0) - found.path.min(0)
        lines += ["Growing: " + ", ".join(n for n, a in zip(names, size, strict=True) if a > 0.05 * size.max()) + "."]
    if found.confidence is not None:
        lines += [f"Confidence: {found.confidence:.2g}."]
    return "\n".join(lines)


def _fields(found) -> dict:
    """The numbers of a diagnosis, without its curves."""
    fields = {field.name: getattr(found, field.name) for field in dataclasses.fields(found)}
    drive = None if found.drive is None else _drive(found.drive)
    left_out = ("path", "modes", "Ts")
    return {n: v for n, v in fields.items() if n not in left_out} | {"rings": found.rings, "drive": drive}


def _drive(drive) -> dict:
    """The numbers of a drive; those of another kind are None."""
    fields = {"kind": ("delay", "lag", "second-order")[drive.order], "command": drive.command, "delay": drive.delay}
    orders = {"lag": 1, "natural_frequency": 2, "damping_ratio": 2}
    return fields | {name: getattr(drive, name) if order == drive.order else None for name, order in orders.items()}


def _figure(signal, found, names):
    from cnclik.show.diagnosis import oscillation

    return oscillation(signal, found, names)
