"""What this machine does in a second, line by line, each in a process of its own: `python -m tests.bench.speed`."""

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import Literal

from cnclik import errors
from cnclik.cli import arguments, progress
from tests.bench import lines


@dataclasses.dataclass(kw_only=True)
class Args:
    """Without a filter: the lines through Panda, EE, float32, batch 4096 along each axis of the table, and a few more.
    A filter takes one value or several, and runs all lines with them; axes without a filter then take all their
    values, except M (5), stage (chord for TRAPEZOID, else picard) and cores (all)."""

    robot: tuple[Literal[lines.ROBOTS], ...] = ()
    """planar2 and planar5 are the paper's arms (position, J#); panda, ur5 and chain30 have a whole pose to reach
    (damped least squares)."""
    method: tuple[Literal[tuple(lines.METHODS)], ...] = ()
    """Method of the step."""
    stage: tuple[Literal[lines.STAGES], ...] = ()
    """How implicit stages are solved; explicit methods don't use it."""
    M: tuple[int, ...] = ()
    """Passes of the implicit stage."""
    dtype: tuple[Literal["float32", "float64"], ...] = ()
    """Type of all numbers."""
    batch: tuple[int, ...] = ()
    """Loops side by side."""
    cores: tuple[int, ...] = ()
    """Cores that the process is held to."""
    N: int | None = None
    """Steps of a loop; by default 50, fewer for large batches."""
    all: bool = False
    """Every combination of the table's robots, methods, types and batches (long)."""
    gradient: bool | None = None
    """Measure value and gradient too; by default where a filter is given, and on a few lines of the table."""
    seconds: float = 1.0
    """Time for the repeated runs of each program."""
    cold: bool = False
    """Measure instead how long first answers take: commands in fresh processes, with nothing compiled before, and
    again; one Markdown table."""
    only: tuple[str, ...] = ()
    """With --cold: only lines whose name holds one of these, such as solve."""
    urdf: Path | None = None
    """With --cold: the robot; a file of seven joints by default."""
    spec: Path | None = None
    """With --cold: a sweep, as a line of its own."""
    json: bool = False
    """Print a list of records on stdout, and nothing else there."""


def main() -> None:
    try:
        run(arguments.parse(Args, sys.argv[1:], prog="python -m tests.bench.speed", description=__doc__))
    except errors.ArgumentError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


def run(args: Args) -> None:
    """Measure the chosen lines one after another; exit code 1 if one of them could not be measured."""
    if args.cold:
        _cold(args)
        return
    for name in ("only", "urdf", "spec"):
        if value := getattr(args, name):
            raise errors.fail(name, "be left out without --cold", f"is {str(value)!r}")
    from tests.bench import timing

    errors.number("seconds", args.seconds, at_least=0)
    chosen, records = asked(args), []
    with progress.bar("lines", total=len(chosen)) as report:
        for done, line in enumerate(chosen):
            report(done, len(chosen), str(line))
            try:
                records.append(timing.measure_apart(line, args.seconds))
            except timing.LineError as error:
                print(f"{line}: not measured: {error}", file=sys.stderr)
    if records:
        _show(records, to_stderr=args.json)
    if args.json:
        print(json.dumps(records, indent=1))
    if len(records) < len(chosen):
        sys.exit(1)


def _cold(args: Args) -> None:
    from tests.bench import cold

    for name in ("urdf", "spec"):
        file = getattr(args, name)
        if file is not None and not os.path.isfile(file):
            raise errors.fail(name, "be a file", f"is {str(file)!r}")
    every = cold.table(args.spec)
    chosen = [line for line in every if not args.only or any(part in line.name for part in args.only)]
    if not chosen:
        raise errors.fail("only", "be part of a line's name, such as solve or tune", f"is {' '.join(args.only)!r}")
    records = []
    with progress.bar("lines", total=len(chosen)) as report:
        for done, line in enumerate(chosen):
            report(done, len(chosen), line.name)
            records.append(cold.measure(line, robot=args.urdf, spec=args.spec))
    failed = [record for record in records if "error" in record]
    for record in failed:
        print(f"{record['name']}: not measured: {record['error']}", file=sys.stderr)
    print(json.dumps(records, indent=1) if args.json else cold.page(records), end="\n" if args.json else "")
    if failed:
        sys.exit(1)


def asked(args: Args) -> list[lines.Line]:
    """The lines that the arguments ask for."""
    filters = {name: getattr(args, name) for name in ("robot", "method", "stage", "M", "dtype", "batch", "cores")}
    filtered = any(filters.values())
    found = lines.product(**filters, gradient=filtered) if filtered or args.all else lines.table()
    changes = {"N": args.N} | ({} if args.gradient is None else {"gradient": args.gradient})
    return [dataclasses.replace(line, **changes) for line in found]


def _show(records, *, to_stderr) -> None:
    """The table, on stdout unless that is kept for JSON."""
    from rich.console import Console
    from rich.table import Table

    shown = Table(title=f"cnclik on {records[0]['device']}, JAX {records[0]['jax']}", header_style="bold")
    for name in (*lines.WORDS, *lines.NUMBERS):
        shown.add_column(name, no_wrap=True, justify="right" if name in lines.NUMBERS else "left")
    for record in records:
        shown.add_row(*lines.row(record))
    console = Console(stderr=to_stderr)
    if not console.is_terminal:
        console.width = 160  # a pipe has no width of its own
    console.print(shown)
    console.print(
        "M eval/s: millions of evaluations of f(q, t) per second. run: median; ±: half the distance of its quartiles. "
        "∂q0, ∂alpha ×: time of value and gradient over that of the value.",
        highlight=False,
    )


if __name__ == "__main__":
    main()
