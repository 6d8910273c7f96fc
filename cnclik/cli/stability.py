"""`cnclik stability`: which gain is safe on which drives, as numbers, regions and measured maps."""

import dataclasses
import functools
import math
import pathlib
import textwrap
import time

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions, as_options, print_table
from cnclik.cli.problem import DriveOptions, LoopOptions, RobotOptions, TaskOptions, problem, table
from cnclik.cli.remarks import print_json
from cnclik.problem.options import DRIVE
from cnclik.quantities import aloud, in_samples
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.writing import output_folder

GAINS = ("largest_stable", "without_overshoot", "recommended")
CHART_TS = (1e-3, 2e-2)  # [s], of --chart
CHART_POINTS = 13


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, DriveOptions, LoopOptions, TaskOptions, RobotOptions):
    """The gains hold for any robot, posture, task and stack. Without any option of the drives, 30 ms of dead time and a
    lag of 100 ms are assumed. Give --delay 0 for drives that follow at once."""

    robot: str | None = option(None, positional=True)
    """A robot, as for `cnclik solve`: adds the share of its joints' velocity limits that --speed needs. --map runs its
    loops; default there: planar-clockwise:1,1,1,1,1, the paper's arm."""
    target: tuple[float, ...] | None = option(None, unit="x")
    """--map: target at which the loops rest: position [m]; for a pose, optionally a quaternion w x y z after it."""
    speed: float = option(0.1, unit="m/s")
    """Speed of the tip [m/s] for which lag, tracking error and joint velocities are given."""
    json: bool = False
    """Print the answer as JSON and nothing else."""
    chart: bool = False
    """Draw the recommended gain over sampling time and dead time."""
    map: bool = False
    """Simulate loops over a grid of alpha and Ts and draw how each ends; for implicit methods also over M."""
    plane: bool = False
    """Draw stability regions of --methods and --passes in the complex z-plane; print the largest real z of each."""
    methods: tuple[str, ...] = ("EE", "HEUN", "MIDPOINT", "RK4", "IE", "CN", "TRAPEZOID")
    """Methods of --plane."""
    passes: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 10)
    """Iterations M of --plane; the map over M goes up to the largest."""
    N: int | None = None
    """Steps of each simulated loop of --map; default: 100, or 400 with a drive, as such loops settle later."""
    tolerance: float = 1e-3
    """A simulated loop counts as converged when its error stays below this fraction of the initial error."""
    alpha_range: tuple[float, float] | None = option(None, unit="1/s")
    """Range of gains of --map [1/s]; default: around the largest stable one."""
    Ts_range: tuple[float, float] | None = option(None, unit="s")
    """Range of sampling times of --map and --chart [s]; default: around --Ts."""
    cells: int | None = None
    """Number of cells of --map along each axis; default: 128."""
    out: pathlib.Path | None = None
    """Folder for figures and data (netCDF) of --chart, --plane and --map; default: stability-out."""

    @property
    def computes(self) -> bool:
        """Whether JAX is needed."""
        return self.robot is not None or self.map


def run(args: Args) -> None:
    """Print numbers, and write labelled data, then figures, into the folder."""
    _check(args)
    draws = args.plane or args.map or args.chart
    if draws:
        load_ahead("cnclik.show.style")
    loop = _loop(args)
    if not args.plane or args.map or args.chart:
        _answer(args, loop)
    if not draws:
        return
    figures = {}
    files = [f"{name}.{end}" for name in _drawn(args, loop) for end in ("nc", "png")] + ["plane.md"] * args.plane
    folder = args.out or pathlib.Path("stability-out")
    with output_folder(folder, overwrite=args.overwrite, files=files) as out:
        for wanted, make in ((args.plane, _plane), (args.chart, _chart), (args.map, _map)):
            figures |= make(args, out, loop) if wanted else {}
    written = out.made + draw(figures, folder, overwrite=args.overwrite)
    print(f"Wrote {', '.join(sorted(written))} to {folder}/.")


def _drawn(args, loop):
    names = {"plane": args.plane, "gains": args.chart, "map": args.map, "passes": args.map and _has_passes(loop)}
    return [name for name, wanted in names.items() if wanted]


def _check(args):
    draws = args.map or args.plane or args.chart
    if args.out is not None and not draws:
        raise errors.fail("out", "come with --chart, --plane or --map, which write into it", "comes without")
    for name in ("alpha_range", "cells", "target"):
        if getattr(args, name) is not None and not args.map:
            raise errors.fail(name.replace("_", "-"), "come with --map, which it is for", "comes without")
    if args.Ts_range is not None and not (args.map or args.chart):
        raise errors.fail("Ts-range", "come with --map or --chart, which it is for", "comes without")
    args.cells = errors.integer("cells", 128 if args.cells is None else args.cells, at_least=2, at_most=10_000)
    if args.json and draws:
        raise errors.fail("json", "be left out with --map, --chart and --plane", "is given")
    given = next((name for name in DRIVE if getattr(args, name) is not None), None)
    if args.plane and given:
        raise errors.fail(given, "be left out with --plane, which is of methods alone", "is given")
    for name in ("methods", "passes"):
        if not getattr(args, name):
            raise errors.fail(name, "name at least one", "is empty")
    if args.N is not None:
        errors.integer("N", args.N, at_least=4, at_most=errors.MOST)
    errors.number("tolerance", args.tolerance, positive=True)
    errors.number("speed", args.speed, at_least=0)
    for name, given in (("alpha-range", args.alpha_range), ("Ts-range", args.Ts_range)):
        if given is not None:
            errors.number(name, given[0], positive=True)
            if not given[0] < given[1]:
                raise errors.fail(name, "increase", f"is {given[0]:g} to {given[1]:g}")


def _loop(args) -> dict:
    """Method, M, Ts and drive, as `gains` takes them."""
    from cnclik.integrate.drive import Drive
    from cnclik.integrate.method import named
    from cnclik.problem import words

    names = {"delay", "measurement_delay", *DRIVE}
    given = {name: value for name in names if (value := getattr(args, name)) is not None}
    if "damping_ratio" in given and "natural_frequency" not in given:
        raise errors.fail("damping_ratio", "come with `natural_frequency`", "comes without")
    each = {name: value[0] if isinstance(value, tuple) and len(value) == 1 else value for name, value in given.items()}
    errors.one_of("stage", args.stage, words.STAGES)
    M = args.M if args.stage == "picard" else None
    return {"Ts": args.Ts, "drive": Drive(**each) if each else None, "method": named(args.method), "M": M}


# --- the answer ---------------------------------------------------------------------------------------


def _answer(args, loop) -> None:
    """Print the gains, what the recommended one costs, what the given one does, and the same loop elsewhere."""
    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import gains, in_words
    from cnclik.stability.linear import describe

    found = gains(**loop)
    euler = found if found.method.name == "EE" else gains(**loop | {"method": "EE"})
    asked = sorted(set(args.alpha)) if "alpha" in args.written else []
    responses = {alpha: found.at(alpha) for alpha in asked if alpha > 0}
    robot = _robot(args, found) if args.robot is not None else []
    if args.json:
        own = {name: getattr(found, name) for name in GAINS}
        print_json({
            **own, "reason": found.reason, "assumed": found.assumed, "Ts": found.Ts,
            "method": describe(found.method, found.M), "drive": drive_in_words(found.drive, found.Ts),
            "recommended_response": _plain(found.response), "explicit_euler": {k: getattr(euler, k) for k in GAINS},
            "alpha": [{"alpha": a, "stable": r is not None, "response": _plain(r)} for a, r in responses.items()],
            "elsewhere": {where: one._asdict() for where, one in found.elsewhere.items()}, "robot": robot,
        })  # fmt: skip
        return
    drives = drive_in_words(found.drive, found.Ts)
    print(f"{describe(found.method, found.M)}, Ts {1e3 * found.Ts:g} ms, {drives}{', assumed' * found.assumed}.")
    if found.assumed:
        print(_MEASURE)
    rows = [
        (name.replace("_", " "), in_words(alpha), in_words(alpha * found.Ts), in_words(getattr(euler, name)))
        for name in GAINS
        for alpha in [getattr(found, name)]
    ]
    rows += [("yours", f"{alpha:.4g}", f"{alpha * found.Ts:.4g}", "") for alpha in asked]
    print_table(rows, ("gain", "alpha [1/s]", "alpha·Ts", "by explicit Euler"))
    print(as_options(f"Recommended: {found.reason}."))
    print("These gains hold for any robot, posture, task and stack, each task's alpha and the rate of a posture alike.")
    lines = _costs(found, found.response, args.speed) if found.response else []
    for alpha in asked:
        lines.append(_yours(found, alpha, responses.get(alpha), args.speed))
    print(*lines, *robot, sep="\n")
    if found.recommended:
        print("The same loop elsewhere, by explicit Euler:", *_elsewhere(found), sep="\n")


def _elsewhere(found) -> list[str]:
    """Lines with the recommended gain in other libraries; equal ones together."""
    from cnclik.stability.gain import in_words

    groups: dict = {}
    for where, setting in found.elsewhere.items():
        groups.setdefault(setting, []).append(where)
    width = max(len(", ".join(names)) for names in groups.values())
    lines = [
        f"  {', '.join(names):<{width}}  {in_words(setting.value or 0.0):>7}  {setting.meaning}"
        for setting, names in groups.items()
    ]
    return [textwrap.fill(line, 118, subsequent_indent=" " * (width + 13)) for line in lines]


_MEASURE = (
    "Measure yours: command a step of all joints at once, record commands and positions, and run `cnclik diagnose "
    "LOG.csv --step`; it prints the options to give here. For a purely kinematic simulation give --delay 0."
)


def _plain(response):
    return None if response is None else dataclasses.asdict(response)


def _costs(found, response, speed) -> list[str]:
    """Sentences about a response."""
    late = f"{in_samples(response.delay_margin / found.Ts, found.Ts)} more dead time"
    late = "any dead time" if response.delay_margin == math.inf else late
    within = f"settles to within 2 % in {response.settling_time:.3g} s"
    settles = within if response.settling_time < math.inf else "does not settle to within 2 % in the simulated time"
    more = "any gain" if response.gain_margin == math.inf else f"{response.gain_margin:.3g} times this gain"
    lines = [f"A step {settles}. The loop stays stable with {late}, or with {more}."]
    if found.drive.feedback != "commanded":
        lines.append(
            f"Noise: 1 mrad RMS of measurement noise moves the joints by {response.noise_gain:.3g} mrad RMS, and the "
            f"commanded velocities by {response.velocity_noise_gain:.3g} mrad/s RMS."
        )
    behind, fed, start = (aloud(v * speed, "m") for v in (response.lag, response.lag_fed_forward, response.start_error))
    lines.append(
        f"At {speed:g} m/s the tip lags by {behind} without feed-forward. With feed-forward the lag is {fed} after a "
        f"transient of at most {start}."
    )
    return lines


def _yours(found, alpha, response, speed) -> str:
    """A sentence about the given gain."""
    yours = f"Your gain (alpha = {alpha:g} 1/s)"
    if not alpha:
        return f"{yours} asks for no motion."
    if response is None:
        return f"{yours} is UNSTABLE where J# gives all that it asks for: {found.largest_stable:.4g} 1/s is the limit."
    over = f"overshoots by {100 * response.overshoot:.2g} % (ζ = {response.damping_ratio:.2g})"
    over = over if response.overshoot > 1e-3 else "does not overshoot"
    settles = f" and settles in {response.settling_time:.3g} s" * (response.settling_time < math.inf)
    late = f", or {in_samples(response.delay_margin / found.Ts, found.Ts)} more dead time"
    late *= response.delay_margin < math.inf
    return f"{yours} is stable: a step {over}{settles}; it tolerates {response.gain_margin:.3g} times this gain{late}."


def _robot(args, found) -> list[str]:
    """Sentences that need a robot: joint speed at a tip speed, and a posture's or limits' own rates."""
    import numpy as np

    from cnclik.robot.posture import task_jacobians
    from cnclik.stability.advice import advise

    made = problem(args, target=args.target)
    law, lines = made.law, []
    limit = np.asarray(law.chain.velocity_limit, float)
    if law.task.lengths and np.isfinite(limit).any():
        inverse = np.linalg.pinv(task_jacobians(law.chain, law.task, np.asarray(made.q0, float)[None])[0])
        share = np.linalg.norm(inverse[:, list(law.task.lengths)], axis=1) * args.speed / limit
        i = int(np.argmax(share))
        start = "at q0" if args.q0 is not None else "at the default posture"
        lines.append(
            f"{made.name} {start}: {args.speed:g} m/s in the worst direction needs {100 * share[i]:.3g} % of joint "
            f"{law.chain.joint_names[i]}'s velocity limit."
        )
    rates = advise(law, Ts=made.Ts, method=made.method, stage=made.stage, drive=None if found.assumed else made.drive)
    return lines + [f"{rate}." for rate in rates.rates if rate.kind != "task" or len(rates.rates) > 1]


# --- figures ------------------------------------------------------------------------------------------


def _write(out, file, data, config):
    from cnclik.measure.dataset import as_json, provenance
    from cnclik.measure.files import save_netcdf

    out.write(file, functools.partial(save_netcdf, data.assign_attrs(provenance(float) | {"config": as_json(config)})))


def _plane(args, out, loop):
    from cnclik.stability.maps import limit_table, plane, plane_page

    data = plane(args.methods, args.passes)
    _write(out, "plane.nc", data, {"methods": args.methods, "passes": args.passes})
    out.write_text("plane.md", plane_page(data))
    print_table(*limit_table(data), title="Limits of z = alpha·Ts on the real axis", left=2)
    return {"plane.png": (drawn_by("stability", "plane", data), {"Title": "stability regions"})}


def _chart(args, out, loop):
    import numpy as np

    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import assumed_drive, gain_table
    from cnclik.stability.linear import describe

    Ts, drive = loop["Ts"], loop["drive"] or assumed_drive(loop["Ts"])
    low, high = args.Ts_range or (min(Ts / 2, CHART_TS[0]), max(2 * Ts, CHART_TS[1]))
    times = np.geomspace(low, high, CHART_POINTS)
    late = max(2 * drive.lumped.delay * Ts, 0.02)
    with progress.bar("gains"):
        data = gain_table(
            Ts=times, dead_time=np.linspace(0, min(late, 100 * low), CHART_POINTS), drive=drive,
            method=loop["method"], M=loop["M"],
        )  # fmt: skip
    _write(out, "gains.nc", data, table(args))
    lag = drive_in_words(dataclasses.replace(drive, delay=0.0, measurement_delay=0), Ts)
    title = textwrap.fill(f"{describe(loop['method'], loop['M'])}, {lag}", 60)
    operating = (Ts, drive.lumped.delay * Ts)
    return {"gains.png": (drawn_by("stability", "gains", data, title=title, operating=operating), {"Title": title})}


def _has_passes(loop):
    """Whether a map is drawn with a strip for the number of passes."""
    return loop["method"].implicit and loop["drive"] is None


def _map(args, out, loop):
    import numpy as np

    from cnclik.integrate.drive import Drive, drive_in_words
    from cnclik.measure.dataset import as_json
    from cnclik.problem.names import require_free
    from cnclik.stability.linear import describe
    from cnclik.stability.maps import largest_stable, stability_map

    args.robot = args.robot or "planar-clockwise:1,1,1,1,1"
    begun, found, drive = time.perf_counter(), problem(args, target=args.target), loop["drive"] or Drive()
    require_free(found.law.chain, found.law.task)
    rate, N = float(np.max(np.asarray(found.law.alpha))), args.N or (400 if loop["drive"] else 100)
    limit = min(largest_stable(found.method, found.stage, drive, Ts=found.Ts), 20 / found.Ts)
    # The gain and the sampling time each cover half the ratio to the limit, so that both reach it in the picture.
    half = np.sqrt(limit / rate)
    alphas, times = (
        np.geomspace(*(given or (now * min(1, half) / 3, now * max(1, half) * 3)), args.cells)
        for given, now in ((args.alpha_range, rate), (args.Ts_range, found.Ts))
    )

    def simulated(file, **axes):
        with progress.bar("loops") as report:
            data = stability_map(
                found.law, found.reference, found.q0, method=found.method, stage=found.stage, drive=drive, N=N,
                tolerance=args.tolerance, progress=report, **axes,
            )  # fmt: skip
        _write(out, file, data, table(args))
        return data

    data, about = simulated("map.nc", alpha=alphas, Ts=times), {"Description": as_json(table(args))}
    title = f"{found.name}, {describe(found.method, loop['M'])}, N = {N}\n"
    title += textwrap.fill(drive_in_words(drive, found.Ts), 60)
    drawn = drawn_by("stability", "stability_map", data, title=title, operating=(rate, found.Ts))
    figures = {"map.png": (drawn, {"Title": f"stability map, {found.name}"} | about)}
    if _has_passes(loop):
        z, title = np.linspace(0.02, 3.0, 2 * args.cells), f"{found.name}, {found.method.name}"
        strip = simulated("passes.nc", alpha=z / found.Ts, Ts=found.Ts, M=np.arange(max(args.passes) + 1))
        figures["passes.png"] = drawn_by("stability", "passes", {title: strip}), {"Title": title} | about
    endings, names = data.ending.values, data.ending.attrs["flag_meanings"].split()
    print(", ".join(f"{name} {np.sum(endings == i)}" for i, name in enumerate(names)))
    print(f"{endings.size:,} loops in {time.perf_counter() - begun:.1f} s.")
    return figures
