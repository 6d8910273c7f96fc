"""`cnclik tune`: gains by gradient under a stability margin, with the numbers that a controller needs."""

import dataclasses
import json
import sys
import time
from pathlib import Path

from cnclik import errors
from cnclik.cli import common, progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions
from cnclik.cli.problem import MeasuredOptions, ProblemOptions, problem, table
from cnclik.quantities import SAMPLES
from cnclik.show.output import draw, load_ahead
from cnclik.version import __version__
from cnclik.writing import output_folder

_SHAPES = ("as-given", "scalar", "per-axis", "matrix")


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, MeasuredOptions, ProblemOptions):
    """Tune the loop that these options describe. Writes tuned.json, figures and summary.md."""

    N: int = 200
    """Number of steps."""
    over: tuple[str, ...] = ("alpha",)
    """What to tune: alpha, schedule, damping, null_gain, feedforward, links, tool, Ts. With --stack also weights, and
    parameters of one task, as in hands.alpha; of a posture only so."""
    shape: str = "as-given"
    """Form of the gain: scalar, per-axis, matrix (symmetric positive definite), or as-given, the form of --alpha."""
    loss: tuple[str, ...] = option(("tracking",), metavar="NAME[=WEIGHT] ...")
    """What to minimize: tracking (RMS), worst, settling, effort, jerk, noise, delay. Several have weights, as in
    tracking=1 jerk=1e-4."""
    delay_margin: float = option(1.0, unit=SAMPLES)
    """Additional dead time [samples] with which a step must still not overshoot."""
    noise_gain: float = 0.5
    """Largest ratio of joint motion to measurement noise (standard deviations)."""
    ringing: bool = False
    """Drop --delay-margin and --noise-gain: only the loss is minimized, and the loop may ring."""
    margin: float | None = None
    """Largest spectral radius along the path (factor of small errors per step); default: 1, or 0.9 with --ringing."""
    alpha_bounds: tuple[float, float] | None = option(None, unit="1/s")
    """Bounds of the gain [1/s]; default: z = alpha·Ts from 0.001 to 10."""
    Ts_bounds: tuple[float, float] | None = option(None, unit="s")
    """Bounds of the sampling time [s] where it is tuned; default: --Ts/4 to 4·--Ts."""
    velocity_limit: float | None = option(None, unit="q/s")
    """Velocity limit [rad/s, m/s] of all joints, in place of the robot's own limits; 0: no limit."""
    model_error: float = 0.0
    """Relative error of the link lengths in the law's model of the robot."""
    draws: int = 1
    """Number of random scenarios of noise and model error."""
    tolerance: float = 1e-3
    """For the loss `settling`: error below which the tip has settled [m, rad]."""
    steps: int = 100
    """Number of gradient evaluations per start."""
    starts: int = 1
    """Number of descents, the first from --alpha, the others from random values."""
    out: Path = Path("tuned")
    """Folder for tuned.json, summary.md and figures."""
    figures: bool = True
    """Draw the figures."""


def run(args: Args) -> None:
    made = _problem(args)
    asked = _asked(args, made)
    from cnclik import tuning
    from cnclik.problem.heading import dead_time, name_and_tip, robot_and_task, start_and_target
    from cnclik.tuning.page import CAPTIONS

    if args.figures:
        load_ahead("cnclik.show.style")
    drawn = [f"{name}.png" for name in CAPTIONS]
    whole = dict(files=["tuned.json", "summary.md", *drawn * args.figures], replaces=drawn)
    with output_folder(args.out, overwrite=args.overwrite, **whole) as folder:
        begin = time.perf_counter()
        with progress.bar("evaluations") as report:
            loop = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage)
            found = tuning.tune(made.law, made.reference, made.q0, **loop, progress=report, **asked)
        seconds = time.perf_counter() - begin
        data = {"cnclik": __version__} | tuning.to_json(found, config=_config(args))
        folder.write_text("tuned.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
        drawn = {}
        if args.figures:
            from cnclik.show.tuning import drawings

            drawn = drawings(found)
        text = tuning.page(found, name_and_tip(made.name, made.tip), seconds=seconds, figures=tuple(drawn))
        folder.write_text("summary.md", text)
    heading = [
        f"{robot_and_task(made.name, made.tip, made.law.task)}, Ts {1e3 * made.Ts:g} ms, {dead_time(made)}.",
        *start_and_target(made, table(args)),
        *_assumed(made),
    ]
    print("\n".join(heading))
    print(text.split("\n## Figures")[0].rstrip().replace(found.why, common.as_options(found.why)))
    about = json.dumps(data["config"])
    figures = {f"{n}.png": (make, {"Title": f"{made.name}: {n}", "Comment": about}) for n, make in drawn.items()}
    with progress.bar("figures") as report:
        written = draw(figures, args.out, progress=report, overwrite=args.overwrite)
    print(f"\nWrote {', '.join(sorted(folder.made + written))} to {args.out}/.")
    if not found.satisfied:
        sys.exit(1)


def _assumed(made) -> list:
    """A sentence about the assumed drives if only their dead time was given."""
    from cnclik.integrate.drive import Drive
    from cnclik.stability.recommend import assumed_of

    said = assumed_of(made.drive or Drive(), made.Ts)
    measure = "A lag needs a smaller gain: measure it with `cnclik diagnose LOG.csv --step`, which prints the options"
    return [f"{said} {measure} to give here."] if said else []


def _asked(args, made) -> dict:
    """The conditions of the loop, as `tune` takes them."""
    from cnclik.tuning import Conditions, Descent

    gain = "schedule" if "schedule" in args.over and "alpha" not in args.over else "alpha"
    bounds = {name: b for name, b in ((gain, args.alpha_bounds), ("Ts", args.Ts_bounds)) if b is not None}
    limit = args.velocity_limit
    return dict(
        over=args.over,
        bounds=bounds,
        loss=_loss(args.loss),
        **{name: getattr(args, name) for name in ("delay_margin", "noise_gain", "ringing", "margin")},
        velocity_limit="chain" if limit is None else None if limit == 0 else limit,
        conditions=Conditions(
            **{name: getattr(args, name) for name in ("model_error", "draws", "tolerance")},
            **{} if made.drive is None else {"drive": made.drive},
            noise=0.0 if made.noise is None else made.noise,
            seed=int(made.seed),
        ),
        descent=Descent(steps=args.steps, starts=args.starts),
    )


def _problem(args):
    import numpy as np

    from cnclik.record import replace

    errors.one_of("shape", args.shape, _SHAPES)
    made = problem(args)
    alpha, m = np.asarray(made.law.alpha), made.law.task.m
    if args.shape == "scalar" and alpha.ndim:
        raise errors.fail("alpha", "be one number for --shape scalar", f"holds {alpha.size}")
    if args.shape in ("per-axis", "matrix"):
        alpha = np.broadcast_to(alpha, (m,)).astype(float)
        made = dataclasses.replace(
            made, law=replace(made.law, alpha=np.diag(alpha) if args.shape == "matrix" else alpha)
        )
    return made


def _loss(words):
    """`tracking`, or `tracking=1 jerk=1e-4`."""
    made = {}
    for word in words:
        name, _, weight = word.partition("=")
        if name in made:
            raise errors.fail("loss", "name each loss once", f"is {' '.join(words)!r}")
        try:
            made[name] = float(weight) if weight else 1.0
        except ValueError:
            raise errors.fail("loss", "give weights as numbers, such as jerk=1e-4", f"is {word!r}") from None
    from cnclik.tuning.losses import terms

    terms(made)
    return made if len(made) > 1 or next(iter(made.values())) != 1.0 else next(iter(made))


def _config(args) -> dict:
    """Every option that the numbers depend on, with its value."""
    own = {f.name: getattr(args, f.name) for f in dataclasses.fields(args)}
    given = {name: v for name, v in own.items() if v is not None and name not in ("out", "figures", *common.NAMES)}
    return table(args) | {name.rstrip("_"): v for name, v in given.items()}
