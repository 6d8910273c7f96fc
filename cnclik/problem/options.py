"""Options: every name that a problem has, what it holds, and its default.

The command line, sweep files and Python share this table; to add an option, add its line here and where it is
built.
"""

from typing import Any, NamedTuple

from cnclik import errors
from cnclik.problem.words import (
    BEGINS,
    COMMANDS,
    FEEDBACKS,
    FRAMES,
    FUTURES,
    INVERSES,
    LIMITS,
    METHODS,
    REFERENCES,
    ROBOTS,
    STACKED,
    STAGES,
    TASKS,
)
from cnclik.quantities import SAMPLES, read_each

NAME, NAMES, NUMBER, NUMBERS, INTEGER = "name", "names", "number", "numbers", "integer"


class Option(NamedTuple):
    """One option of a problem."""

    kind: str  # NAME, NAMES, NUMBER, NUMBERS or INTEGER
    help: str
    default: Any = None
    unit: str = "1"  # "q": that of the joints; "J", "w", "x": of a singular value, threshold, point
    must: str = ""  # what each of its numbers must be: a key of `_FITS`


def _listed(names) -> str:
    return ", ".join(names)


def _of(option: str) -> str:
    """The references that take an option: what its help begins with."""
    return " and ".join(name for name, choice in REFERENCES.items() if option in choice.options)


OPTIONS = {
    "robot": Option(NAME, f"A URDF or MJCF file, {_listed(n for n in ROBOTS if not ROBOTS[n].needs)}, planar:1,1,1 "
                    "(link lengths in m), or a name of robot_descriptions."),
    "tip": Option(NAME, "Last link of the chain in a file; needed where it has several (`cnclik robots FILE` lists "
                  "them)."),
    "base": Option(NAME, "First link of the chain in a file; the root by default."),
    "lengths": Option(NUMBERS, "Link lengths of planar and planar-clockwise [m].", unit="m", must="at least 0"),
    "task": Option(NAME, f"{_listed(TASKS)}, or coordinates such as xy or xyrz; pose where there are joints enough "
                   "for it."),
    "stack": Option(NAME, "FILE.toml of several tasks, each with its tip, gain, level and path, in place of --task, "
                    "--tip and --reference."),
    "reference": Option(NAME, f"{_listed(REFERENCES)}, or FILE.csv of waypoints: time, position, optional quaternion "
                        "w x y z.", "hold"),
    "target": Option(NUMBERS, f"{_of('target')}: the point, as position [m] and for a pose optionally a quaternion "
                     "w x y z.", unit="x"),
    "from": Option(NUMBERS, f"{_of('from')}: the first point; the tip at q0 by default.", unit="x"),
    "to": Option(NUMBERS, f"{_of('to')}: the last point.", unit="x"),
    "center": Option(NUMBERS, f"{_of('center')}: the centre [m].", unit="x"),
    "radius": Option(NUMBER, f"{_of('radius')}: the radius [m].", unit="m", must="positive"),
    "normal": Option(NUMBERS, f"{_of('normal')}: normal of its plane; z by default."),
    "amplitude": Option(NUMBERS, f"{_of('amplitude')}: amplitude [m], one for all axes or one each.", unit="m"),
    "frequency": Option(NUMBERS, f"{_of('frequency')}: cycles per period, one per axis."),
    "phase": Option(NUMBERS, f"{_of('phase')}: angle at t = 0 [rad]; a lissajous figure has one per axis.",
                    unit="rad"),
    "period": Option(NUMBER, "Time of one turn (negative: the other sense), or of the line [s]; the length of the run "
                     "by default.", unit="s", must="other than 0"),
    "future": Option(NAME, f"Of the path, to a controller: {_listed(FUTURES)}, where a step sees place and velocity "
                     "at its start alone.", "known"),
    "method": Option(NAME, f"{_listed(METHODS)}; CN is the paper's.", "EXP-MIDPOINT"),
    "stage": Option(NAME, f"How implicit stages are solved: {_listed(STAGES)}.", "picard"),
    "M": Option(INTEGER, "Passes of that iteration.", 5, must="at least 0"),
    "alpha": Option(NUMBERS, "Gain of the error [1/s], one or one per task coordinate; alpha·Ts is the dimensionless "
                    "gain per step.", 5.0, "1/s", must="at least 0"),
    "Ts": Option(NUMBER, "Sampling time [s].", 0.01, "s", must="positive"),
    "N": Option(INTEGER, "Steps.", 1000),
    "inverse": Option(NAME, f"{_listed(INVERSES)}; damped where a damping is given."),
    "damping": Option(NUMBER, "λ (not λ²) of the damped inverses.", unit="J", must="positive"),
    "threshold": Option(NUMBER, "Manipulability or least singular value below which the last two are damped.",
                        unit="w", must="positive"),
    "limits": Option(NAME, f"How joint limits are respected: {_listed(LIMITS)}.", "none"),
    "limit_rate": Option(NUMBER, "Of weighted-least-norm, saturation and bounded: rate at which a joint may near "
                         "its limit [1/s]; 1/Ts, at most 10, by default.", unit="1/s", must="positive"),
    "error_clamp": Option(NUMBERS, "Largest position [m] and orientation [rad] error that the gain sees: what settles "
                          "before far targets.", unit="m, rad", must="positive"),
    "feedforward": Option(NUMBER, "Factor of the desired velocity: 1 tracks (default), 0 is pure feedback."),
    "near_singular": Option(NUMBER, "Least singular value under which a step is marked near singular; 0.01 by "
                            "default.", unit="J"),
    "posture": Option(NUMBERS, "Joint values to draw towards in the null space [rad, m].", unit="q"),
    "posture_rate": Option(NUMBER, "Rate at which they are drawn to [1/s]; 1 by default.", unit="1/s", must="positive"),
    "manipulability": Option(NUMBER, "Gain of climbing the manipulability in the null space.", must="positive"),
    "q0": Option(NUMBERS, "Joint values at the start [rad, m]; a posture inside the limits, away from singularities, "
                 "by default.", unit="q"),
    "begin": Option(NAME, f"Where the loop begins: {_listed(BEGINS)}; on-path is where the path begins, with the joint "
                    "values nearest to q0.", "q0"),
}  # fmt: skip

DRIVE = {  # what lies between a command and the motion, and what is measured of it: fields of `Drive`
    "delay": Option(NUMBER, "Dead time between command and motion [samples], not only whole ones; 34ms is a time.",
                    unit=SAMPLES, must="at least 0"),
    "measurement_delay": Option(INTEGER, "Whole samples by which what is measured is late, its time being known.",
                                unit=SAMPLES, must="at least 0"),
    "lag": Option(NUMBERS, "Time constant of a first-order drive [s], one number or one per joint.", unit="s",
                  must="positive"),
    "natural_frequency": Option(NUMBERS, "ω₀ of a second-order drive [rad/s], in place of a lag: √(k_p/m) of a "
                                "position servo.", unit="rad/s", must="positive"),
    "damping_ratio": Option(NUMBERS, "ζ of a second-order drive, 1 by default: k_v/(2 m ω₀) of a position servo.",
                            must="positive"),
    "command": Option(NAME, f"What a drive takes: {_listed(COMMANDS)}; velocity by default."),
    "feedback": Option(NAME, f"Joint values that the controller looks at: {_listed(FEEDBACKS)} (measured, and position "
                       "commands begin there); measured by default."),
    "drive_velocity": Option(NUMBERS, "Joint velocity beyond which the drive doesn't follow [rad/s, m/s].",
                             unit="q/s", must="positive"),
    "drive_acceleration": Option(NUMBERS, "Joint acceleration beyond which the drive doesn't follow [rad/s², m/s²].",
                                 unit="q/s²", must="positive"),
    "joint_noise": Option(NUMBERS, "Standard deviation of measured joint values [rad, m].", unit="q",
                          must="at least 0"),
    "resolution": Option(NUMBERS, "Resolution of measured joint values [rad, m].", unit="q", must="at least 0"),
}  # fmt: skip
NOISE = {
    "noise": Option(NUMBERS, "Standard deviation of white noise of the measured error, one number or one per task "
                    "coordinate [m, rad].", unit="m, rad", must="at least 0"),
    "seed": Option(INTEGER, "Of what is drawn; 0 by default.", must="at least 0"),
}  # fmt: skip
PACE = {  # limits that the loop keeps by going slower along its way: fields of `Pace`
    "max_velocity": Option(NUMBERS, "Joint velocity that the steps are scaled to, one number or one per joint "
                           "[rad/s, m/s]; with the next two the robot's own by default.", unit="q/s", must="positive"),
    "max_acceleration": Option(NUMBERS, "Joint acceleration that they are scaled to [rad/s², m/s²].", unit="q/s²",
                               must="positive"),
    "max_jerk": Option(NUMBERS, "Joint jerk that they are scaled to [rad/s³, m/s³].", unit="q/s³", must="positive"),
}  # fmt: skip
MEASURED = DRIVE | NOISE  # what a robot adds to a loop
SWEPT = OPTIONS | MEASURED | PACE

DEFAULTS = {name: option.default for name, option in OPTIONS.items() if option.default is not None}
PATH = tuple(dict.fromkeys(option for choice in REFERENCES.values() for option in choice.options))

OF_TASK = {  # of one task of a stack: a table of a stack's file
    "task": Option(NAME, f"{_listed(STACKED)}, or coordinates such as xy or xyrz; pose where the tip has joints enough "
                   "for it, joints where those are given."),
    "tip": Option(NAMES, "The tip, or several: then it is the same task for each."),
    "relative_to": Option(NAME, "Tip in whose frame, and as seen from which, the task is; the base by default."),
    "frame": Option(NAME, f"Whose axes its coordinates are along: {_listed(FRAMES)}, the tip's own; base by default."),
    "joints": Option(NAMES, "Of joints: their names; all by default."),
    "axes": Option(NAME, "Of center_of_mass: letters of xyz, such as xy for balance; all by default."),
    "weights": Option(NUMBERS, "Weights of its coordinates in the least-squares sense, one each (for each tip).",
                      must="positive"),
    "alpha": OPTIONS["alpha"]._replace(default=None),
    "level": Option(INTEGER, "Its level of priority: 1 comes first, tasks of equal numbers share what there is.",
                    must="positive"),
    **{name: OPTIONS[name] for name in ("inverse", "damping", "threshold")},
    **{name: OPTIONS[name] for name in ("reference", *PATH)},
}  # fmt: skip

_FITS = {"positive": lambda v: v > 0, "at least 0": lambda v: v >= 0, "other than 0": lambda v: v != 0}


def check_values(where: str, name: str, values) -> None:
    """Raise ArgumentError unless all numbers of an array are ones that the option may have."""
    must = SWEPT[name].must if name in SWEPT else ""
    if must and (wrong := ~_FITS[must](values)).any():
        raise errors.fail(where, f"hold values that are {must}", f"holds {values[wrong][0]:g}")


def in_own_units(given: dict, options=SWEPT) -> tuple:
    """({option: value} with texts such as "34ms" as numbers in the option's own unit, {option: the units of each}).

    A list may hold texts, too.

    Args: options: {name: Option} of which they are.
    Raises: ArgumentError for a text that is no such numbers, or has no unit.
    """
    made, written = dict(given), {}
    texts = [name for name, value in given.items() if _written(value, options[name].kind)]
    for name in sorted(texts, key=lambda name: options[name].unit == SAMPLES):  # once the sampling time is known
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
    """Whether an option of numbers is given as a text, or, where it may be several, as a list that holds one."""
    if kind in (NAME, NAMES):
        return False
    several = kind == NUMBERS and isinstance(value, (list, tuple))
    return isinstance(value, str) or (several and any(isinstance(v, str) for v in value))


def units(law, width=None) -> dict:
    """{option: unit} for a law's task and joints.

    Args:
      width: numbers of a point; beyond a position they are a quaternion's, without unit.
    """
    from cnclik.law.inverse import ManipulabilityDamped  # here: the table itself is read without JAX

    power = len(law.task.lengths)
    point = ["m"] if power else []
    if not point or (law.task.angles and (width or 0) > 3):
        point.append("1")
    known = {"q": ", ".join(dict.fromkeys(law.chain.units)), "J": "m" if power else "1", "x": ", ".join(point)}
    known["w"] = known["J"]
    known |= {
        f"q/{time}": ", ".join(f"{u}/{time}" for u in dict.fromkeys(law.chain.units)) for time in ("s", "s²", "s³")
    }
    if isinstance(law.inverse, ManipulabilityDamped) and power > 1:
        known["w"] = f"m^{power}"
    return {name: known.get(option.unit, option.unit) for name, option in SWEPT.items() if option.kind != NAME}
