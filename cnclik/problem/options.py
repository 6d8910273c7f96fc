"""The options of a problem: for each name its kind, help, default and unit.

The command line, sweep files and Python share this table. To add an option, add a line here and use it where the
problem is built (`build.py`).
"""

from typing import Any, NamedTuple

from cnclik import errors
from cnclik.problem import words
from cnclik.quantities import SAMPLES, read_each

NAME, NAMES, NUMBER, NUMBERS, INTEGER, TABLES = "name", "names", "number", "numbers", "integer", "tables"


class Option(NamedTuple):
    """One option of a problem."""

    kind: str  # NAME, NAMES, NUMBER, NUMBERS, INTEGER or TABLES
    help: str
    default: Any = None
    unit: str = "1"  # or "q": unit of the joints; "J", "x": unit of a singular value, a point
    must: str = ""  # condition on each number: a key of `_FITS`


def _listed(names) -> str:
    return ", ".join(names)


def _of(option: str) -> str:
    """The references that take an option, as the beginning of its help."""
    return " and ".join(name for name, choice in words.REFERENCES.items() if option in choice.options)


OPTIONS = {
    "robot": Option(NAME, f"A URDF or MJCF file; {_listed(n for n, one in words.ROBOTS.items() if not one.needs)}; "
                    "planar:1,1,1 (link lengths in m); or a name of robot_descriptions."),
    "tip": Option(NAME, "Last link of the chain. Required where the file has several (`cnclik robots FILE` lists "
                  "them)."),
    "base": Option(NAME, "First link of the chain (default: the root of the file), or a moving base: planar or free."),
    "lengths": Option(NUMBERS, "Link lengths of planar and planar-clockwise [m].", unit="m", must="at least 0"),
    "task": Option(NAME, f"What to control: {_listed(words.TASKS)}, or coordinates such as xy or xyrz. Default: pose "
                   "where the robot has enough joints for it."),
    "stack": Option(NAME, "FILE.toml with several tasks, each with its tip, gain, level and path; replaces --task, "
                    "--tip and --reference."),
    "reference": Option(NAME, f"The target's path: {_listed(words.REFERENCES)}, or FILE.csv with waypoints (time, "
                        "position, optional quaternion w x y z).", "hold"),
    "target": Option(NUMBERS, f"{_of('target')}: the target position [m]; for a pose, optionally a quaternion "
                     "w x y z after it.", unit="x"),
    "from": Option(NUMBERS, f"{_of('from')}: first point; default: the tip's position at q0.", unit="x"),
    "to": Option(NUMBERS, f"{_of('to')}: last point.", unit="x"),
    "center": Option(NUMBERS, f"{_of('center')}: centre [m].", unit="x"),
    "radius": Option(NUMBER, f"{_of('radius')}: radius [m].", unit="m", must="positive"),
    "normal": Option(NUMBERS, f"{_of('normal')}: normal vector of the circle's plane; default: z."),
    "amplitude": Option(NUMBERS, f"{_of('amplitude')}: amplitude [m], one number or one per axis.", unit="m"),
    "frequency": Option(NUMBERS, f"{_of('frequency')}: cycles per period, one per axis."),
    "phase": Option(NUMBERS, f"{_of('phase')}: angle at t = 0 [rad]; lissajous takes one per axis.", unit="rad"),
    "period": Option(NUMBER, "Duration of one turn (negative: opposite direction) or of the line [s]; default: the "
                     "duration of the run.", unit="s", must="other than 0"),
    "future": Option(NAME, "Whether the controller knows the path ahead (known) or only the target's position and "
                     "velocity at the start of each step (unknown).", "known"),
    "method": Option(NAME, f"How a step is integrated: {_listed(words.METHODS)}. CN is the paper's method.",
                     "EXP-MIDPOINT"),
    "stage": Option(NAME, f"Iteration that solves an implicit step: {_listed(words.STAGES)}.", "picard"),
    "M": Option(INTEGER, "Number of iterations per implicit step.", 5, must="at least 0"),
    "alpha": Option(NUMBERS, "Gain [1/s], one number or one per task coordinate. alpha·Ts is the dimensionless gain "
                    "per step.", 5.0, "1/s", must="at least 0"),
    "Ts": Option(NUMBER, "Sampling time [s], or with a unit as in 4ms.", 0.01, "s", must="positive"),
    "N": Option(INTEGER, "Number of steps.", 1000),
    "inverse": Option(NAME, f"Inverse of the Jacobian: {_listed(words.INVERSES)}. Default: pseudoinverse, or damped "
                      "where --damping is given."),
    "damping": Option(NUMBER, "Damping λ (not λ²) of the damped inverses.", unit="J", must="positive"),
    "threshold": Option(NUMBER, "singular-damped: least singular value of the Jacobian below which the inverse is "
                        "damped.", unit="J", must="positive"),
    "limits": Option(NAME, f"How joint limits are respected: {_listed(words.LIMITS)}.", "none"),
    "limit_rate": Option(NUMBER, "bounded: rate at which a joint may approach its limit [1/s]; default: 1/Ts, at most "
                         "10.", unit="1/s", must="positive"),
    "error_clamp": Option(NUMBERS, "Limits of the position [m] and orientation [rad] error that the gain multiplies. "
                          "They keep joint velocities small when the target is far away.", unit="m, rad",
                          must="positive"),
    "feedforward": Option(NUMBER, "Factor of the target's velocity: 1 is full feed-forward (default), 0 pure "
                          "feedback."),
    "near_singular": Option(NUMBER, "Least singular value below which a step is reported as near-singular; default: "
                            "0.01.", unit="J"),
    "posture": Option(NUMBERS, "Preferred joint values, approached in the null space [rad, m].", unit="q"),
    "posture_rate": Option(NUMBER, "Rate at which the posture is approached [1/s]; default: 1.", unit="1/s",
                           must="positive"),
    "q0": Option(NUMBERS, "Joint values at the start [rad, m]; default: a posture within the limits and away from "
                 "singularities.", unit="q"),
    "begin": Option(NAME, "Where the loop starts: at q0, or on-path, at the path's first point with the joint values "
                    "nearest to q0.", "q0"),
}  # fmt: skip

DRIVE = {  # what lies between a command and its measured motion: fields of `Drive`
    "delay": Option(NUMBER, "Dead time between command and motion [samples]. Fractions are allowed; a time is written "
                    "with its unit, as in 34ms.", unit=SAMPLES, must="at least 0"),
    "measurement_delay": Option(INTEGER, "Delay of the measurement [whole samples]; measurements are time-stamped.",
                                unit=SAMPLES, must="at least 0"),
    "lag": Option(NUMBERS, "Time constant of a first-order drive [s], one number or one per joint.", unit="s",
                  must="positive"),
    "natural_frequency": Option(NUMBERS, "Natural frequency ω₀ of a second-order drive [rad/s], in place of --lag; "
                                "√(k_p/m) of a position servo.", unit="rad/s", must="positive"),
    "damping_ratio": Option(NUMBERS, "Damping ratio ζ of a second-order drive; k_v/(2 m ω₀) of a position servo. "
                            "Default: 1.", must="positive"),
    "command": Option(NAME, f"Command that the drives take: {_listed(words.COMMANDS)}. Default: velocity."),
    "feedback": Option(NAME, f"Joint values that the controller uses: {_listed(words.FEEDBACKS)}. With rebased they "
                       "are measured, and each position command starts from them. Default: measured."),
    "smoothing": Option(NUMBER, "Low-pass filter (also --filter): the share of the old value that a moving average "
                        "keeps, from 0 to below 1.", must="at least 0"),
    "cutoff": Option(NUMBER, "Cut-off frequency of the filter [Hz], in place of --smoothing.", unit="Hz",
                     must="positive"),
    "smoothed": Option(NAME, f"Signal that the filter smooths: {_listed(words.SMOOTHED)}. Default: error."),
}  # fmt: skip
NOISE = {
    "noise": Option(NUMBERS, "Standard deviation of white noise in the measured error [m, rad], one number or one per "
                    "task coordinate.", unit="m, rad", must="at least 0"),
    "seed": Option(INTEGER, "Seed of the random numbers; default: 0.", must="at least 0"),
}  # fmt: skip
MEASURED = DRIVE | NOISE  # what a robot adds to a loop
SWEPT = OPTIONS | MEASURED

DEFAULTS = {name: option.default for name, option in OPTIONS.items() if option.default is not None}
PATH = tuple(dict.fromkeys(option for choice in words.REFERENCES.values() for option in choice.options))

OF_TASK = {  # one task of a stack: a table in the stack's file
    "task": Option(NAME, f"What to control: {_listed(words.STACKED)}, or coordinates such as xy or xyrz. Default: pose "
                   "where the tip has enough joints for it, joints where `joints` is given."),
    "tip": Option(NAMES, "The tip; several names make the same task for each."),
    "relative_to": Option(NAME, "Tip in whose frame the task is expressed, and relative to which it moves; default: "
                          "the base."),
    "joints": Option(NAMES, "joints: names of the joints; default: all."),
    "axes": Option(NAME, "center_of_mass: letters of xyz, such as xy for balance; default: all."),
    "weights": Option(NUMBERS, "Least-squares weights: one, or one per coordinate (of each tip).", must="positive"),
    "alpha": OPTIONS["alpha"]._replace(default=None),
    "level": Option(INTEGER, "Priority level: 1 comes first. Tasks on the same level share the joints by weighted "
                    "least squares.", must="positive"),
    **{name: OPTIONS[name] for name in ("inverse", "damping", "threshold")},
    **{name: OPTIONS[name] for name in ("reference", *PATH)},
}  # fmt: skip

OF_WALL = {  # one wall of a stack: a table in the stack's file
    "task": OF_TASK["task"]._replace(help="Coordinates of the tip that stay on one side, such as z, or joints."),
    **{name: OF_TASK[name] for name in ("tip", "relative_to", "joints", "axes")},
    "distance": Option(TABLES, "In place of a task: two shapes (tables of `OF_SHAPE`) whose distance is bounded."),
    "corners": Option(NUMBERS, "In place of a task: x y of corners of the feet [m], in the base's or `relative_to`'s "
                      "frame; the centre of mass stays above their convex hull.", unit="m"),
    "normal": Option(NUMBERS, "For several coordinates x: the wall bounds normal·x."),
    "above": Option(NUMBER, "Lower bound of the coordinate [rad, m]; default for a distance: 0.", unit="q"),
    "below": Option(NUMBER, "Upper bound of the coordinate [rad, m].", unit="q"),
    "margin": Option(NUMBER, "Additional distance from the bound [rad, m].", unit="q", must="at least 0"),
    "rate": Option(NUMBER, "Rate at which the wall may be approached [1/s]; default: --limit-rate.", unit="1/s",
                   must="positive"),
}  # fmt: skip
OF_SHAPE = {  # a point, a sphere, a capsule, or a half-space
    "tip": Option(NAME, "Tip that carries the shape; without one it is fixed in the base frame."),
    "radius": Option(NUMBER, "Sphere or capsule: radius [m]; default: 0.", unit="m", must="at least 0"),
    "center": Option(NUMBERS, "Sphere: centre in the tip's frame [m]; default: 0 0 0.", unit="m"),
    "from": Option(NUMBERS, "Capsule: first end of its segment in the tip's frame [m].", unit="m"),
    "to": Option(NUMBERS, "Capsule: second end of its segment in the tip's frame [m].", unit="m"),
    "normal": Option(NUMBERS, "Half-space: normal vector; its points p have normal·p below the offset."),
    "offset": Option(NUMBER, "Half-space: offset along the unit normal [m]; default: 0.", unit="m"),
}  # fmt: skip

OF_STACK = {"tasks": OF_TASK, "walls": OF_WALL}

_FITS = {"positive": lambda v: v > 0, "at least 0": lambda v: v >= 0, "other than 0": lambda v: v != 0}


def check_values(where: str, name: str, values) -> None:
    """Raise ArgumentError unless the option may have all numbers of an array."""
    must = SWEPT[name].must if name in SWEPT else ""
    if must and (wrong := ~_FITS[must](values)).any():
        raise errors.fail(where, f"hold values that are {must}", f"holds {values[wrong][0]:g}")


def in_own_units(given: dict, options=SWEPT) -> tuple:
    """({option: value}, {option: the unit of each number}); texts such as "34ms" become numbers in the option's unit.

    A list may hold texts, too.

    Args: options: {name: Option} that they belong to.
    Raises: ArgumentError for a text that holds no such numbers, or no unit.
    """
    made, written = dict(given), {}
    texts = [name for name, value in given.items() if _written(value, options[name].kind)]
    for name in sorted(texts, key=lambda name: options[name].unit == SAMPLES):  # samples last: they need Ts
        Ts, alone = made.get("Ts", DEFAULTS["Ts"]), isinstance(given[name], str)
        if options[name].unit == SAMPLES and not errors.concrete(errors.number("Ts", Ts, positive=True)):
            raise errors.fail(name, "be in samples where `Ts` is traced", f"is {given[name]!r}")
        try:
            found = read_each([given[name]] if alone else given[name], options[name].unit, Ts)
        except ValueError as error:
            each = ", a list of numbers" * (options[name].kind == NUMBERS)
            raise errors.fail(name, f"be a number{each}, or a text of numbers with their unit", str(error)) from None
        written[name] = found.written
        if (whole := options[name].kind == INTEGER) and not found[0].is_integer():
            raise errors.fail(name, "be an integer", f"is {given[name]!r}, {found[0]:g} {options[name].unit}")
        made[name] = list(found) if len(found) > 1 or not alone else int(found[0]) if whole else found[0]
    return made, written


def _written(value, kind) -> bool:
    """Whether the numbers of an option are given as a text, or as a list that holds one."""
    if kind in (NAME, NAMES, TABLES):
        return False
    several = kind == NUMBERS and isinstance(value, (list, tuple))
    return isinstance(value, str) or (several and any(isinstance(v, str) for v in value))


def units(law, task, width=None) -> dict:
    """{option: unit} for a law's joints and a task, the law's own or one of its stack.

    Args:
      width: number of values of a point; those after the position are a quaternion's, without unit.
    """
    length = bool(task.lengths)
    point = ["m"] if length else []
    if not point or (task.angles and (width or 0) > 3):
        point.append("1")
    known = {"q": ", ".join(dict.fromkeys(law.chain.units)), "J": "m" if length else "1", "x": ", ".join(point)}
    known |= {
        f"q/{time}": ", ".join(f"{u}/{time}" for u in dict.fromkeys(law.chain.units)) for time in ("s", "s²", "s³")
    }
    return {name: known.get(option.unit, option.unit) for name, option in SWEPT.items() if option.kind != NAME}
