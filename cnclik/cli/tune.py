"""`cnclik tune`: gains by gradient under a stability margin, with what a controller needs of them."""

import dataclasses
import json
import math
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from cnclik import errors
from cnclik.cli.problem import Number, ProblemOptions, problem, table

_SHAPES = ("as-given", "scalar", "per-axis", "matrix")
_CAPTIONS = {
    "history": "Loss and worst constraint over the evaluations.",
    "error": "Error before and after.",
    "operating": "Operating point on the stability map (spectral radius of the linear loop at the end of the path).",
    "responses": "Step and sine (30 samples a period) of 1 mm or 1 mrad around the end of the path; axes that "
    "answer alike lie on each other.",
}


@dataclasses.dataclass(kw_only=True)
class Args(ProblemOptions):
    """Tune the loop that these options describe: tuned.json, figures, summary.md."""

    N: int = 200
    """Steps."""
    over: tuple[str, ...] = ("alpha",)
    """What is tuned: alpha, schedule, damping, null_gain, feedforward, links, tool, Ts."""
    shape: str = "as-given"
    """Gain to tune: scalar, per-axis, matrix (symmetric positive definite), or as --alpha is given."""
    loss: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME[=WEIGHT] ...")] = ("tracking",)
    """tracking (RMS), worst, settling, effort, jerk, noise, delay; several with weights: tracking=1 jerk=1e-4."""
    margin: float = 0.9
    """Bound of the spectral radius along the path."""
    alpha_bounds: tuple[float, float] | None = None
    """Bounds of the gain [1/s]; z = alpha·Ts from 0.001 to 10 by default."""
    Ts_bounds: tuple[float, float] | None = None
    """Bounds of the sampling time [s], where it is tuned; a factor 4 around --Ts by default."""
    velocity_limit: Number = None
    """Joint velocity limit [rad/s, m/s] for all joints in place of the robot's own; 0 for none."""
    noise: float = 0.0
    """Standard deviation of the measured error [m, rad]."""
    delay: int = 0
    """Samples by which the measured error is late."""
    model_error: float = 0.0
    """Relative error of the link lengths the law believes in."""
    draws: int = 1
    """Scenarios drawn of noise and model error."""
    tolerance: float = 1e-3
    """What counts as arrived, for the loss settling [m, rad]."""
    steps: int = 100
    """Evaluations with gradient per start."""
    starts: int = 1
    """Descents side by side, the first from --alpha, the others drawn."""
    seed: int = 0
    """Of everything drawn."""
    out: Path = Path("tuned")
    """Folder for results."""
    figures: bool = True
    """Draw figures."""


def run(args: Args) -> None:
    made = _problem(args)
    loss = _loss(args.loss)
    from rich.console import Console

    from cnclik.show.output import output_folder
    from cnclik.tuning.tune import tune

    console = Console(stderr=True)
    bounds = {name: b for name, b in (("alpha", args.alpha_bounds), ("Ts", args.Ts_bounds)) if b is not None}
    if args.alpha_bounds is not None and "alpha" not in args.over and "schedule" in args.over:
        bounds["schedule"] = bounds.pop("alpha")
    limit = {None: "chain", 0.0: None}.get(args.velocity_limit, args.velocity_limit)
    with output_folder(args.out) as folder:
        begin = time.perf_counter()
        with console.status("Compiling") as status:

            def tell(done, size, violation):
                kept = "kept" if violation <= 0 else f"exceeded by {100 * violation:.2g} %"
                status.update(f"{done} of {args.steps} evaluations: loss {size:.5g}, constraints {kept}")

            found = tune(
                made.law,
                made.reference,
                made.q0,
                Ts=made.Ts,
                N=made.N,
                method=made.method,
                stage=made.stage,
                over=args.over,
                bounds=bounds,
                loss=loss,
                margin=args.margin,
                velocity_limit=limit,
                noise=args.noise,
                delay=args.delay,
                model_error=args.model_error,
                draws=args.draws,
                tolerance=args.tolerance,
                steps=args.steps,
                starts=args.starts,
                seed=args.seed,
                progress=tell,
            )
        seconds = time.perf_counter() - begin
        lines = controller_lines(found, made)
        drawn = {}
        if args.figures:
            with console.status("Drawing"):
                drawn = _draw(folder, found, made, args)
        made_by = _json(found, lines, _config(args))
        (folder / "tuned.json").write_text(json.dumps(made_by, indent=1, allow_nan=False) + "\n")
        text = _summary(found, made, lines, drawn, seconds)
        (folder / "summary.md").write_text(text, encoding="utf-8")
        written = sorted(p.name for p in folder.iterdir())
    print(text.split("\n## Figures")[0])
    print(f"\nWrote {', '.join(written)} to {args.out}/.")


def _problem(args):
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
        try:
            made[name] = float(weight) if weight else 1.0
        except ValueError:
            raise errors.fail("loss", "give weights as numbers, such as jerk=1e-4", f"is {word!r}") from None
    from cnclik.tuning.losses import terms

    terms(made)
    return made if len(made) > 1 or next(iter(made.values())) != 1.0 else next(iter(made))


# --- what a controller needs --------------------------------------------------------------------------


def controller_lines(found, made) -> dict:
    """Ready-to-use lines: a gain per step for pink and mink, a rate for one's own loop.

    pink and mink step by J Δq = gain·e with gain = alpha·Ts in [0, 1], and add damping (λ²) to JᵀJ.
    """
    from cnclik.stability.linear import amplification

    alpha = np.asarray(found.law.alpha)
    z = float(found.z)
    name, inverse, damping = _inverse(found.law.inverse)
    product = f"{_show(alpha)} {'*' if alpha.ndim < 2 else '@'} e"
    when = f"alpha [1/s], every Ts = {found.Ts:.6g} s"
    if found.schedule is not None:
        when += f"; alpha scaled to {_show(found.schedule)} 1/s at {len(found.schedule)} even instants"
    if made.method.name == "EE":
        null = "" if found.law.null_velocity is None else f" + (I - {name} @ J) @ qdot_0"
        lines = {"rate": f"qdot = {name} @ ({_feedforward(found)}{product}){null}  # {when}; {inverse}"}
    else:  # the gain is that of a step which is no explicit Euler step: take its rate
        stage = f", ck.{type(made.stage).__name__.lower()}({made.stage.M})" if made.method.implicit else ""
        lines = {"rate": f'qdot = ck.step(law, path, q, t, {found.Ts:.6g}, "{made.method.name}"{stage}).qdot'}
        lines["rate"] += f"  # law: J# (xdot_d + {product}), {when}; {inverse}"
    if found.schedule is not None:
        return lines | {"pink_mink": "no line: pink and mink have one constant gain"}
    if alpha.ndim:
        return lines | {"pink_mink": "no line: pink and mink have one gain for all axes of a task"}
    if damping is None:
        return lines | {"pink_mink": f"no line: pink and mink have no {inverse.split(' (')[0]}"}
    line = f"task = FrameTask(..., gain={min(z, 1.0):.6g})"
    line += f"; solve_ik(..., dt={found.Ts:.6g}{f', damping={damping:.6g}' if damping else ''})  # dt [s]"
    line += "" if z <= 1 else f"; z = {z:.4g} is beyond the 1 they accept"
    if made.method.name != "EE":
        euler = abs(float(amplification("EE", None, min(z, 1.0))))
        line += f"; they step by explicit Euler: the error shrinks by {euler:.4g} per step there"
    if float(found.law.feedforward):
        line += "; no feed-forward there"
    return lines | {"pink_mink": line}


def _show(v):
    return np.array2string(np.asarray(v), precision=6, separator=", ").replace("\n", "")


def _inverse(inverse):
    """Name and formula of J# for a line of code, and its λ² where it is one number, else None."""
    from cnclik.law import inverse as kinds

    if isinstance(inverse, kinds.Pseudoinverse):
        return "J_pinv", "J_pinv = pinv(J)", 0.0
    if isinstance(inverse, kinds.Damped):
        size = float(inverse.damping)
        return "J_damped", f"J_damped = J.T @ inv(J @ J.T + {size:.6g}**2 * I)", size**2
    if isinstance(inverse, kinds.Transpose):
        return "J.T", "transpose (J.T)", None
    return "J_inverse", f"{type(inverse).__name__} (its J#)", None


def _feedforward(found):
    factor = float(found.law.feedforward)
    if factor == 0:
        return ""
    return "xdot_d + " if factor == 1 else f"{factor:.6g} * xdot_d + "


# --- files --------------------------------------------------------------------------------------------


def _plain(value):
    """For JSON: lists and numbers; what is infinite is null."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray) or hasattr(value, "tolist"):
        return _plain(np.asarray(value).tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _json(found, lines, config):
    return _plain(
        {
            "alpha": found.law.alpha,
            "Ts": found.Ts,
            "z": found.z,
            "values": found.values,
            "start": found.start,
            "bounds": found.bounds,
            "units": found.units,
            "spectral_radius": found.radius,
            "spectral_radius_before": found.radius_before,
            "margin": found.margin,
            "velocity_ratio": found.speed,
            "satisfied": found.satisfied,
            "violation": found.violation,
            "loss": found.loss,
            "loss_before": found.loss_before,
            "loss_after": found.loss_after,
            "status": found.status,
            "why": found.why,
            "gradient": found.gradient,
            "evaluations": found.evaluations,
            "starts": found.starts,
            "lines": lines,
            "history": {k: np.asarray(v).astype(float) for k, v in found.history.items()},
            "config": config,
        }
    )


def _config(args) -> dict:
    """Every option that has a part in the numbers, as it was set."""
    own = {f.name: getattr(args, f.name) for f in dataclasses.fields(args)}
    given = {name: v for name, v in own.items() if v is not None and name not in ("out", "figures")}
    return _plain(table(args) | {name.rstrip("_"): v for name, v in given.items()})


def _draw(folder, found, made, args) -> dict:
    from cnclik.show import style, tuning
    from cnclik.stability.responses import responses
    from cnclik.tuning.tune import radius_field

    ends = np.asarray(found.after.q)[-1]
    usable = found.status != "non-finite" and np.isfinite(ends).all()
    field = radius_field(found, made, ends) if usable else None
    data = responses(found.law, None, ends, Ts=found.Ts, method=made.method, stage=made.stage) if usable else None
    with style.style():
        drawn = tuning.pictures(found, made.law.task, field, data)
        for name, figure in drawn.items():
            about = {"Title": f"{made.name}: {name}", "Comment": json.dumps(_config(args))}
            style.save(figure, folder / f"{name}.png", about)
    return {name: _CAPTIONS[name] for name in drawn}


def _summary(found, made, lines, drawn, seconds) -> str:
    show = lambda v: np.array2string(np.asarray(v), precision=5, separator=", ")  # noqa: E731
    finite = lambda v: f"{v:.4g}" if math.isfinite(v) else "not finite"  # noqa: E731
    rows = [
        ("loss", f"{found.loss}: {finite(found.loss_before)} before, {finite(found.loss_after)} after"),
        ("z = alpha·Ts", f"{found.z:.5g} (before {found.z_before:.5g})"),
        ("spectral radius", f"{finite(found.radius)} (margin {found.margin:g}; before {finite(found.radius_before)})"),
    ]
    if found.speed:
        rows.append(("joint velocity", f"{100 * found.speed:.4g} % of the limit at most"))
    kept = "all kept" if found.satisfied else f"NOT kept, exceeded by {100 * found.violation:.3g} %"
    rows += [
        ("constraints", kept),
        ("gradients", f"{found.gradient}; {found.evaluations} evaluations"),
        ("time", f"{seconds:.1f} s, compilation included"),
    ]
    values = [
        (
            name,
            f"{show(v)}{'' if found.units[name] == '1' else ' ' + found.units[name]} (from {show(found.start[name])})",
        )
        for name, v in found.values.items()
    ]
    text = [f"# Tuned: {made.name}", "", found.why, "", f"{made.method}, task {' '.join(made.law.task.names)}, ", ""]
    text[-2] += f"N = {made.N} steps of Ts = {made.Ts:g} s."
    text += ["| | |", "| --- | --- |", *(f"| {a} | {b} |" for a, b in values + rows), ""]
    text += ["## For a controller", ""]
    text += ["```python", lines["rate"], "```", ""]
    if lines["pink_mink"].startswith("task"):
        text += ["pink and mink:", "", "```python", lines["pink_mink"], "```"]
    else:
        text += [f"pink and mink: {lines['pink_mink']}."]
    if drawn:
        text += ["", "## Figures", "", *(f"![{caption}]({name}.png)\n\n{caption}\n" for name, caption in drawn.items())]
    return "\n".join(text).rstrip() + "\n"
