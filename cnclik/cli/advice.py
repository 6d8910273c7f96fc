"""What `cnclik stability` says in words: gains as rows, what they mean as sentences."""

import math

COLUMNS = ("gain", "alpha [1/s]", "alpha·Ts", "by explicit Euler")


def title_of(found) -> str:
    from cnclik.cli.heading import robot_and_task

    return f"{robot_and_task(found.name, found.tip, found.law.task)}, {loop_of(found)}"


def gains_of(found, said, given) -> list:
    """Rows of COLUMNS. Args: given: what the user gave, as `cnclik.cli.problem.table` has it."""
    from cnclik.record import in_words

    at_once = ", if drives followed at once" if said.assumed_dead_time else ""
    rows = []
    for row, name in (
        (f"largest stable{at_once}", "largest_stable_alpha"),
        (f"fastest without overshoot{at_once}", "fastest_monotone_alpha"),
        ("recommended", "recommended_alpha"),
    ):
        value, euler = getattr(said, name), said.explicit_euler[name]
        known = name != "largest_stable_alpha" or exact(found.drive)
        rows.append((row, *(map(or_any, (value, value * found.Ts, euler)) if known else ("not known", "", ""))))
    return [*rows, (_present(given), in_words(found.law.alpha), f"{said.advice.margin.z:.4g}", "")]


_NOT_KNOWN = (
    "The largest stable gain is not known from a lag or servo alone: joints that move together are heavier. A recorded "
    "step of all joints says between which gains it lies (cnclik diagnose LOG.csv --step)."
)


def exact(drive) -> bool:
    """Whether the largest stable gain is known: without a lag or servo, or where the loop knows of none."""
    return drive is None or drive.order == 0 or drive.feedback == "commanded"


def lines_of(found, said, given) -> list:
    """What the numbers mean, in sentences."""
    now, eigen = said.advice.margin, said.advice.spectrum
    lines = [f"Recommended: {said.reason}.", *_costs(said, found)]
    lines += [_NOT_KNOWN] * (not exact(found.drive))
    lines.append(f"At alpha {_present(given)}: {_margin(now, said, found.drive)}")
    if said.advice.times is not None:
        times = said.advice.times
        edge = f"stable to {times.largest:.4g} s" if times.z_largest < math.inf else "any is stable"
        lines.append(f"Sampling time at alpha {_present(given)}: {edge}.")
    null = f"{len(eigen.null)} direction{'s' * (len(eigen.null) != 1)}, |λ| = {eigen.null_radius:.4g}"
    lines.append(f"{said.advice.gains.evaluations} evaluations per step. Null space: {null}.")
    lines += ["The same loop elsewhere, by explicit Euler:"] * bool(said.settings)
    return lines + [f"  {where}: {what}" for where, what in said.settings.items()]


def _present(given) -> str:
    """What to call the gain that the loop has: nobody gave the default."""
    from cnclik.cli.heading import unless_given

    return "by default" if unless_given(given, "alpha") else "now"


def escaped(text):
    """Rich takes [s] for strikethrough."""
    from rich.markup import escape

    return escape(text)


def or_any(value) -> str:
    return "none" if value == 0 else f"{value:.4g}" if value < math.inf else "any"


def _margin(now, said, drive) -> str:
    own, assumed = said.now, said.assumed_dead_time is not None
    if now.margin <= 1:
        return f"UNSTABLE: {now.margin:.4g} of it would be stable; {now.limit}."
    if own is None:
        return "UNSTABLE on the assumed drives; it is stable only where drives follow at once."
    margin = own.gain_margin if assumed else now.margin
    beyond = "any gain is stable" if margin == math.inf else f"gain margin {margin:.4g}"
    beyond = beyond if exact(drive) else f"it leaves {100 * now.radius:.4g} % of an error each step"
    if assumed:
        beyond = f"on the assumed drives, {beyond}"
    late = "" if own.delay_margin == math.inf else f", {own.delay_margin:.3g} samples of dead time more"
    over = (
        f"a step overshoots by {100 * own.overshoot:.2g} % (ζ = {own.damping_ratio:.2g})"
        if own.overshoot > 1e-3
        else "no overshoot"
    )
    rest = "" if assumed else f"; {now.limit}"
    error = "" if assumed or not exact(drive) else f"error × {now.radius:.4g} per step, "
    return f"stable: {beyond}{late}; {error}{over}{rest}."


def _costs(said, found) -> list:
    """What the recommended gain does."""
    from cnclik.stability.settings import OWN_COMMANDS

    gain, Ts = said.recommended, found.Ts
    bears = "any dead time" if gain.delay_margin == math.inf else (
        f"{gain.delay_margin:.3g} samples ({1e3 * gain.delay_margin * Ts:.3g} ms) of dead time more"
    )  # fmt: skip
    drive, margin = found.drive, gain.gain_margin
    more = ", or any gain" if margin == math.inf else f", or {margin:.3g} times the gain"
    more = more if exact(drive) else ""
    lines = [f"It settles to 2 % in {gain.settling_time:.3g} s and bears {bears}{more}."]
    own = drive is not None and drive.feedback == "commanded"
    noise = (
        f"Noise: joints move by {gain.noise_gain:.3g} of what their measurement is off (RMS), commanded velocities by "
        f"{gain.velocity_noise_gain:.3g} 1/s times it."
    )
    lines += [] if own else [noise]
    if found.law.task.position:
        v = said.speed
        lines.append(
            f"At {v:g} m/s the tip is {_length(gain.lag * v)} behind without feed-forward, "
            f"{_length(gain.lag_fed_forward * v)} with it, and {_length(gain.start_error * v)} for a moment after a "
            "sudden start."
        )
        if said.joint_speed == said.joint_speed:
            lines.append(f"{v:g} m/s takes up to {100 * said.joint_speed:.3g} % of a joint's velocity limit here.")
    if drive is not None and not own and not drive.ideal:
        import numpy as np

        late = float(np.max(drive.late_by(Ts)))
        lines.append(
            "With --feedback commanded the loop knows nothing of its drives: commands have no overshoot up to alpha = "
            f"{OWN_COMMANDS / Ts:.4g} 1/s, the motion comes {1e3 * late:.3g} ms after its "
            "command, and what is off stays off."
        )
    return lines


def _length(metres) -> str:
    for unit, scale in (("m", 1.0), ("mm", 1e3), ("µm", 1e6)):
        if abs(metres) * scale >= 1 or unit == "µm":
            return f"{metres * scale:.3g} {unit}"


def name_of(found) -> str:
    return f"{found.name}, {loop_of(found)}"


def loop_of(found) -> str:
    return f"{found.method}" + (f", {found.stage}" if found.method.implicit else "")
