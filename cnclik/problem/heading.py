"""The heading of every answer: robot, tip, task, dead time, start and target, with defaults marked."""

import numpy as np

from cnclik.integrate.drive import drive_in_words
from cnclik.law.paths import hold_at
from cnclik.law.reference import aims_of
from cnclik.problem.reference import OPTIONS
from cnclik.quantities import aloud
from cnclik.record import in_words
from cnclik.robot.poses import quaternions


def robot_and_task(name, tip, task) -> str:
    """Such as "panda, tip flange, task x y z rx ry rz", or "two_arms, tasks hands, rest"."""
    if task.tasks:
        return f"{name}, tasks {', '.join(one for one, _ in task.tasks)}"
    if len(task.targets) > 1:
        each = (f"{' '.join(one.names)} of {path[-1]}" for path, one in task.targets)
        return f"{name}, task {'; '.join(each)}"
    robot = ", tip ".join(filter(None, (name.removesuffix(f" {tip}"), tip)))  # a name may end with the tip
    return f"{robot}, task {' '.join(task.names)}"


def loop_in_words(made) -> str:
    """Method, stage, inverse, gain, gain per step and drive, such as "CN by picard(5), damped, alpha = 5 1/s, …"."""
    stage = f" by {made.stage}" * made.method.implicit
    words = [f"{made.method}{stage}", type(made.law.inverse).__name__.lower()]
    if not made.law.task.tasks:  # the line of each task has its gain
        words += _gain(made, np.asarray(made.law.alpha, float), "alpha" in made.given)
    return ", ".join([*words, "no dead time given" if made.drive is None else drive_in_words(made.drive, made.Ts)])


def _gain(made, alpha, given=True) -> list:
    alpha = alpha[0] if alpha.ndim == 1 and np.ptp(alpha) == 0 else alpha
    value, z = (in_words(v).removesuffix(".") for v in (alpha, alpha * made.Ts))
    return [f"alpha = {value} 1/s{' (default)' * (not given)}", f"z = alpha·Ts = {z}"]


def start_and_target(made) -> list:
    """Sentences: the joint values at the start, and where the paths begin."""
    units = ", ".join(dict.fromkeys(made.law.chain.units))
    begins = "" if "q0" in made.given else " (default)"
    begins = " (on the path)" if "begin" in made.given else begins
    lines = [f"Start: q0 = {in_words(made.q0)} {units}{begins}."]
    if made.law.task.tasks:
        return lines + [f"{_of_stack(made, name)}." for name, _ in made.law.task.tasks]
    if len(made.law.task.targets) > 1:
        return lines
    return [*lines, f"{_first_point(made)}."]


def _of_stack(made, name) -> str:
    """A task of a stack in words: its coordinates, level and gain."""
    law, own = made.law, made.law.task.alone(name)
    tips = " and ".join(path[-1] for path, _ in own.targets)
    what = f"{own.m} joint{'s' * (own.m > 1)}" if tips == "joints" else f"{' '.join(own.targets[0][1].names)} of {tips}"
    level = next((i for i, names in enumerate(getattr(law.inverse, "names", ())) if name in names), None)
    if level is not None:
        one = law.inverse.damping[level]
        what += f", level {level + 1} of {len(law.inverse.names)} ({type(one).__name__}, λ = {float(one.damping):g})"
    alpha = np.broadcast_to(np.asarray(law.alpha, float), (law.task.m,))[law.task.of(name)]
    return f"{name}: {what}; {', '.join(_gain(made, alpha))}"


def _first_point(made) -> str:
    task, said, away = made.law.task, [], ""
    first, here = (aims_of(r, task, 0.0) for r in (made.reference, hold_at(made.law.chain, task, made.q0)))
    for part, aim, own in zip(task.parts, first, here, strict=True):
        turns = getattr(part, "turns", False)
        values = np.array(quaternions(np.array(aim, float)) if turns else aim, float)
        units = ", ".join(dict.fromkeys(part.units))
        names, unit = ("quaternion w x y z", "") if turns else (" ".join(part.names), f" {units}")
        said.append(f"{names} = {' '.join(f'{v:.5g}' for v in values)}{unit}")
        jump = float(np.linalg.norm(values - own)) if units == "m" else 0.0
        if jump > 1e-3:
            away = f"; the start is {aloud(jump, 'm')} away from it"
    default = "" if {"reference", *OPTIONS} & made.given else " (default)"
    if made.reference.still:
        return f"Target {', '.join(said)}{default}"
    return f"Path {type(made.reference.curve).__name__.lower()}, from {', '.join(said)}{default}{away}"
