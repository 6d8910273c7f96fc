"""What a controller needs of a tuned loop: lines to copy, for pink and mink and for a loop of one's own."""

import numpy as np

from cnclik.integrate.method import EE
from cnclik.law import inverse as inverses
from cnclik.record import in_words
from cnclik.stability.linear import amplification, share_per_step

DAMPED_EXCESS = 1e-3  # by which z may exceed 1 and be printed as 1: damped, a step at z = 1 falls short of the error


def controller_lines(tuned) -> dict:
    """Ready-to-use lines of a `Tuned`: {"rate": for one's own loop, "pink_mink": a gain per step}.

    pink and mink step by J Δq = gain·e with gain = alpha·Ts in [0, 1], 1 − exp(−alpha·Ts) for an exponential method,
    and add damping (λ²) to JᵀJ. Where they can't run the loop that was tuned, the second one says "no line" and why;
    where it does not keep its constraints, both do.
    """
    if not tuned.satisfied:
        return dict.fromkeys(("rate", "pink_mink"), "no line: the constraints are not kept")
    return {"rate": _rate_line(tuned), "pink_mink": _pink_mink_line(tuned)}


def _rate_line(tuned) -> str:
    law, alpha = tuned.law, np.asarray(tuned.law.alpha)
    name, formula, _ = _inverse(law.inverse)
    product = f"{in_words(alpha, 6)} {'*' if alpha.ndim < 2 else '@'} e"
    when = f"alpha [1/s], every Ts = {tuned.Ts:.6g} s"
    if tuned.schedule is not None:
        when += f"; alpha scaled to {in_words(tuned.schedule, 6)} 1/s at {len(tuned.schedule)} even instants"
    if tuned.method.name == EE.name:
        null = "" if law.null_velocity is None else f" + (I - {name} @ J) @ qdot_0"
        factor = float(law.feedforward)
        forward = {0.0: "", 1.0: "xdot_d + "}.get(factor, f"{factor:.6g} * xdot_d + ")
        return f"qdot = {name} @ ({forward}{product}){null}  # {when}; {formula}"
    # The gain is that of a step which is no explicit Euler step: take its rate.
    stage = f", ck.{tuned.stage}" if tuned.method.implicit else ""
    step = f'ck.step(law, path, q, t, {tuned.Ts:.6g}, "{tuned.method.name}"{stage}'
    about = f"law: J# (xdot_d + {product}), {when}; {formula}"
    if tuned.method.steps == 1:
        return f"qdot = {step}).qdot  # {about}"
    return (
        f"made = {step}, history=history); qdot, history = made.qdot, made.history  # history: None at first; {about}"
    )


def _pink_mink_line(tuned) -> str:
    alpha, z = np.asarray(tuned.law.alpha), share_per_step(tuned.method, tuned.after.z)
    _, formula, damping = _inverse(tuned.law.inverse)
    if tuned.schedule is not None:
        return "no line: pink and mink have one constant gain"
    if alpha.ndim:
        return "no line: pink and mink have one gain for all axes of a task"
    if damping is None:
        return f"no line: pink and mink have no {formula.split(' (')[0]}"
    if z > 1 + DAMPED_EXCESS:
        return f"no line: z = {z:.4g}, and the gain of pink and mink is meant to be at most 1"
    z = min(z, 1.0)
    damped = f", damping={damping:.6g}" if damping else ""
    line = f"task = FrameTask(..., gain={z:.6g}); solve_ik(..., dt={tuned.Ts:.6g}{damped})  # dt [s]; "
    line += "a PostureTask takes this gain, too (1 if left out)"
    if tuned.method.name != EE.name:
        euler = abs(float(amplification("EE", None, z)))
        line += f"; they step by explicit Euler: the error shrinks by {euler:.4g} per step there"
    if float(tuned.law.feedforward):
        line += "; no feed-forward there"
    return line


def _inverse(inverse):
    """Name and formula of J# for a line of code, and its λ² where it is one number, else None."""
    if isinstance(inverse, inverses.Pseudoinverse):
        return "J_pinv", "J_pinv = pinv(J)", 0.0
    if isinstance(inverse, inverses.Damped):
        size = float(inverse.damping)
        return "J_damped", f"J_damped = J.T @ inv(J @ J.T + {size:.6g}**2 * I)", size**2
    if isinstance(inverse, inverses.Transpose):
        return "J.T", "transpose (J.T)", None
    return "J_inverse", f"{type(inverse).__name__} (its J#)", None
