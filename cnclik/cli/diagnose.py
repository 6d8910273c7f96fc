"""`cnclik diagnose`: whether a recorded loop rings, its dead time and the gain that stops it; or its drive."""

import dataclasses
import itertools
import pathlib
import re
from typing import Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions, print_json
from cnclik.problem.columns import words_of
from cnclik.quantities import in_samples
from cnclik.show.output import draw
from cnclik.writing import output_folder

SAME = 5e-3  # difference between alpha·Ts and the recording's z that needs no words


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions):
    log: pathlib.Path = option(metavar="LOG.csv", positional=True)
    """The recording: one row per sample, one column per joint, error or command."""
    Ts: float | None = option(None, unit="s")
    """Sampling time of loop and recording [s]; default: from a column of times (time, timestamp, header.stamp, ...)."""
    alpha: float | None = option(None, unit="1/s")
    """Gain of the loop [1/s]. With it the answer names the gain that stops the ringing, without it a factor."""
    columns: tuple[str, ...] | None = None
    """Columns to read, by name or number; default: all but times and status. With --step: commands, then motions."""
    tasks: tuple[str, ...] | None = option(None, metavar="NAME[=ALPHA] ...")
    """For a stack: the tasks whose errors are in columns NAME.x, NAME.y, ..., with their gains [1/s] where known."""
    longest_period: float | None = option(None, unit="s")
    """Motion with a longer period [s] is taken as motion of the path; default: 250 samples."""
    step: bool = False
    """Fit a drive to recorded commands and motion: to joint_1_cmd and joint_1_pos, or to the two columns."""
    command: Literal["position", "velocity"] = "position"
    """With --step: what the commands are."""
    kind: Literal["delay", "lag", "second-order"] | None = None
    """With --step: the model of the drive; default: the simplest that explains the recording."""
    json: bool = False
    """Print the result as JSON."""
    out: pathlib.Path | None = None
    """Folder for the figure diagnose.png."""


def run(args: Args) -> None:
    from cnclik.diagnosis.recording import clock, no_motion, sampling_time
    from cnclik.problem.tables import read_columns

    if not args.step and args.kind is not None:
        raise errors.fail("kind", "come with --step", "comes without")
    for name in ("step", "columns", "alpha") if args.tasks else ():
        if getattr(args, name):
            instead = "; gains are given as --tasks hands=20" * (name == "alpha")
            raise errors.fail(name, f"be left out with --tasks{instead}", "is given")
    names, table = read_columns("LOG", args.log)
    if args.out is not None:
        with output_folder(args.out, overwrite=args.overwrite, files=["diagnose.png"]):
            pass  # it takes the figure
    if table.size == 0:
        raise errors.fail("LOG", "hold numbers", f"{args.log.name} holds none")
    t, times, unit = clock(names, table)
    if t is None and args.Ts is None:
        raise errors.fail("Ts", "be given where no column is called t, time or stamp", "is not")
    with errors.called("t", names[times[0]] if times else "t"):
        Ts, stamps = sampling_time(t, args.Ts), "--Ts"
    if args.Ts is None:
        stamps = f"{names[times[0]]}, read in {unit}"
    elif t is not None:
        stamps = f"--Ts{_otherwise(t, Ts, names[times[0]])}"
    left_out = {*times, *no_motion(names, table)}
    (_step if args.step else _diagnose)(args, names, table, left_out, (Ts, stamps))


def _otherwise(t, Ts, name) -> str:
    """How time stamps contradict the given sampling time, such as by missing rows; "" if they do not."""
    from cnclik.diagnosis.recording import APART, sampling_time

    try:
        own = sampling_time(t, None)
    except errors.ArgumentError as error:
        return f", though of {name} {str(error).partition(', but ')[2].rstrip('.')}"
    return f", though {name} has {1e3 * own:.4g} ms" if abs(own / Ts - 1) > APART else ""


@errors.called("signal", "LOG")
def _diagnose(args, names, table, left_out, of):
    from cnclik.diagnosis.diagnose import LONGEST, diagnose

    Ts, stamps = of
    if args.longest_period is not None:
        errors.number("longest-period", args.longest_period, positive=True)
    longest = LONGEST if args.longest_period is None else max(args.longest_period / Ts, 2.0)
    if tasks := _tasks(args, names, left_out):
        return _diagnose_tasks(args, names, table, tasks, of, longest)
    chosen = _chosen(args.columns, names) or _usual(names, left_out)
    if not chosen:
        raise errors.fail("LOG", "have a column besides the times", "has none")
    signal = _whole(table[:, chosen])
    with progress.bar("parts") as report:
        found = diagnose(signal, Ts, alpha=args.alpha, longest=longest, progress=report)
    if args.json:
        print_json(_fields(found) | {"Ts_from": stamps})
    else:
        print(found)
        _tell(found, [names[i] for i in chosen])
        print(f"Ts = {1e3 * Ts:.4g} ms ({stamps}).")
    if args.out is not None:
        from cnclik.show.diagnosis import oscillation

        _draw(args, lambda: oscillation(signal, found, [names[i] for i in chosen]))


def _tasks(args, names, left_out) -> dict:
    """{task: (indices of its columns, its gain or None)}, from --tasks or from the file of `cnclik solve --csv`."""
    found: dict = {}
    for word in args.tasks or ():
        task, _, gain = word.partition("=")
        at = [
            i for i, name in enumerate(names) if i not in left_out and re.match(rf"(e_)?{re.escape(task)}[._/]", name)
        ]
        if task in found:
            raise errors.fail("tasks", "name each task once", f"names {task} twice")
        if not at:
            raise errors.fail(
                "tasks", f"have columns such as {task}.x in LOG", f"is {word!r}, and LOG has {', '.join(names)}"
            )
        try:
            found[task] = at, float(errors.number("tasks", float(gain), positive=True)) if gain else None
        except ValueError:
            raise errors.fail("tasks", "give gains as positive numbers, such as hands=20", f"is {word!r}") from None
    if not args.tasks and not args.columns and args.alpha is None:
        for i, name in enumerate(names):
            if name.startswith("e_") and "." in name:
                found.setdefault(name[2:].partition(".")[0], ([], None))[0].append(i)
    return found if args.tasks or len(found) > 1 else {}


def _diagnose_tasks(args, names, table, tasks, of, longest):
    from cnclik.diagnosis.tasks import diagnose_tasks

    Ts, stamps = of
    whole = _whole(table[:, [i for places, _ in tasks.values() for i in places]])
    ends = [0, *itertools.accumulate(len(places) for places, _ in tasks.values())]
    signals = {task: whole[:, a:b] for task, (a, b) in zip(tasks, itertools.pairwise(ends), strict=True)}
    gains = {task: gain for task, (_, gain) in tasks.items() if gain is not None}
    with progress.bar("tasks") as report, errors.called(f"{next(iter(tasks))}.signal", "LOG"):
        found = diagnose_tasks(signals, Ts, alpha=gains, longest=longest, progress=report)
    if args.json:
        each = {n: _fields(one.found) | {f: getattr(one, f) for f in _OF_TASK} for n, one in found.tasks.items()}
        print_json({"tasks": each, "change": found.change, "delay": found.delay, "Ts": Ts, "Ts_from": stamps})
    else:
        print(found)
        if found.change:
            print(f"Change the gain of {found.change[0]}" + "".join(f", then of {n}" for n in found.change[1:]) + ".")
            first = found.tasks[found.change[0]].found
            _tell(first, [names[i] for i in tasks[found.change[0]][0]])
        print(f"Ts = {1e3 * Ts:.4g} ms ({stamps}).")
    if args.out is not None:
        from cnclik.show.diagnosis import oscillation

        task = found.change[0] if found.change else next(iter(tasks))
        of_task = signals[task], found.tasks[task].found, [names[i] for i in tasks[task][0]]
        _draw(args, lambda: oscillation(*of_task))


_OF_TASK = ("share", "along", "alpha", "recommended_alpha", "factor")


def _usual(names, left_out) -> list:
    """The errors, or else the joints, in a file of `cnclik solve --csv`; of other files all columns but the times."""
    for kind in ("e_", "q_"):
        if found := [i for i, name in enumerate(names) if name.startswith(kind)]:
            return found
    return [i for i in range(len(names)) if i not in left_out]


def _whole(table):
    """The rows up to the last complete one: the last instant of a run has no step."""
    import numpy as np

    empty = np.isnan(table).any(1)
    table = table[: len(table) - int(np.argmin(empty[::-1]))]
    if (rows := np.flatnonzero(~np.isfinite(table).all(1))).size:
        raise errors.fail("LOG", "hold a finite number in every row of its columns", f"has none in row {rows[0] + 1}")
    return table


def _tell(found, names):
    if found.cause == "wrong sign":
        print("Growing: " + ", ".join(name for name, a in zip(names, found.amplitude, strict=True) if a > 0))
    if found.stable is None:
        return
    gain = f"z = alpha·Ts is now {found.z:.4g}"
    if found.alpha is not None and abs(found.alpha * found.Ts / found.z - 1) > SAME:
        gain = f"alpha·Ts is {found.alpha * found.Ts:.4g}, and the recording's z is {found.z:.4g}"
    print(f"{gain}. With {in_samples(found.delay, found.Ts)} of dead time the loop is "
          f"stable below {found.stable:.4g} and does not overshoot below {found.monotone:.4g}; recommended: "
          f"{found.recommended:.4g}. Confidence in the dead time: {found.confidence:.2f}.")  # fmt: skip


def _fields(found) -> dict:
    made = {"kind": str(found.kind)} | {name: getattr(found, name) for name in _PLAIN.split()}
    return made | {"factors": [[float(f.real), float(f.imag)] for f in found.factors]}


_PLAIN = """
    Ts rings period growth z delay lag phase_delay confidence pure cause angle stable monotone recommended factor alpha
    recommended_alpha period_seconds delay_seconds axis amplitude noise note
"""


def _step(args, names, table, left_out, of):
    from cnclik.diagnosis.fit import fit_drive

    if args.alpha is not None:
        raise errors.fail("alpha", "be left out with --step", "is given")
    Ts, stamps = of
    sent, moved = _pairs(args.columns, names, left_out)
    import numpy as np

    table = _whole(table[:, [*sent, *moved]])
    command, motion = np.split(table, [len(sent)], axis=1)
    fit = fit_drive(None, command, motion, Ts, kind=args.kind, command_kind=args.command)
    if args.json:
        drive = fit.drive
        about = {"kind": ("delay", "lag", "second-order")[drive.order], "Ts": Ts, "Ts_from": stamps}
        about |= {"command": drive.command, "delay": drive.delay}
        own = {"lag": 1, "natural_frequency": 2, "damping_ratio": 2}
        about |= {name: getattr(drive, name) if order == drive.order else None for name, order in own.items()}
        print_json(about | {name: getattr(fit, name) for name in _OF_FIT})
    else:
        print(fit.options)
        print(fit)
        print(f"Ts = {1e3 * Ts:.4g} ms ({stamps}).")
    if args.out is not None:
        from cnclik.show.diagnosis import drive as figure

        _draw(args, lambda: figure(Ts, command, motion, fit, [names[i] for i in moved]))


_OF_FIT = ("uncertainty", "rms", "explained", "options", "gain", "drift", "largest_stable_alpha", "note")


def _chosen(columns, names):
    """Indices of columns that are given by name or number."""
    return [names.index(errors.one_of("columns", column, names)) for column in columns or ()]


_SENT = {"command", "commands", "commanded", "cmd", "target", "desired", "reference", "ref", "setpoint", "sent"}
_MOVED = {"position", "positions", "pos", "motion", "actual", "measured", "feedback"}


def _pairs(columns, names, left_out):
    """Indices of the commands and of the motions: joint_1_cmd belongs to joint_1_pos, or to joint_1."""
    usual = [i for i in range(len(names)) if i not in left_out]
    words = {i: [w for word in words_of(names[i]) for w in re.findall(r"[^0-9]+|[0-9]+", word)] for i in usual}
    of = {i: tuple(w for w in some if w not in _SENT | _MOVED) for i, some in words.items()}
    sent = {of[i]: i for i in usual if _SENT & {*words[i]}}
    marked = {of[i]: i for i in usual if _MOVED & {*words[i]} and not _SENT & {*words[i]}}
    moved = {of[i]: i for i in usual if not _SENT & {*words[i]}} | marked
    if columns:
        places = _chosen(columns, names)
    elif sent and sent.keys() <= moved.keys():
        places = [*sent.values(), *(moved[joint] for joint in sent)]
    else:
        places = [*sent.values(), *marked.values()] if sent and len(sent) == len(marked) else usual
        if not sent and len(places) != 2:
            raise errors.fail("columns", "name commands, then motions", f"is left out, and LOG has {', '.join(names)}")
    if len(places) % 2 or not places:
        raise errors.fail("columns", "name as many motions as commands", f"names {len(places)} columns")
    return places[: len(places) // 2], places[len(places) // 2 :]


def _draw(args, make):
    about = {"Title": f"diagnosis of {args.log.name}", "Comment": f"cnclik diagnose {args.log.name}"}
    draw({"diagnose.png": (make, about)}, args.out, overwrite=args.overwrite)
    if not args.json:
        print(f"Wrote diagnose.png to {args.out}/.")
