"""`cnclik stability`: which gain is safe on which drives, as numbers, regions and measured maps."""

import dataclasses
import functools
import math
import pathlib
import textwrap
import time
from typing import Any, Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.common import numbers, prepare, print_json, print_table, problem
from cnclik.problem.options import DEFAULTS, DRIVE
from cnclik.quantities import aloud, in_samples
from cnclik.show.output import draw as draw_figures
from cnclik.show.output import drawn_by, load_ahead
from cnclik.writing import output_folder

TAKES = ("robot and task", "law", "loop", "drive")
GAINS = ("largest_stable", "without_overshoot", "recommended")
METHODS = ("EE", "HEUN", "MIDPOINT", "RK4", "IE", "CN", "TRAPEZOID")  # of the figure of regions
PASSES = (0, 1, 2, 3, 4, 5, 12)
CHART_TS = (1e-3, 2e-2)  # [s], of the figure of gains
CHART_POINTS = 13
CELLS = 128  # of a map along each axis


def run(
    robot: str | None = None,
    *,
    N: int | None = None,
    speed: float = 0.1,
    draw: tuple[Literal["gains", "plane", "map"], ...] = (),
    out: str = "stability-out",
    json: bool = False,
    overwrite: bool = False,
    **loop,
) -> None:
    """The gains hold for any robot, posture, task and stack. Without any option of the drives, 30 ms of dead time and a
    lag of 100 ms are assumed. Give --delay 0 for drives that follow at once.

    Args:
      robot: a robot or FILE.py, as for `cnclik solve`: adds the share of its joints' velocity limits that --speed
        needs.
      N: steps of each simulated loop of a map; default: 100, or 400 with a drive, as such loops settle later.
      speed: speed of the tip [m/s], at least 0, for which lag, tracking error and joint velocities are given.
      draw: figures: gains over sampling time and dead time; stability regions of methods in the complex z-plane; a map
        of simulated loops over alpha and Ts, of the robot or of the paper's planar arm, and for implicit methods over
        M.
      out: folder for figures and their data (netCDF).
    """
    if json and draw:
        raise errors.fail("json", "be left out with --draw", "is given")
    errors.integer("N", N or 100, at_least=4, at_most=errors.MOST)
    if draw:
        load_ahead("cnclik.show.style")
    made = None if robot is None else problem(robot, loop)
    given = numbers(loop)
    asked = _loop(given, made)
    if draw != ("plane",):
        _answer(asked, given, made, speed, json)
    if not draw:
        return
    figures = Figures(asked, given, made, robot, N)
    files = [f"{name}.{end}" for name in figures.names(draw) for end in ("nc", "png")]
    with output_folder(pathlib.Path(out), overwrite=overwrite, files=files) as folder:
        drawn: dict = {}
        for kind in dict.fromkeys(draw):
            drawn |= getattr(figures, kind)(folder)
    written = folder.made + draw_figures(drawn, out, overwrite=overwrite)
    print(f"Wrote {', '.join(sorted(written))} to {out}/.")


def _loop(given, made) -> dict:
    """Method, M, Ts and drive, as `gains` takes them."""
    from cnclik.integrate.drive import Drive
    from cnclik.integrate.method import named
    from cnclik.stability.linear import passes_of

    if made is not None:
        return {"Ts": made.Ts, "drive": made.drive, "method": made.method, "M": passes_of(made.stage)}
    each, known = {name: value for name, value in given.items() if name in DRIVE}, DEFAULTS | given
    return {
        "Ts": known["Ts"],
        "drive": Drive(**each) if each else None,
        "method": named(known["method"]),
        "M": known["M"],
    }


# --- the answer ---------------------------------------------------------------------------------------


def _answer(loop, given, made, speed, json) -> None:
    """Print the gains, what the recommended one costs, what the given one does, and the same loop elsewhere."""
    from cnclik.integrate.drive import drive_in_words
    from cnclik.stability.gain import gains, in_words
    from cnclik.stability.linear import describe

    found = gains(**loop)
    euler = found if found.method.name == "EE" else found.by("EE")
    alpha = given.get("alpha", ())
    asked = sorted(set(alpha if isinstance(alpha, (list, tuple)) else [alpha]))
    responses = {alpha: found.at(alpha) for alpha in asked if alpha > 0}
    robot = [] if made is None else _robot(found, made, speed)
    how, drives = describe(found.method, found.M), drive_in_words(found.drive, found.Ts)
    if json:
        own = {name: getattr(found, name) for name in ("reason", "assumed", "Ts", *GAINS)}
        print_json({
            **own, "method": how, "drive": drives, "recommended_response": found.response,
            "explicit_euler": {k: getattr(euler, k) for k in GAINS},
            "alpha": [{"alpha": a, "stable": r is not None, "response": r} for a, r in responses.items()],
            "elsewhere": {where: one._asdict() for where, one in found.elsewhere.items()}, "robot": robot,
        })  # fmt: skip
        return
    print(f"{how}, Ts {1e3 * found.Ts:g} ms, {drives}{', assumed' * found.assumed}.")
    if found.assumed:
        print(_MEASURE)
    each = [(name.replace("_", " "), getattr(found, name), getattr(euler, name)) for name in GAINS]
    rows = [(name, in_words(a), in_words(a * found.Ts), in_words(by_euler)) for name, a, by_euler in each]
    rows += [("yours", f"{a:.4g}", f"{a * found.Ts:.4g}", "") for a in asked]
    header = ("gain", "alpha [1/s]", "alpha·Ts", "by explicit Euler")[: 3 if euler is found else 4]
    print_table([row[: len(header)] for row in rows], header)
    print(f"Recommended: {found.reason}.")
    print("These gains hold for any robot, posture, task and stack, each task's alpha and the rate of a posture alike.")
    lines = _costs(found, found.response, speed) if found.response else []
    lines += [_yours(found, a, responses.get(a)) for a in asked]
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


def _yours(found, alpha, response) -> str:
    """A sentence about the given gain."""
    yours = f"Your gain (alpha = {alpha:g} 1/s)"
    if not alpha:
        return f"{yours} asks for no motion."
    if response is None:
        return f"{yours} is UNSTABLE where J# gives all that it asks for: {found.largest_stable:.4g} 1/s is the limit."
    over = f"overshoots by {100 * response.overshoot:.2g} % (ζ = {response.damping_ratio:.2g})"
    over = over if response.overshoot > 1e-3 else "does not overshoot"
    settles = f" and settles in {response.settling_time:.3g} s" * (response.settling_time < math.inf)
    late = ""
    if response.delay_margin < math.inf:
        late = f", or {in_samples(response.delay_margin / found.Ts, found.Ts)} more dead time"
    return f"{yours} is stable: a step {over}{settles}; it tolerates {response.gain_margin:.3g} times this gain{late}."


def _robot(found, made, speed) -> list[str]:
    """Sentences that need a robot: joint speed at a tip speed, and the rates of its tasks, posture and limits."""
    import numpy as np

    from cnclik.robot.posture import task_jacobians
    from cnclik.stability.advice import advise

    law, lines = made.law, []
    limit = np.asarray(law.chain.velocity_limit, float)
    if law.task.lengths and np.isfinite(limit).any():
        inverse = np.linalg.pinv(task_jacobians(law.chain, law.task, np.asarray(made.q0, float)[None])[0])
        share = np.linalg.norm(inverse[:, list(law.task.lengths)], axis=1) * speed / limit
        i = int(np.argmax(share))
        start = "at q0" if "q0" in made.given else "at the default posture"
        lines.append(
            f"{made.name} {start}: {speed:g} m/s in the worst direction needs {100 * share[i]:.3g} % of joint "
            f"{law.chain.joint_names[i]}'s velocity limit."
        )
    rates = advise(law, Ts=made.Ts, method=made.method, stage=made.stage, drive=None if found.assumed else made.drive)
    own = "law" in made.given  # of a file
    return lines + [f"{rate}." for rate in rates.rates if own or rate.kind != "task" or len(rates.rates) > 1]


# --- figures ------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Figures:
    """Labelled data and figures: each method writes its data, and returns its figures as `draw` takes them."""

    loop: dict  # as `gains` takes it
    given: dict  # options
    made: Any  # a `Problem`, or None
    robot: str | None
    N: int | None

    def names(self, kinds) -> list:
        """Files without their endings; a map of an implicit method has a strip for the number of its passes."""
        passes = self.loop["method"].implicit and self.loop["drive"] is None
        return [*kinds, *["passes"] * (passes and "map" in kinds)]

    def _write(self, out, file, data):
        from cnclik.measure.dataset import as_json, provenance
        from cnclik.measure.files import save_netcdf

        about = provenance(float) | {"config": as_json({"robot": self.robot} | self.given)}
        out.write(file, functools.partial(save_netcdf, data.assign_attrs(about)))

    def plane(self, out) -> dict:
        from cnclik.stability.maps import limit_table, plane

        data = plane(METHODS, PASSES)
        self._write(out, "plane.nc", data)
        print_table(*limit_table(data), title="Limits of z = alpha·Ts on the real axis", left=2)
        return {"plane.png": (drawn_by("stability", "plane", data), {"Title": "stability regions"})}

    def gains(self, out) -> dict:
        import numpy as np

        from cnclik.integrate.drive import drive_in_words
        from cnclik.stability.gain import assumed_drive, gain_table
        from cnclik.stability.linear import describe

        Ts, method, M = (self.loop[name] for name in ("Ts", "method", "M"))
        drive = self.loop["drive"] or assumed_drive(Ts)
        low, high = min(Ts / 2, CHART_TS[0]), max(2 * Ts, CHART_TS[1])
        late = min(max(2 * drive.lumped.delay * Ts, 0.02), 100 * low)
        axes = {"Ts": np.geomspace(low, high, CHART_POINTS), "dead_time": np.linspace(0, late, CHART_POINTS)}
        with progress.bar("gains"):
            data = gain_table(**axes, drive=drive, method=method, M=M)
        self._write(out, "gains.nc", data)
        lag = drive_in_words(dataclasses.replace(drive, delay=0.0, measurement_delay=0), Ts)
        title = textwrap.fill(f"{describe(method, M)}, {lag}", 60)
        operating = (Ts, drive.lumped.delay * Ts)
        return {"gains.png": (drawn_by("stability", "gains", data, title=title, operating=operating), {"Title": title})}

    def map(self, out) -> dict:
        prepare()
        import numpy as np

        from cnclik.integrate.drive import Drive, drive_in_words
        from cnclik.problem.names import require_free
        from cnclik.stability.linear import describe
        from cnclik.stability.maps import largest_stable

        loop, begun, drive = self.loop, time.perf_counter(), self.loop["drive"] or Drive()
        if self.made is None:
            self.robot = "planar-clockwise:1,1,1,1,1"
        made = self.made or problem(self.robot, self.given)
        require_free(made.law.chain, made.law.task)
        rate = float(np.max(np.asarray(made.law.alpha)))
        limit = min(largest_stable(made.method, made.stage, drive, Ts=made.Ts), 20 / made.Ts)
        # The gain and the sampling time each cover half the ratio to the limit, so that both reach it in the picture.
        half = np.sqrt(limit / rate)
        ends = [(now * min(1, half) / 3, now * max(1, half) * 3) for now in (rate, made.Ts)]
        axes = {k: np.geomspace(*of, CELLS) for k, of in zip(("alpha", "Ts"), ends, strict=True)}
        data, N = self._simulated(out, "map.nc", made, drive, **axes)
        title = f"{made.name}, {describe(made.method, loop['M'])}, N = {N}\n"
        title += textwrap.fill(drive_in_words(drive, made.Ts), 60)
        drawn = drawn_by("stability", "stability_map", data, title=title, operating=(rate, made.Ts))
        figures = {"map.png": (drawn, {"Title": f"stability map, {made.name}"})}
        if "passes" in self.names(["map"]):
            z, title = np.linspace(0.02, 3.0, 2 * CELLS), f"{made.name}, {made.method.name}"
            axes = dict(alpha=z / made.Ts, Ts=made.Ts, M=np.arange(max(PASSES) + 1))
            strip, _ = self._simulated(out, "passes.nc", made, drive, **axes)
            figures["passes.png"] = drawn_by("stability", "stability_map", strip, title=title), {"Title": title}
        endings, names = data.ending.values, data.ending.attrs["flag_meanings"].split()
        print(", ".join(f"{name} {np.sum(endings == i)}" for i, name in enumerate(names)))
        print(f"{endings.size:,} loops in {time.perf_counter() - begun:.1f} s.")
        return figures

    def _simulated(self, out, file, made, drive, **axes) -> tuple:
        """(labelled data of loops over some axes, their number of steps), written to a file."""
        from cnclik.stability import maps

        N = self.N or (400 if self.loop["drive"] else 100)
        with progress.bar("loops") as report:
            run = dict(method=made.method, stage=made.stage, drive=drive, N=N, progress=report)
            data = maps.stability_map(made.law, made.reference, made.q0, **run, **axes)
        self._write(out, file, data)
        return data, N
