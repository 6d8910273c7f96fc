"""`cnclik stability`: which gain is safe on which drives, as numbers, regions and measured maps."""

import dataclasses
import functools
import math
import pathlib
import textwrap
import time
from typing import Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions, print_json, print_table
from cnclik.cli.problem import DriveOptions, LawOptions, LoopOptions, RobotOptions, given, problem
from cnclik.problem.options import DRIVE
from cnclik.quantities import aloud, in_samples
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.writing import output_folder

GAINS = ("largest_stable", "without_overshoot", "recommended")
METHODS = ("EE", "HEUN", "MIDPOINT", "RK4", "IE", "CN", "TRAPEZOID")  # of the figure of regions
PASSES = (0, 1, 2, 3, 4, 5, 12)
CHART_TS = (1e-3, 2e-2)  # [s], of the figure of gains
CHART_POINTS = 13
CELLS = 128  # of a map along each axis


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, DriveOptions, LoopOptions, LawOptions, RobotOptions):
    """The gains hold for any robot, posture, task and stack. Without any option of the drives, 30 ms of dead time and a
    lag of 100 ms are assumed. Give --delay 0 for drives that follow at once."""

    robot: str | None = option(None, positional=True, group="robot and task")
    """A robot or FILE.py, as for `cnclik solve`: adds the share of its joints' velocity limits that --speed needs."""
    N: int | None = option(None, group="loop")
    """Steps of each simulated loop of a map; default: 100, or 400 with a drive, as such loops settle later."""
    speed: float = option(0.1, unit="m/s")
    """Speed of the tip [m/s] for which lag, tracking error and joint velocities are given."""
    draw: tuple[Literal["gains", "plane", "map"], ...] = ()
    """Figures: gains over sampling time and dead time; stability regions of methods in the complex z-plane; a map of
    simulated loops over alpha and Ts, of the robot or of the paper's planar arm, and for implicit methods over M."""
    json: bool = False
    """Print the answer as JSON and nothing else."""
    out: pathlib.Path = pathlib.Path("stability-out")
    """Folder for figures and their data (netCDF)."""

    @property
    def computes(self) -> bool:  # type: ignore[override]
        """Whether JAX is needed."""
        return self.robot is not None or "map" in self.draw


def run(args: Args) -> None:
    """Print numbers, and write labelled data, then figures, into the folder."""
    if args.json and args.draw:
        raise errors.fail("json", "be left out with --draw", "is given")
    errors.integer("N", args.N or 100, at_least=4, at_most=errors.MOST)
    errors.number("speed", args.speed, at_least=0)
    if args.draw:
        load_ahead("cnclik.show.style")
    made = None if args.robot is None else problem(args)
    loop = _loop(args, made)
    if args.draw != ("plane",):
        _answer(args, loop, made)
    if not args.draw:
        return
    names = [name for name in args.draw if name != "map"] + [*_maps(loop)] * ("map" in args.draw)
    files = [f"{name}.{end}" for name in names for end in ("nc", "png")]
    figures = {}
    with output_folder(args.out, overwrite=args.overwrite, files=files) as out:
        for kind in dict.fromkeys(args.draw):
            figures |= {"gains": _chart, "plane": _plane, "map": _map}[kind](args, out, loop, made)
    written = out.made + draw(figures, args.out, overwrite=args.overwrite)
    print(f"Wrote {', '.join(sorted(written))} to {args.out}/.")


def _loop(args, made) -> dict:
    """Method, M, Ts and drive, as `gains` takes them."""
    from cnclik.integrate.drive import Drive
    from cnclik.integrate.method import named
    from cnclik.stability.linear import passes_of

    if made is not None:
        return {"Ts": made.Ts, "drive": made.drive, "method": made.method, "M": passes_of(made.stage)}
    each = {name: value for name, value in given(args).items() if name in DRIVE}
    return {"Ts": args.Ts, "drive": Drive(**each) if each else None, "method": named(args.method), "M": args.M}


# --- the answer ---------------------------------------------------------------------------------------


def _answer(args, loop, made) -> None:
    """Print the gains, what the recommended one costs, what the given one does, and the same loop elsewhere."""
    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import gains, in_words
    from cnclik.stability.linear import describe

    found = gains(**loop)
    euler = found if found.method.name == "EE" else found.by("EE")
    asked = sorted(set(args.alpha)) if "alpha" in args.written else []
    responses = {alpha: found.at(alpha) for alpha in asked if alpha > 0}
    robot = [] if made is None else _robot(args, found, made)
    drives = drive_in_words(found.drive, found.Ts)
    if args.json:
        own = {name: getattr(found, name) for name in GAINS}
        print_json({
            **own, "reason": found.reason, "assumed": found.assumed, "Ts": found.Ts,
            "method": describe(found.method, found.M), "drive": drives,
            "recommended_response": _plain(found.response), "explicit_euler": {k: getattr(euler, k) for k in GAINS},
            "alpha": [{"alpha": a, "stable": r is not None, "response": _plain(r)} for a, r in responses.items()],
            "elsewhere": {where: one._asdict() for where, one in found.elsewhere.items()}, "robot": robot,
        })  # fmt: skip
        return
    print(f"{describe(found.method, found.M)}, Ts {1e3 * found.Ts:g} ms, {drives}{', assumed' * found.assumed}.")
    if found.assumed:
        print(_MEASURE)
    rows = [
        (name.replace("_", " "), in_words(alpha), in_words(alpha * found.Ts), in_words(getattr(euler, name)))
        for name in GAINS
        for alpha in [getattr(found, name)]
    ]
    rows += [("yours", f"{alpha:.4g}", f"{alpha * found.Ts:.4g}", "") for alpha in asked]
    columns = 3 if euler is found else 4
    header = ("gain", "alpha [1/s]", "alpha·Ts", "by explicit Euler")
    print_table([row[:columns] for row in rows], header[:columns])
    print(f"Recommended: {found.reason}.")
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


def _robot(args, found, made) -> list[str]:
    """Sentences that need a robot: joint speed at a tip speed, and the rates of its tasks, posture and limits."""
    import numpy as np

    from cnclik.robot.posture import task_jacobians
    from cnclik.stability.advice import advise

    law, lines = made.law, []
    limit = np.asarray(law.chain.velocity_limit, float)
    if law.task.lengths and np.isfinite(limit).any():
        inverse = np.linalg.pinv(task_jacobians(law.chain, law.task, np.asarray(made.q0, float)[None])[0])
        share = np.linalg.norm(inverse[:, list(law.task.lengths)], axis=1) * args.speed / limit
        i = int(np.argmax(share))
        start = "at q0" if "q0" in made.given else "at the default posture"
        lines.append(
            f"{made.name} {start}: {args.speed:g} m/s in the worst direction needs {100 * share[i]:.3g} % of joint "
            f"{law.chain.joint_names[i]}'s velocity limit."
        )
    rates = advise(law, Ts=made.Ts, method=made.method, stage=made.stage, drive=None if found.assumed else made.drive)
    own = "law" in made.given  # of a file
    return lines + [f"{rate}." for rate in rates.rates if own or rate.kind != "task" or len(rates.rates) > 1]


# --- figures ------------------------------------------------------------------------------------------


def _write(out, file, data, args):
    from cnclik.measure.dataset import as_json, provenance
    from cnclik.measure.files import save_netcdf

    about = provenance(float) | {"config": as_json({"robot": args.robot} | given(args))}
    out.write(file, functools.partial(save_netcdf, data.assign_attrs(about)))


def _plane(args, out, loop, made):
    from cnclik.stability.maps import limit_table, plane

    data = plane(METHODS, PASSES)
    _write(out, "plane.nc", data, args)
    print_table(*limit_table(data), title="Limits of z = alpha·Ts on the real axis", left=2)
    return {"plane.png": (drawn_by("stability", "plane", data), {"Title": "stability regions"})}


def _chart(args, out, loop, made):
    import numpy as np

    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import assumed_drive, gain_table
    from cnclik.stability.linear import describe

    Ts, drive = loop["Ts"], loop["drive"] or assumed_drive(loop["Ts"])
    low, high = min(Ts / 2, CHART_TS[0]), max(2 * Ts, CHART_TS[1])
    late = min(max(2 * drive.lumped.delay * Ts, 0.02), 100 * low)
    axes = {"Ts": np.geomspace(low, high, CHART_POINTS), "dead_time": np.linspace(0, late, CHART_POINTS)}
    with progress.bar("gains"):
        data = gain_table(**axes, drive=drive, method=loop["method"], M=loop["M"])
    _write(out, "gains.nc", data, args)
    lag = drive_in_words(dataclasses.replace(drive, delay=0.0, measurement_delay=0), Ts)
    title = textwrap.fill(f"{describe(loop['method'], loop['M'])}, {lag}", 60)
    operating = (Ts, drive.lumped.delay * Ts)
    return {"gains.png": (drawn_by("stability", "gains", data, title=title, operating=operating), {"Title": title})}


def _maps(loop) -> tuple:
    """The figures of a map: also a strip for the number of passes of an implicit method."""
    return ("map", "passes") if loop["method"].implicit and loop["drive"] is None else ("map",)


def _map(args, out, loop, made):
    import numpy as np

    from cnclik.integrate.drive import Drive, drive_in_words
    from cnclik.problem.names import require_free
    from cnclik.stability.linear import describe
    from cnclik.stability.maps import largest_stable, stability_map

    if made is None:
        args.robot = "planar-clockwise:1,1,1,1,1"
        made = problem(args)
    require_free(made.law.chain, made.law.task)
    begun, drive, N = time.perf_counter(), loop["drive"] or Drive(), args.N or (400 if loop["drive"] else 100)
    rate = float(np.max(np.asarray(made.law.alpha)))
    limit = min(largest_stable(made.method, made.stage, drive, Ts=made.Ts), 20 / made.Ts)
    # The gain and the sampling time each cover half the ratio to the limit, so that both reach it in the picture.
    half = np.sqrt(limit / rate)
    ends = [(now * min(1, half) / 3, now * max(1, half) * 3) for now in (rate, made.Ts)]

    def simulated(file, **axes):
        run = dict(method=made.method, stage=made.stage, drive=drive, N=N)
        with progress.bar("loops") as report:
            data = stability_map(made.law, made.reference, made.q0, **run, progress=report, **axes)
        _write(out, file, data, args)
        return data

    data = simulated("map.nc", **{k: np.geomspace(*of, CELLS) for k, of in zip(("alpha", "Ts"), ends, strict=True)})
    title = f"{made.name}, {describe(made.method, loop['M'])}, N = {N}\n"
    title += textwrap.fill(drive_in_words(drive, made.Ts), 60)
    drawn = drawn_by("stability", "stability_map", data, title=title, operating=(rate, made.Ts))
    figures = {"map.png": (drawn, {"Title": f"stability map, {made.name}"})}
    if "passes" in _maps(loop):
        z, title = np.linspace(0.02, 3.0, 2 * CELLS), f"{made.name}, {made.method.name}"
        strip = simulated("passes.nc", alpha=z / made.Ts, Ts=made.Ts, M=np.arange(max(PASSES) + 1))
        figures["passes.png"] = drawn_by("stability", "stability_map", strip, title=title), {"Title": title}
    endings, names = data.ending.values, data.ending.attrs["flag_meanings"].split()
    print(", ".join(f"{name} {np.sum(endings == i)}" for i, name in enumerate(names)))
    print(f"{endings.size:,} loops in {time.perf_counter() - begun:.1f} s.")
    return figures
