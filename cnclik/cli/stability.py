"""`cnclik stability`: which gain is safe on which drives, as numbers, regions and measured maps."""

import dataclasses
import functools
import math
import pathlib
import textwrap
from typing import Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.common import prepare, print_json, print_table, problem
from cnclik.problem.options import DEFAULTS, DRIVE, drive_from, in_own_units
from cnclik.quantities import aloud, in_samples
from cnclik.show.output import draw as draw_figures
from cnclik.show.output import drawn_by, load_ahead
from cnclik.writing import output_folder

TAKES = ("robot and task", "law", "loop", "drive")
GAINS = ("largest_stable", "without_overshoot", "recommended")
METHODS = ("EE", "HEUN", "MIDPOINT", "RK4", "IE", "CN", "TRAPEZOID")  # of the figure of regions
PASSES = (0, 1, 2, 3, 4, 5, 12)
CHART_POINTS = 13  # of the figure of gains along each axis
CELLS = 128  # of a map along each axis


def run(
    robot: str | None = None,
    *,
    speed: float = 0.1,
    draw: tuple[Literal["gains", "plane", "map"], ...] = (),
    out: str | None = None,
    json: bool = False,
    overwrite: bool = False,
    **loop,
) -> None:
    """The gains hold for any robot, posture, task and stack. Without any option of the drives, 30 ms of dead time and a
    lag of 100 ms are assumed. Give --delay 0 for drives that follow at once.

    Args:
      robot: a robot or FILE.py, as for `cnclik solve`: adds the share of its joints' velocity limits that --speed
        needs.
      speed: speed of the tip [m/s], at least 0, for which lag, tracking error and joint velocities are given.
      draw: figures: gains over sampling time and dead time; stability regions of methods in the complex z-plane; a map
        of simulated loops over alpha and Ts, of the robot or of the paper's planar arm.
      out: folder for figures and their data (netCDF); default: stability-out.
      json: print the answer as JSON, without figures.
    """
    from cnclik.stability.gain import gains

    if json and draw:
        raise errors.fail("json", "be left out with --draw", "is given")
    if out is not None and not draw:
        raise errors.fail("out", "come with --draw", "comes without")
    errors.number("speed", speed, at_least=0)
    out = "stability-out" if out is None else out
    made = None if robot is None else problem(robot, loop)
    given = in_own_units(loop) if made is None else in_own_units(loop, made.Ts)
    alone = [name for name in given if name not in (*DRIVE, "Ts", "method", "M", "alpha")]
    if robot is None and alone and "map" not in draw:
        raise errors.fail(alone[0], "come with ROBOT or --draw map", "comes without")
    if draw:
        load_ahead("cnclik.show.style")
    if made is None:
        drive, known = {name: value for name, value in given.items() if name in DRIVE}, DEFAULTS | given
        how = {name: known[name] for name in ("Ts", "method", "M")}
        found = gains(**how, drive=drive_from(drive))
    else:
        found = gains(Ts=made.Ts, method=made.method, M=made.stage, drive=made.drive)
    if draw != ("plane",):
        facts = _facts(found, given.get("alpha", ()))
        if made is not None:
            facts["robot"] = _of_robot(found, made, speed, str(robot).endswith(".py"))
        if json:
            print_json(facts)
        else:
            _print(found, facts, speed)
    if not draw:
        return
    drawn, files = {}, [f"{kind}.{end}" for kind in dict.fromkeys(draw) for end in ("nc", "png")]
    with output_folder(pathlib.Path(out), overwrite=overwrite, files=files) as folder:
        from cnclik.measure.dataset import as_json, provenance
        from cnclik.measure.files import save_netcdf

        for kind in dict.fromkeys(draw):
            data, how = _FIGURES[kind](found, given, made)
            data = data.assign_attrs(provenance(float) | {"config": as_json({"robot": robot} | given)})
            folder.write(f"{kind}.nc", functools.partial(save_netcdf, data))
            about = {"Title": how.get("title", "stability regions")}
            drawn[f"{kind}.png"] = drawn_by("stability", kind.replace("map", "stability_map"), data, **how), about
    draw_figures(drawn, out, overwrite=overwrite)
    print(f"Wrote {', '.join(sorted(files))} to {out}/.")


# --- the answer ---------------------------------------------------------------------------------------


def _facts(found, alpha) -> dict:
    """The answer in numbers."""
    from cnclik.record import fields_of  # which loads NumPy

    euler = found if found.method.name == "EE" else found.by("EE")
    yours = sorted(set(alpha if isinstance(alpha, (list, tuple)) else [alpha]))
    each = [(a, found.at(a) if a else None) for a in yours]
    drive = {name: value for name, value in fields_of(found.drive).items() if name in DRIVE}
    return {
        **{"method": found.method.name, "M": found.M, "Ts": found.Ts, "drive": drive, "assumed": found.assumed},
        **{name: getattr(found, name) for name in GAINS},
        "reason": found.reason,
        "recommended_response": found.response,
        "explicit_euler": {name: getattr(euler, name) for name in GAINS},
        "alpha": [{"alpha": a, "stable": not a or response is not None, "response": response} for a, response in each],
        "elsewhere": {where: setting._asdict() for where, setting in found.elsewhere.items()},
    }


def _of_robot(found, made, speed, of_file) -> dict:
    """What a tip speed asks of the joints at the start; of several rates, or of a file, those of tasks, posture, limits
    and walls."""
    import numpy as np

    from cnclik.robot.model import modelled
    from cnclik.stability.advice import advise

    law, facts = made.law, {"name": made.name}
    limit = np.asarray(law.chain.velocity_limit, float)
    if law.task.lengths and not law.task.tasks and np.isfinite(limit).any():  # a stack has several tips
        rows, tip = law.task.rows_at(modelled(law.chain), np.asarray(made.q0, float)), list(law.task.lengths)
        inverse = np.linalg.pinv(rows)[:, tip]
        share = np.linalg.norm(inverse, axis=1) * speed / limit
        facts |= {"joint": law.chain.joint_names[int(np.argmax(share))], "share_of_its_velocity_limit": share.max()}
        if not np.allclose(rows @ inverse, np.eye(len(rows))[:, tip], atol=1e-6):  # singular: not in every direction
            facts |= {"joint": None, "share_of_its_velocity_limit": None}
    drive = None if found.assumed else made.drive
    rates = advise(law, Ts=made.Ts, method=made.method, stage=made.stage, drive=drive).rates
    each = [{n: getattr(rate, n) for n in ("name", "kind", "rate", "stable", "within")} for rate in rates]
    answers = [facts | {"answer": f"{rate}."} for facts, rate in zip(each, rates, strict=True)]
    return facts | {"rates": answers if of_file or len(rates) > 1 else []}


def _print(found, facts, speed) -> None:
    """Print the gains, what the recommended one and the given ones do, the same loop elsewhere, and the robot."""
    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import in_words
    from cnclik.stability.linear import describe

    drives = drive_in_words(found.drive, found.Ts) + ", assumed" * found.assumed
    print(f"{describe(found.method, found.M)}, Ts {1e3 * found.Ts:g} ms, {drives}.")
    if found.assumed:
        print(_MEASURE)
    rows: list[tuple[str, ...]] = [("gain", "alpha [1/s]", "alpha·Ts", "by explicit Euler")]
    for name in GAINS:
        each = (facts[name], facts[name] * found.Ts, facts["explicit_euler"][name])
        rows.append((name.replace("_", " "), *map(in_words, each)))
    rows += [("yours", f"{yours['alpha']:.4g}", f"{yours['alpha'] * found.Ts:.4g}", "") for yours in facts["alpha"]]
    print_table(*(row[: 3 if found.method.name == "EE" else 4] for row in rows))
    print(f"Recommended: {found.reason}.")
    print("These gains hold for any robot, posture, task and stack, each task's alpha and the rate of a posture alike.")
    if found.response:
        _costs(found, found.response, speed)
    for yours in facts["alpha"]:
        judged = "asks for no motion"
        if not yours["stable"]:
            judged = f"is UNSTABLE where J# gives all that it asks for: {found.largest_stable:.4g} 1/s is the limit"
        elif yours["alpha"]:
            judged = f"is stable: a step {_in_words(yours['response'], found.Ts)}"
        print(f"Your gain (alpha = {yours['alpha']:g} 1/s) {judged}.")
    print("The same loop elsewhere, by explicit Euler:")
    print_table(*((where, in_words(of.value or 0.0), of.meaning) for where, of in found.elsewhere.items()), left=3)
    robot = facts.get("robot", {})
    if "joint" in robot and robot["joint"] is None:
        print(f"{robot['name']} at its start: no joint velocities move the tip in the worst direction: J is singular.")
    elif "joint" in robot:
        most = f"{100 * robot['share_of_its_velocity_limit']:.3g} % of joint {robot['joint']}'s velocity limit"
        print(f"{robot['name']} at its start: {speed:g} m/s in the worst direction needs {most}.")
    for rate in robot.get("rates", ()):
        print(rate["answer"])


_MEASURE = (
    "Measure yours: command a step of all joints at once, record commands and positions, and run `cnclik diagnose "
    "LOG.csv --step`; it prints the options to give here. For a purely kinematic simulation give --delay 0."
)


def _in_words(response, Ts) -> str:
    """What a step does, and what the loop tolerates."""
    over = f"{100 * response.overshoot:.2g} %" if response.overshoot > 1e-3 else "less than 0.1 %"
    rings = response.overshoot > 1e-3 or round(response.damping_ratio, 2) < 1
    over = f"overshoots by {over} (ζ = {response.damping_ratio:.2g})" if rings else "does not overshoot"
    settles = f"settles in {response.settling_time:.3g} s"
    settles = settles if response.settling_time < math.inf else "does not settle to within 2 % in the simulated time"
    late = f"{in_samples(response.delay_margin / Ts, Ts)} more" if response.delay_margin < math.inf else "any"
    more = f"{response.gain_margin:.3g} times this" if response.gain_margin < math.inf else "any"
    return f"{over} and {settles}; it tolerates {more} gain, or {late} dead time"


def _costs(found, response, speed) -> None:
    """Print what the recommended gain does."""
    print(f"With it a step {_in_words(response, found.Ts)}.")
    if found.drive.feedback != "commanded":
        moved, sent = response.noise_gain, response.velocity_noise_gain
        print(
            f"Noise: 1 mrad RMS of measurement noise moves the joints by {moved:.3g} mrad RMS, and the commanded "
            f"velocities by {sent:.3g} mrad/s RMS."
        )
    behind, fed, start = (aloud(v * speed, "m") for v in (response.lag, response.lag_fed_forward, response.start_error))
    print(
        f"At {speed:g} m/s the tip lags by {behind} without feed-forward. With feed-forward the lag is {fed} after a "
        f"transient of at most {start}."
    )


# --- figures: each function returns data and how to draw them -------------------------------------------


def _plane(found, given, made):
    from cnclik.stability.maps import limit_table, plane

    data = plane(METHODS, PASSES)
    rows, header = limit_table(data)
    print("Limits of z = alpha·Ts on the real axis")
    print_table(header, *rows, left=2)
    return data, {}


def _gains(found, given, made):
    import numpy as np

    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import gain_table
    from cnclik.stability.linear import describe

    Ts, method, M, drive = found.Ts, found.method, found.M, found.drive
    least = Ts * np.clip(drive.lumped.delay / 100, 0.5, 1.0)
    late = min(max(2 * drive.lumped.delay * Ts, 0.02), 100 * least)  # no more samples than a drive may have
    axes = {"Ts": np.geomspace(least, 10 * Ts, CHART_POINTS), "dead_time": np.linspace(0, late, CHART_POINTS)}
    data = gain_table(**axes, drive=drive, method=method, M=M)
    lag = drive_in_words(dataclasses.replace(drive, delay=0.0, measurement_delay=0), Ts)
    title = textwrap.fill(f"{describe(method, M)}, {lag}", 60)
    return data, {"title": title, "operating": (Ts, drive.lumped.delay * Ts)}


def _map(found, given, made):
    prepare()
    import numpy as np

    from cnclik.integrate.drive import Drive, drive_in_words
    from cnclik.stability.linear import describe
    from cnclik.stability.maps import largest_stable, stability_map

    drive = Drive() if found.assumed else found.drive
    made = made or problem("planar-clockwise:1,1,1,1,1", given)
    rate = float(errors.number("alpha", np.max(np.asarray(made.law.alpha)), positive=True))
    limit = min(largest_stable(made.method, made.stage, drive, Ts=made.Ts) or rate, 20 / made.Ts)
    # The gain and the sampling time each cover half the ratio to the limit, so that both reach it in the picture.
    half = np.sqrt(limit / rate)
    ends = [(now * min(1, half) / 3, now * max(1, half) * 3) for now in (rate, made.Ts)]
    axes = {k: np.geomspace(*of, CELLS) for k, of in zip(("alpha", "Ts"), ends, strict=True)}
    N = given.get("N", 100 if found.assumed else 400)
    with progress.bar("loops") as report:
        how = dict(method=made.method, stage=made.stage, drive=drive, N=N, progress=report)
        data = stability_map(made.law, made.reference, made.q0, **axes, **how)
    endings, names = data.ending.values, data.ending.attrs["flag_meanings"].split()
    print(f"{endings.size:,} loops:", ", ".join(f"{name} {np.sum(endings == i)}" for i, name in enumerate(names)))
    title = f"{made.name}, {describe(made.method, found.M)}, N = {N}\n"
    drives = drive_in_words(drive, made.Ts) + f" at Ts = {1e3 * made.Ts:.4g} ms" * bool(drive.delay)  # in samples
    return data, {"title": title + textwrap.fill(drives, 60), "operating": (rate, made.Ts)}


_FIGURES = {"plane": _plane, "gains": _gains, "map": _map}
