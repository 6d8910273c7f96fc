"""Advice as an answer: gains as rows of a table, their meaning in sentences."""

import math

import numpy as np

from cnclik.measure.files import plain
from cnclik.problem.heading import robot_and_task, unless_given
from cnclik.quantities import aloud, in_samples
from cnclik.record import in_words
from cnclik.stability.settings import OWN_COMMANDS
from cnclik.stability.tasks import NOTHING

COLUMNS = ("gain", "alpha [1/s]", "alpha·Ts", "by explicit Euler")


def title_of(found) -> str:
    return f"{robot_and_task(found.name, found.tip, found.law.task)}, {loop_of(found)}"


def tables_of(found, said, written) -> list:
    """[(title, columns, rows)] of the advice. Args: written: names of the options that the user wrote."""
    if said.stack is None:
        columns = COLUMNS[: 3 if found.method.name == "EE" else 4]
        return [("Gains", columns, [row[: len(columns)] for row in gains_of(found, said, written)])]
    prompt = "; largest stable and no overshoot as if drives had no delay" * (said.assumed_dead_time is not None)
    tables: list = [(f"Gains of the tasks [1/s]{prompt}", TASK_COLUMNS, gains_of_tasks(found, said))]
    tables.append(("With the present gains", DOES_COLUMNS, does_of_tasks(found, said)))
    walls = (f"Walls, with tips at {said.speed:g} m/s", WALL_COLUMNS, walls_of(said))
    return [*tables, walls] if said.walls else tables


def rest_of(found, rest) -> list:
    """A sentence with the posture at which a stack rests, where that is not the start."""
    far = found.law.task.tasks and np.abs(np.asarray(rest) - np.asarray(found.q0)).max() > 1e-6
    return [f"Linearized where it rests, at q = {in_words(rest)}."] if far else []


def gains_of(found, said, written) -> list:
    """Rows of COLUMNS. Args: written: names of the options that the user wrote."""
    at_once = ", if drives had no delay" if said.assumed_dead_time else ""
    rows = []
    for row, name in (
        (f"largest stable{at_once}", "largest_stable_alpha"),
        (f"fastest without overshoot{at_once}", "fastest_monotone_alpha"),
        ("recommended", "recommended_alpha"),
    ):
        value, euler = getattr(said, name), said.explicit_euler[name]
        known = name != "largest_stable_alpha" or exact(found.drive)
        rows.append((row, *(map(or_any, (value, value * found.Ts, euler)) if known else ("not known", "", ""))))
    return [*rows, (_present(written), in_words(found.law.alpha), f"{said.analysis.margin.z:.4g}", "")]


NOT_KNOWN = (
    "The largest stable gain is not known from a lag or servo alone: joints that move together have more inertia. "
    "A recorded step of all joints at once may show its range: `cnclik diagnose LOG.csv --step` prints it."
)


_OF_LARGEST = ("largest_stable_alpha", "gain_margin")


def without_largest(fields: dict) -> dict:
    """The advice as plain numbers, without those that depend on the largest stable gain."""
    kept = {name: v for name, v in fields.items() if name not in _OF_LARGEST}
    return {name: without_largest(v) if isinstance(v, dict) else v for name, v in kept.items()}


def as_table(found, rest, said) -> dict:
    """The advice as plain numbers. Null means any gain; unknown numbers are left out."""
    margin = said.analysis.margin
    about = dict(robot=found.name, tip=found.tip, task=list(found.law.task.names), q0=found.q0, rest=rest)
    late = None if found.drive is None else found.drive.lumped.delay
    about |= dict(method=str(found.method), Ts=found.Ts, dead_time_samples=late)
    about |= dict(dead_time_ms=None if late is None else 1e3 * late * found.Ts)
    about |= dict(stage=str(found.stage) if found.method.implicit else None, alpha=found.law.alpha, drive=found.drive)
    fields = plain(about | plain(said))
    fields = fields if exact(found.drive) else without_largest(fields) | {"not_known": NOT_KNOWN}
    return fields | {"stable": margin.margin > 1, "limit": margin.limit, "evaluations": said.analysis.gains.evaluations}


def exact(drive) -> bool:
    """Whether the largest stable gain is known: drives without lag or servo, or feedback of commands."""
    return drive is None or drive.order == 0 or drive.feedback == "commanded"


def lines_of(found, said, written) -> list:
    """The meaning of the numbers, in sentences."""
    if said.stack is not None:
        return lines_of_stack(found, said)
    now, eigen = said.analysis.margin, said.analysis.spectrum
    lines = [f"Recommended: {said.reason}.", *_costs(said, found)]
    lines += [NOT_KNOWN] * (not exact(found.drive))
    lines += [] if said.limits is None else [_sentence(said.limits.words)]
    whose = "The default" if _present(written) == "default" else "Your"
    alpha = in_words(found.law.alpha).removesuffix(".")
    lines.append(f"{whose} gain (alpha = {alpha} 1/s) {_margin(now, said, found.drive, found.Ts)}")
    if said.analysis.times is not None:
        times = said.analysis.times
        some = "any sampling time"
        if times.z_largest < math.inf:
            some = f"sampling times up to {1e3 * times.largest:.4g} ms"
        at_once = " and drives without delay" * (said.assumed_dead_time is not None)
        lines.append(f"With this gain{at_once} the loop is stable for {some}.")
    count = len(eigen.null)
    without = " without dead time and lag" * (found.drive is None or not found.drive.prompt)
    null = f"{count} direction{'s' * (count != 1)}, |λ| = {eigen.null_radius:.4g}{without}" if count else "none"
    lines.append(f"Jacobians per step: {said.analysis.gains.evaluations}. Null space: {null}.")
    lines += ["The same loop elsewhere, by explicit Euler:"] * bool(said.settings)
    return lines + [f"  {where}: {what}" for where, what in said.settings.items()]


# --- of a stack ---------------------------------------------------------------------------------------

LEAKS = 1e-3  # smaller shares are not reported
TASK_COLUMNS = ("task", "alpha", "alpha·Ts", "largest stable", "no overshoot", "recommended")
WALL_COLUMNS = ("wall", "distance", "rate [1/s]", "rate·Ts", "a step may pass it by")
DOES_COLUMNS = ("task", "gets", "alone", "lag [ms]", "settles [s]", "noise gain", "more dead time")


def gains_of_tasks(found, said) -> list:
    """Rows of TASK_COLUMNS: gains [1/s] of a stack's tasks; the largest stable one with the other gains unchanged."""
    known, rows = exact(found.drive), []
    for name, one in said.stack.tasks.items():
        gains = one.largest_stable_alpha, one.fastest_monotone_alpha, one.recommended_alpha
        largest, monotone, recommended = map(or_any, gains)
        largest, recommended = largest if known else "not known", recommended if one.alpha else "0"
        rows.append((name, f"{one.alpha:.4g}", f"{one.z:.4g}", largest, monotone, recommended))
    return rows


def does_of_tasks(found, said) -> list:
    """Rows of DOES_COLUMNS: how many directions a stack's tasks get, and their response with the present gains."""
    rows = []
    for name, one in said.stack.tasks.items():
        m, now = len(one.direction), one.now
        does = ("unstable" if name in said.stack.unstable else "not known" if one.alpha else "no gain", "", "", "")
        if now is not None:
            settles = f"{now.settling_time:.3g}" if now.settling_time < math.inf else "long"
            late = f"{1e3 * now.delay_margin * found.Ts:.4g} ms" if now.delay_margin < math.inf else "any"
            does = (f"{1e3 * now.lag:.4g}", settles, f"{now.noise_gain:.3g}", late)
        rows.append((name, f"{one.got:.3g} of {m}", f"{one.alone:.3g}", *does))
    return rows


def lines_of_stack(found, said) -> list:
    """The meaning of a stack's numbers, in sentences."""
    stack = said.stack
    known, on = exact(found.drive), " on the assumed drives" * (said.assumed_dead_time is not None)
    lines = [f"UNSTABLE{on}: {_unstable(stack.unstable, known)}"] if stack.unstable else []
    lines.append(f"Recommended for each task: {said.reason}, at any posture and for any motion of the other tasks.")
    if idle := [name for name, one in stack.tasks.items() if not one.alpha]:
        lines.append(f"A gain of 0 stays 0, and its task asks for no motion: {', '.join(idle)}.")
    now = stack.tasks[stack.least_room].now
    if now is not None and now.gain_margin < math.inf and known:
        room = f"with the other gains unchanged, its gain may grow by a factor of {now.gain_margin:.3g}"
        lines.append(f"{stack.least_room} has the smallest margin{on}: {room}.")
    lines += [NOT_KNOWN] * (not known)
    over = [name for name, one in stack.tasks.items() if one.alpha > one.recommended_alpha * (1 + 1e-9)]
    if over:
        lines.append(f"Above the recommended gain: {', '.join(over)}.")
    lines += [_conflict(name, one, found) for name, one in stack.tasks.items() if one.yields_to]
    lines += [
        f"In this posture no joint motion has a part along {_along(name, one, found)}."
        for name, one in stack.tasks.items()
        if one.least_alone < NOTHING
    ]
    for leak in stack.leaks:
        if leak.share > LEAKS:
            lines.append(
                f"Levels leak: {100 * leak.share:.2g} % of the motion that {leak.source} asks for moves {leak.into}."
            )
    if 1.005 < stack.error_growth < math.inf:
        lines.append(
            f"Errors may grow before they decay: by a factor of {stack.error_growth:.3g} in m and rad, of "
            f"{stack.growth:.3g} as weights and levels count them."
        )
    return lines if said.limits is None else [*lines, _sentence(said.limits.words)]


def _unstable(unstable, known) -> str:
    """The gains that make the loop unstable or, if none does, what the largest stable ones assume."""
    *some, last = unstable
    names = f"{', '.join(some)} and {last}" if some else last
    s, are, them = ("s", "are", "them") if some else ("", "is", "it")
    others = f"the other gains unchanged, except for {names}, which {are} then at the recommended gain{s}"
    largest = f" Each largest stable gain holds with {others}." * known
    return f"the gain{s} of {names} {are} too large. Lower {them} first.{largest}"


def walls_of(said) -> list:
    """Rows of WALL_COLUMNS: distance of each wall at rest, its rate, and how far a step may pass it."""
    rows = []
    for name, one in said.walls.items():
        away = f"{aloud(abs(one.distance), one.unit)}{' behind it' * (one.distance < 0)}"
        passed = aloud(one.passed if one.passed >= 1e-9 else 0.0, one.unit) if one.passed == one.passed else ""
        rows.append((name, away, f"{one.rate:.4g}", f"{one.z:.4g}", passed))
    return rows


def _conflict(name, one, found) -> str:
    """In which direction a task yields, and to which."""
    return (
        f"{name} yields to {one.yields_to}: along {_along(name, one, found)} it gets {100 * one.least:.2g} % of the "
        f"motion that it asks for, and would get {100 * one.least_alone:.3g} % alone."
    )


def _along(name, one, found) -> str:
    """The coordinates that make up the worst direction of a task."""
    names, size = found.law.task.names[found.law.task.of(name)], np.abs(one.direction)
    return " and ".join(names[i] for i in np.argsort(-size)[:2] if size[i] > 0.3)


def _present(written) -> str:
    """Name of the present gain in the table: "default" where the user gave none."""
    return "default" if unless_given(written, "alpha") else "yours"


def or_any(value) -> str:
    return "none" if value == 0 else f"{value:.4g}" if value < math.inf else "any"


def _margin(now, said, drive, Ts) -> str:
    """The rest of a sentence about the present gain: whether it is stable, and its margins."""
    own, assumed = said.now, said.assumed_dead_time is not None
    if now.margin <= 1:
        most = f"multiplied by at most {now.margin:.4g} it is stable; " if exact(drive) else ""
        return f"is UNSTABLE: {most}{now.limit}."
    if own is None:
        return "is UNSTABLE on the assumed drives; it is stable only with drives that have no delay."
    margin, room = own.gain_margin if assumed else now.margin, []
    if exact(drive):
        room.append(
            "any larger gain is stable, too" if margin == math.inf else f"it may grow by a factor of {margin:.4g}"
        )
    if own.delay_margin < math.inf:
        room.append(f"the dead time may grow by {in_samples(own.delay_margin, Ts)}")
    on = " on the assumed drives" if assumed else "" if exact(drive) else " with drives exactly as given"
    stable = ": ".join(filter(None, (f"is stable{on}", ", or ".join(room))))
    over = (
        f"a step overshoots by {100 * own.overshoot:.2g} % (ζ = {own.damping_ratio:.2g})"
        if own.overshoot > 1e-3
        else "a step does not overshoot"
    )
    if assumed:
        return f"{stable}. {_sentence(over)}"
    return f"{stable}. Each step leaves {100 * now.radius:.4g} % of an error; {over}. {_sentence(now.limit)}"


def _sentence(words) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _costs(said, found) -> list:
    """Sentences about the loop with the recommended gain."""
    gain, Ts, drive, chain = said.recommended, found.Ts, found.drive, found.law.chain
    late = "any dead time" if gain.delay_margin == math.inf else f"{in_samples(gain.delay_margin, Ts)} more dead time"
    within = f"settles to within 2 % in {gain.settling_time:.3g} s"
    settles = within if gain.settling_time < math.inf else "does not settle to within 2 % in the simulated time"
    more = "any gain" if gain.gain_margin == math.inf else f"{gain.gain_margin:.3g} times this gain"
    stays = f"The loop stays stable with {late}, or with {more}."
    if not exact(drive):
        stays = f"With drives exactly as given the loop stays stable with {late}."
    lines = [f"A step {settles}. {stays}"]
    own = drive is not None and drive.feedback == "commanded"
    unit = "mm" if set(chain.units) == {"m"} else "mrad"
    noise = (
        f"Noise: 1 {unit} RMS of measurement noise moves the joints by {gain.noise_gain:.3g} {unit} RMS, and the "
        f"commanded velocities by {gain.velocity_noise_gain:.3g} {unit}/s RMS."
    )
    lines += [] if own else [noise]
    if found.law.task.lengths:
        v, fed = said.speed, gain.lag_fed_forward * said.speed
        lines.append(
            f"At {v:g} m/s the tip lags by {aloud(gain.lag * v, 'm')} without feed-forward. With feed-forward the lag "
            f"is {aloud(fed, 'm')} after a transient of at most {aloud(gain.start_error * v, 'm')}."
        )
        if said.joint_speed == said.joint_speed:
            lines.append(
                f"At the target, a tip velocity of {v:g} m/s in the worst direction needs "
                f"{100 * said.joint_speed:.3g} % of a joint's velocity limit."
            )
    if drive is not None and not own and not drive.ideal:
        late = float(np.max(drive.late_by(Ts)))
        lines.append(
            "With --feedback commanded the drives are outside the loop: alpha may be up to "
            f"{OWN_COMMANDS / Ts:.4g} 1/s without overshoot, the robot follows {1e3 * late:.3g} ms late, and its "
            "steady errors are not corrected."
        )
    return lines


def name_of(found) -> str:
    return f"{found.name}, {loop_of(found)}"


def loop_of(found) -> str:
    return f"{found.method}" + (f", {found.stage}" if found.method.implicit else "")
