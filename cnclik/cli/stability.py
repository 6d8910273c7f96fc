"""`cnclik stability`: which gain is safe at which sampling time, as numbers, regions and measured maps."""

import dataclasses
import functools
import pathlib
import textwrap
import time
from typing import Any, NamedTuple

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions, as_options, print_table
from cnclik.cli.problem import DriveOptions, LoopOptions, RobotOptions, TaskOptions, problem, table
from cnclik.cli.remarks import print_json
from cnclik.problem.options import DRIVE
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.writing import output_folder


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, DriveOptions, LoopOptions, TaskOptions, RobotOptions):
    """Without any option of the drives, 30 ms of dead time and a lag of 100 ms are assumed. Give --delay 0 for drives
    that follow at once."""

    robot: str = option("planar-clockwise:1,1,1,1,1", positional=True)
    """A URDF or MJCF file; panda, ur5; planar:1,1,1 (link lengths in m); or a name of robot_descriptions.
    planar-clockwise:1,1,1,1,1 is the paper's arm."""
    target: list[tuple[float, ...]] = option(list, unit="x")
    """Target at which the loop rests: position [m]; for a pose, optionally a quaternion w x y z after it. With --stack
    give it for one tip after the other; tips without one keep that of the file."""
    speed: float = option(0.1, unit="m/s")
    """Speed of the tip [m/s] for which lag, tracking error and joint velocities are given."""
    json: bool = False
    """Print the advice as JSON and nothing else."""
    N: int | None = None
    """Steps of each simulated loop of --map; default: 100, or 400 with a drive, as such loops settle later."""
    tolerance: float = 1e-3
    """A simulated loop counts as converged when its error stays below this fraction of the initial error."""
    plane: bool = False
    """Draw stability regions of --methods and --passes in the complex z-plane; print the largest real z of each."""
    map: bool = False
    """Simulate loops over a grid of alpha and Ts and draw how each ends; for implicit methods also over M. With
    --stack: the linearized loop over the gains of two tasks."""
    gains: tuple[str, ...] | None = None
    """With --stack and --map: the two tasks whose gains are varied; default: the first two."""
    methods: tuple[str, ...] = ("EE", "HEUN", "MIDPOINT", "RK4", "IE", "CN", "TRAPEZOID")
    """Methods of --plane."""
    passes: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 10)
    """Iterations M of --plane; the map over M goes up to the largest."""
    alpha_range: tuple[float, float] | None = option(None, unit="1/s")
    """Range of gains of --map [1/s]; default: around --alpha and the linear stability limit."""
    Ts_range: tuple[float, float] | None = option(None, unit="s")
    """Range of sampling times of --map [s]; default: around --Ts and the linear stability limit."""
    cells: int | None = None
    """Number of cells of --map along each axis; default: 128."""
    out: pathlib.Path | None = None
    """Folder for figures and data (netCDF) of --plane and --map; default: stability-out."""


def run(args: Args) -> None:
    """Print numbers, and write labelled data, then figures, into the folder."""
    _check(args)
    folder = args.out or pathlib.Path("stability-out")
    if not (args.plane or args.map):
        _tell(args, _advice(args, *_loop(args)))
        return
    load_ahead("cnclik.show.style")
    figures = {}
    loop: tuple = _loop(args) if args.map else ()
    files = ["plane.nc", "plane.md", "plane.png"] * args.plane + ["map.nc", "map.png"] * args.map
    if args.map and not loop[0].law.task.tasks and _has_passes(loop[0]):
        files += ["passes.nc", "passes.png"]
    with output_folder(folder, overwrite=args.overwrite, files=files) as out:
        if args.plane:
            figures |= _plane(args, out)
        if args.map:
            figures |= (_map_of_gains if loop[0].law.task.tasks else _map)(args, out, *loop)
    written = out.made + draw(figures, folder, overwrite=args.overwrite)
    print(f"Wrote {', '.join(sorted(written))} to {folder}/.")


def _check(args):
    if args.out is not None and not (args.map or args.plane):
        raise errors.fail("out", "come with --plane or --map, which write into it", "comes without")
    for name in ("alpha_range", "Ts_range", "gains", "cells"):
        if getattr(args, name) is not None and not args.map:
            raise errors.fail(name.replace("_", "-"), "come with --map, which it is for", "comes without")
    args.cells = errors.integer("cells", 128 if args.cells is None else args.cells, at_least=2, at_most=10_000)
    if args.Ts_range is not None and args.stack is not None:
        raise errors.fail("Ts-range", "be left out with --stack, whose map is of gains alone", "is given")
    if args.json and (args.map or args.plane):
        raise errors.fail("json", "be left out with --map and --plane", "is given")
    given = next((name for name in DRIVE if getattr(args, name) is not None), None)
    if args.plane and given:
        raise errors.fail(given, "be left out with --plane, which is of methods alone", "is given")
    for name in ("methods", "passes"):
        if not getattr(args, name):
            raise errors.fail(name, "name at least one", "is empty")
    if args.N is not None:
        errors.integer("N", args.N, at_least=4, at_most=errors.MOST)
    errors.number("tolerance", args.tolerance, positive=True)
    for name, given in (("alpha-range", args.alpha_range), ("Ts-range", args.Ts_range)):
        if given is not None:
            errors.number(name, given[0], positive=True)
            if not given[0] < given[1]:
                raise errors.fail(name, "increase", f"is {given[0]:g} to {given[1]:g}")


# --- the loop at rest ---------------------------------------------------------------------------------


def _loop(args):
    from cnclik.problem.magnitudes import remark_on_limits
    from cnclik.problem.names import require_free
    from cnclik.problem.targets import at_targets
    from cnclik.stability.loop import rest_of_stack
    from cnclik.stability.spectrum import settle

    targets, several = args.target, args.stack is not None
    if len(targets) > 1 and not several:
        raise errors.fail("target", "be given once", f"is given {len(targets)} times")
    found = problem(args, target=targets[0] if targets and not several else None)
    if args.q0 is not None:
        remark_on_limits("q0", found.q0, found.law.chain)
    if several:
        found = at_targets(found, targets) if targets else found
        with progress.bar("rest"):
            return found, rest_of_stack(found.law, found.reference, found.q0)
    if args.gains is not None:
        raise errors.fail("gains", "come with --stack", "comes without")
    require_free(found.law.chain, found.law.task)
    with progress.bar("rest"):
        return found, settle(found.law, found.reference, found.q0)


def _has_passes(found):
    """Whether a map is drawn with a strip for the number of passes."""
    return found.method.implicit and found.drive is None


class _Advised(NamedTuple):
    """The problem, the posture at which it rests, and the answer."""

    found: Any
    rest: Any
    said: Any


def _advice(args, found, rest):
    from cnclik.stability.advice import advise

    loop = dict(Ts=found.Ts, method=found.method, stage=found.stage, drive=found.drive)
    with progress.bar("advice"):
        held = None if found.law.task.tasks else found.reference
        return _Advised(found, rest, advise(found.law, held, rest, speed=args.speed, **loop))


def _tell(args, advised):
    """Print what was asked, the gains, and how far the present gain is from an unsafe one."""
    from cnclik.problem.heading import dead_time, drive_words, start_and_target
    from cnclik.stability import answer

    if args.json:
        print_json(answer.as_table(*advised))
        return
    found, rest, said = advised
    late = drive_words(found) if found.drive is not None and found.drive.order else dead_time(found)
    asked = [f"{answer.title_of(found)}, Ts {1e3 * found.Ts:g} ms, {late}."]
    asked += [*start_and_target(found, table(args)), *answer.rest_of(found, rest)]
    print(*asked, *map(as_options, filter(None, [said.assumption, *said.notes])), sep="\n")
    for title, columns, rows in answer.tables_of(found, said, args.written):
        print_table(rows, columns, title=title)
    print(*map(as_options, answer.lines_of(found, said, args.written)), sep="\n")


# --- the plane ----------------------------------------------------------------------------------------


def _plane(args, out):
    from cnclik.stability.plane import limit_tables, plane, plane_page

    with progress.bar("limits") as report:
        data = plane(args.methods, args.passes, progress=report)
    _write(out, "plane.nc", data, {"methods": args.methods, "passes": args.passes})
    out.write_text("plane.md", plane_page(data))
    for title, header, rows in limit_tables(data):
        print_table(rows, header, title=title, left=1 + ("stage" in header))
    return {"plane.png": (drawn_by("stability", "plane", data), {"Title": "stability regions"})}


def _write(out, file, data, config):
    from cnclik.measure.dataset import as_json, provenance
    from cnclik.measure.files import save_netcdf

    out.write(file, functools.partial(save_netcdf, data.assign_attrs(provenance(float) | {"config": as_json(config)})))


# --- the map ------------------------------------------------------------------------------------------


def titled(words, found):
    """The title of a map: these words, and the drives of its loops."""
    from cnclik.problem.heading import drive_words

    return f"{words}\n{textwrap.fill(drive_words(found) or 'drives without delay', 60)}"


def _map(args, out, found, rest):
    import numpy as np

    from cnclik.measure.dataset import as_json
    from cnclik.stability import answer
    from cnclik.stability.maps import agreement, passes_map, stability_map
    from cnclik.stability.spectrum import largest_rate

    begun = time.perf_counter()
    advised = _advice(args, found, rest)
    _tell(args, advised)
    now, rate = advised.said.analysis.margin, largest_rate(found.law.alpha)
    # The gain and the sampling time each cover half the ratio to the boundary, so that both reach it in the picture.
    half = np.sqrt(min(now.margin, 20 / now.z))
    alphas = np.geomspace(*_range(args.alpha_range, rate, half), args.cells)
    times = np.geomspace(*_range(args.Ts_range, found.Ts, half), args.cells)
    config = table(args) | {"tolerance": args.tolerance}
    driven = {} if found.drive is None else {"drive": found.drive}
    N = args.N or (400 if driven else 100)
    loop = dict(method=found.method, stage=found.stage, N=N, tolerance=args.tolerance)
    with progress.bar("loops") as report:
        data = stability_map(
            found.law, found.reference, found.q0, alpha=alphas, Ts=times, progress=report, rest=rest, **loop, **driven
        )
    _write(out, "map.nc", data, config)
    title = titled(f"{answer.name_of(found)}, N = {N}", found)
    drawn = drawn_by("stability", "stability_map", data, title=title, operating=(rate, found.Ts, now.margin))
    described = {"Description": as_json(config)}
    figures = {"map.png": (drawn, {"Title": f"stability map, {found.name}"} | described)}
    if _has_passes(found):
        z, some = np.linspace(0.02, 3.0, 2 * args.cells), range(max(args.passes) + 1)
        with progress.bar("loops") as report:
            strip = passes_map(found.law, found.reference, found.q0, z=z, M=some, Ts=found.Ts, progress=report, **loop)
        _write(out, "passes.nc", strip, config)
        name = f"{found.name}, {found.method}, {strip.attrs['stage']}(M)"
        figures["passes.png"] = drawn_by("stability", "passes", {name: strip}), {"Title": name} | described
    endings = data.ending.values
    names = data.ending.attrs["flag_meanings"].split()
    print(", ".join(f"{name} {np.sum(endings == i)}" for i, name in enumerate(names)))
    inside = agreement(endings, data.alpha.values, data.limit.values[:, None])
    seconds = time.perf_counter() - begun
    print(f"{endings.size:,} loops in {seconds:.1f} s; {inside:.2%} end as the linear stability limit predicts.")
    return figures


def _map_of_gains(args, out, found, rest):
    import numpy as np

    from cnclik.measure.dataset import as_json
    from cnclik.stability import answer
    from cnclik.stability.maps import gains_map

    advised = _advice(args, found, rest)
    _tell(args, advised)
    tasks = _with_gains(args.gains, advised.said.stack)
    now = [one.alpha for one in tasks.values()]
    far = [2 * max(min(one.largest_stable_alpha, 10 / found.Ts), one.alpha) for one in tasks.values()]
    ranges = [args.alpha_range or (min(alpha, top / 20) / 3, top) for alpha, top in zip(now, far, strict=True)]
    alpha = {name: np.geomspace(*ends, args.cells) for name, ends in zip(tasks, ranges, strict=True)}
    driven = {} if found.drive is None else {"drive": found.drive}
    loop = dict(Ts=found.Ts, method=found.method, stage=found.stage, **driven)
    with progress.bar("gains"):
        data = gains_map(found.law, rest, alpha=alpha, **loop)
    _write(out, "map.nc", data, table(args))
    title = titled(f"{answer.name_of(found)}, Ts = {1e3 * found.Ts:g} ms", found)
    drawn = drawn_by("stability", "gains", data, title=title, operating=now)
    about = {"Title": f"map of gains, {found.name}", "Description": as_json(table(args))}
    return {"map.png": (drawn, about)}


def _with_gains(names, said):
    """{name: `TaskAdvice`} of the two tasks of a stack whose gains a map scales; names: None for the first two."""
    if said is None:
        raise errors.fail("map", "be left out where the inverse is transpose: its tasks have no limits", "is given")
    known = [name for name, one in said.tasks.items() if one.alpha]
    if len(known) < 2:
        must = "vary the gains of two tasks: leave it out, or give another task an alpha above 0"
        raise errors.fail("map", must, f"only {known[0]!r} has one" if known else "no task has one")
    names = known[:2] if names is None else [errors.one_of("gains", n, known, " (tasks with a gain)") for n in names]
    if len(set(names)) != 2:
        raise errors.fail("gains", f"name two tasks with a gain, of {', '.join(known)}", f"is {' '.join(names)}")
    return {name: said.tasks[name] for name in names}


def _range(given, now, half):
    """The given range, or from a third of the present value to three times the value half the way to the boundary."""
    return given if given is not None else (now * min(1, half) / 3, now * max(1, half) * 3)
