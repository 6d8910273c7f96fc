"""`cnclik bench`: what this machine does in a second, line by line, each in a process of its own."""

import dataclasses
import itertools
import json
import sys
from typing import Annotated, Literal

import tyro

from cnclik import errors
from cnclik.bench import timing as bench
from cnclik.bench.timing import Line

Robot = Literal[tuple(bench.ROBOTS)]
Method = Literal["EE", "IE", "CN", "TRAPEZOID", "HEUN", "MIDPOINT", "RK4"]
TABLE = {
    "robot": tuple(bench.ROBOTS),
    "method": ("EE", "IE", "CN", "TRAPEZOID"),
    "dtype": ("float32", "float64"),
    "batch": (1, 64, 4096, 1_000_000),
}


@dataclasses.dataclass(kw_only=True)
class Args:
    """Without a filter: the lines through Panda, EE, float32, batch 4096 along each axis of the table, and a few more.
    A filter takes one value or several, and runs all lines with them; axes without a filter then take all their
    values, except M (5), stage (chord for TRAPEZOID, else picard) and cores (all)."""

    robot: tuple[Robot, ...] = ()
    """planar2 and planar5 are the paper's arms (position, J#); panda, ur5 and chain30 have a whole pose to reach
    (damped least squares)."""
    method: tuple[Method, ...] = ()
    """Method of the step."""
    stage: tuple[Literal[tuple(bench.STAGES)], ...] = ()
    """How implicit stages are solved; explicit methods don't use it."""
    M: Annotated[tuple[int, ...], tyro.conf.arg(name="M")] = ()
    """Passes of the implicit stage."""
    dtype: tuple[Literal["float32", "float64"], ...] = ()
    """Type of all numbers."""
    batch: tuple[int, ...] = ()
    """Loops side by side."""
    cores: tuple[int, ...] = ()
    """Cores that the process is held to."""
    N: Annotated[int | None, tyro.conf.arg(name="N")] = None
    """Steps of a loop; by default 50, fewer for large batches."""
    all: bool = False
    """Every combination of the table's robots, methods, types and batches (long)."""
    gradient: bool | None = None
    """Measure value and gradient too; by default where a filter is given, and on a few lines of the table."""
    seconds: float = 1.0
    """Time for the repeated runs of each program."""
    json: bool = False
    """Print a list of records on stdout, and nothing else there."""


def run(args: Args) -> None:
    """Measure the chosen lines one after another; exit code 1 if one of them could not be measured."""
    errors.number("seconds", args.seconds, at_least=0)
    chosen, records, failed = lines(args), [], 0
    with _progress() as progress:
        bar = progress.add_task("", total=len(chosen))
        for line in chosen:
            progress.update(bar, description=describe(line))
            try:
                records.append(bench.measure_apart(line, args.seconds))
            except bench.LineError as error:
                failed += 1
                progress.console.print(f"{describe(line)}: not measured: {error}", highlight=False, markup=False)
            progress.advance(bar)
    _show(records, to_stderr=args.json)
    if args.json:
        print(json.dumps(records, indent=1))
    if failed:
        sys.exit(1)


def lines(args: Args) -> list[Line]:
    """The lines that the arguments ask for."""
    filters = {name: getattr(args, name) for name in ("robot", "method", "stage", "M", "dtype", "batch", "cores")}
    filtered = any(filters.values())
    if not filtered and not args.all:
        return [dataclasses.replace(line, N=args.N, gradient=_asked(args, line.gradient)) for line in table()]
    for name, values in TABLE.items():
        filters[name] = filters[name] or values
    filters |= {name: filters[name] or (default,) for name, default in (("stage", None), ("M", 5), ("cores", None))}
    made = []
    for values in itertools.product(*filters.values()):
        named = dict(zip(filters, values, strict=True))
        named["stage"] = named["stage"] or bench.STAGE_OF.get(named["method"], "picard")
        made.append(Line(**named, N=args.N, gradient=_asked(args, filtered)))
    return made


def table() -> list[Line]:
    """The lines run without a filter: the whole product would take most of an hour, mostly for compiling."""

    def line(robot="panda", method="EE", **rest):
        return Line(robot=robot, method=method, stage=bench.STAGE_OF.get(method, "picard"), **rest)

    shown = ("planar5", "panda"), ("EE", "CN")
    made = [
        line(robot, method, gradient=robot in shown[0] and method in shown[1])
        for robot in TABLE["robot"]
        for method in TABLE["method"]
    ]
    made += [line(dtype=dtype, batch=batch) for dtype in TABLE["dtype"] for batch in TABLE["batch"]]
    made += [line("panda", "CN", dtype="float64"), line("panda", "CN", batch=1_000_000)]
    made += [line("planar5", "CN", batch=1_000_000)]
    count = len(bench.cores_here())
    # 1, 2, 4, ... and all cores, as long as there is more than one.
    some = {1, *(2**i for i in range(1, count.bit_length()) if 2**i < count), count} if count > 1 else ()
    made += [line(batch=65536, cores=cores) for cores in sorted(some)]
    different = {}
    for line in made:
        different.setdefault(dataclasses.replace(line, gradient=False), line)
    return list(different.values())


def describe(line: Line) -> str:
    """A line in words: "panda CN picard(5) float32 batch 4096"."""
    cores = "" if line.cores is None else f" cores {line.cores}"
    return f"{line.robot} {line.method} {line.stage}({line.M}) {line.dtype} batch {line.batch}{cores}"


def _asked(args, otherwise):
    return otherwise if args.gradient is None else args.gradient


def _progress():
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    return Progress(*columns, console=Console(stderr=True))


def _show(records, *, to_stderr) -> None:
    """The table, on stdout unless that is kept for JSON."""
    if not records:
        return
    from rich.console import Console
    from rich.table import Table

    shown = Table(title=f"cnclik on {records[0]['device']}, JAX {records[0]['jax']}", header_style="bold")
    for name in ("robot", "method", "stage", "dtype"):
        shown.add_column(name, no_wrap=True)
    numbers = "batch", "cores", "N", "M eval/s", "± %", "run", "compile [s]", "peak [MiB]", "∂q0 ×", "∂alpha ×"
    for name in numbers:
        shown.add_column(name, justify="right", no_wrap=True)
    for r in records:
        ratios = (r.get("gradient_over_forward"), r.get("alpha_gradient_over_forward"))
        shown.add_row(
            *(r["robot"], r["method"], f"{r['stage']}({r['M']})", r["dtype"]),
            *(f"{r['batch']:,}", str(r["cores"]), str(r["N"])),
            f"{r['evaluations_per_second'] / 1e6:.3g}",
            f"{50 * r['spread']:.0f}",
            _time(r["run_s"]),
            *(f"{r['compile_s']:.1f}", f"{r['peak_mib']:.0f}"),
            *("" if ratio is None else f"{ratio:.1f}" for ratio in ratios),
        )
    wide = Console(stderr=to_stderr)
    # A pipe has no width of its own: there the table is as wide as it needs to be.
    console = wide if wide.is_terminal else Console(stderr=to_stderr, width=160)
    console.print(shown)
    console.print(
        "M eval/s: millions of evaluations of f(q, t) per second. run: median; ±: half the distance of its quartiles. "
        "∂q0, ∂alpha ×: time of value and gradient over that of the value.",
        highlight=False,
    )


def _time(seconds):
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"
