"""What a controller needs from a tuned loop: lines to copy, for pink and mink and for your own loop."""

import numpy as np

from cnclik.integrate.method import EE
from cnclik.law import inverse as inverses
from cnclik.record import in_words
from cnclik.stability.linear import amplification, share_per_step
from cnclik.stability.peers import to_pink
from cnclik.stability.settings import around_formula
from cnclik.tuning import parameters as pm

DAMPED_EXCESS = 1e-3  # excess of z over 1 that is printed as 1, as damping shortens a step


def controller_lines(tuned) -> dict:
    """Ready-to-use lines of a `Tuned`: {"rate": for your own loop, "pink_mink": a gain per step}.

    pink and mink step by J Δq = gain·e with gain = alpha·Ts in [0, 1], or 1 − exp(−alpha·Ts) for an exponential method,
    and add damping (λ²) to JᵀJ. If they cannot run the tuned loop, the second line is "no line" with the reason; so are
    both if the loop violates its constraints. A line ends with what it leaves out of the law, such as limits and walls.
    """
    if not tuned.satisfied:
        return dict.fromkeys(("rate", "pink_mink"), "no line: the constraints are not kept")
    own = around_formula(tuned.law, tuned.Ts)
    rate, line = _rate_line(tuned), _pink_mink_line(tuned)
    null = ", ".join(filter(None, [own, "null-space velocity" * (tuned.law.null_velocity is not None)]))
    return {
        "rate": rate + f"; not in this line: {own}" * bool(own and tuned.method.name == EE.name),  # a step has all
        "pink_mink": line + f"; not in this line: {null}" * bool(null and not line.startswith("no line")),
    }


def _rate_line(tuned) -> str:
    law, alpha = tuned.law, np.asarray(tuned.law.alpha)
    name, formula, _ = _inverse(law.inverse)
    product = f"{'alpha' if law.task.tasks else in_words(alpha, 6)} * e"
    when = f"alpha [1/s], every Ts = {tuned.Ts:.6g} s"
    if law.task.tasks:
        when += f"; alpha: {_of_each(law, lambda task: pm.gain_of(law, task))}"
        if law.task.weights is not None:
            each = _of_each(law, lambda task: pm.even(np.asarray(law.task.weights)[law.task.of(task)]))
            formula += f"; rows of J and what J# takes times weights: {each}"
    if tuned.schedule is not None:
        when += f"; alpha scaled to {in_words(tuned.schedule, 6)} 1/s at {len(tuned.schedule)} even instants"
    if tuned.method.name == EE.name:
        null = "" if law.null_velocity is None else f" + (I - {name} @ J) @ qdot_0"
        factor = float(law.feedforward)
        forward = {0.0: "", 1.0: "xdot_d + "}.get(factor, f"{factor:.6g} * xdot_d + ")
        return f"qdot = {name} @ ({forward}{product}){null}  # {when}; {formula}"
    # The method is not explicit Euler, so pink and mink need the equivalent gain.
    stage = f", ck.{tuned.stage}" if tuned.method.implicit else ""
    step = f'ck.step(law, path, q, t, {tuned.Ts:.6g}, "{tuned.method.name}"{stage}'
    about = f"law: J# (xdot_d + {product}), {when}; {formula}"
    return f"qdot = {step}).qdot  # {about}"


def _pink_mink_line(tuned) -> str:
    alpha, z = np.asarray(tuned.law.alpha), share_per_step(tuned.method, tuned.after.z)
    _, formula, damping = _inverse(tuned.law.inverse)
    if tuned.schedule is not None:
        return "no line: pink and mink have one constant gain"
    if tuned.law.task.tasks:
        return _costs_line(tuned)
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


def _of_each(law, value) -> str:
    return ", ".join(f"{in_words(value(task), 6)} of {task}" for task, _ in law.task.each)


def _costs_line(tuned) -> str:
    """For a stack: a gain and a cost per task."""
    law, inverse = tuned.law, tuned.law.inverse
    each = inverse.damping if isinstance(inverse, inverses.Levels) else (inverse,)
    if not all(isinstance(one, inverses.Damped) for one in each):
        return "no line: pink and mink have one damping, the same everywhere"
    if any(np.ndim(pm.gain_of(law, task)) for task, _ in law.task.each):
        return "no line: pink and mink have one gain for all axes of a task"
    tasks = []
    for name, one in to_pink(law, tuned.Ts).items():
        gain, cost = share_per_step(tuned.method, one["gain"]), in_words(pm.even(np.array(one["cost"])), 6)
        if gain > 1 + DAMPED_EXCESS:
            return f"no line: z = {gain:.4g} of {name}, and the gain of pink and mink is meant to be at most 1"
        tasks.append(f"{name}: gain={min(gain, 1.0):.6g}, cost={cost}")
    least = min(float(one.damping) for one in each)
    return f"tasks {'; '.join(tasks)}; solve_ik(..., dt={tuned.Ts:.6g}, damping={least**2:.6g})  # dt [s]"


def _inverse(inverse):
    """Name and formula of J# for a line of code, and its λ² where it is one number, else None."""
    if isinstance(inverse, inverses.Levels) and all(isinstance(one, inverses.Damped) for one in inverse.damping):
        each = zip(inverse.names, inverse.damping, strict=True)
        sizes = ", ".join(f"{float(one.damping):.6g} of {' and '.join(names)}" for names, one in each)
        return "J_levels", f"J_levels = J.T @ inv(J @ J.T + diag(size**2)), size: {sizes}", None
    if isinstance(inverse, inverses.Pseudoinverse):
        return "J_pinv", "J_pinv = pinv(J)", 0.0
    if isinstance(inverse, inverses.Damped):
        size = float(inverse.damping)
        return "J_damped", f"J_damped = J.T @ inv(J @ J.T + {size:.6g}**2 * I)", size**2
    return "J_inverse", f"{type(inverse).__name__} (its J#)", None
