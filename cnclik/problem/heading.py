"""The heading of every answer: robot, tip, task, dead time, start and target, with defaults marked."""

import numpy as np

from cnclik.integrate.drive import drive_in_words
from cnclik.law.paths import hold_at
from cnclik.law.reference import aims_of
from cnclik.problem.names import near_singular_start
from cnclik.problem.options import PATH
from cnclik.record import in_words
from cnclik.robot.poses import quaternions


def name_and_tip(name, tip) -> str:
    """Such as "panda, tip flange", also if the name ends with the tip."""
    return ", tip ".join(filter(None, (name.removesuffix(f" {tip}"), tip)))


def robot_and_task(name, tip, task) -> str:
    """Such as "panda, tip flange, task x y z rx ry rz", or "baxter, tasks hands, rest"."""
    if task.tasks:
        return f"{name}, tasks {', '.join(one for one, _ in task.tasks)}"
    if len(task.targets) > 1:
        each = (f"{' '.join(one.names)} of {path[-1]}" for path, one in task.targets)
        return f"{name}, task {'; '.join(each)}"
    return f"{name_and_tip(name, tip)}, task {' '.join(task.names)}"


def loop_in_words(made, written) -> str:
    """Method, stage, inverse, gain and gain per step, such as "CN by picard(5), damped, alpha = 5 1/s, z = 0.05"."""
    stage = f" by {made.stage}" * made.method.implicit
    head = f"{made.method}{stage}, {type(made.law.inverse).__name__.lower()}"
    if made.tables is not None:  # the line of each task has its gain
        return head
    gain = np.asarray(made.law.alpha, float)
    alpha, z = (in_words(v).removesuffix(".") for v in (gain, gain * made.Ts))
    return f"{head}, alpha = {alpha} 1/s{unless_given(written, 'alpha')}, z = alpha·Ts = {z}"


def unless_given(written, *names) -> str:
    """The text " (default)" if none of the options was given. Args: written: names of the given ones."""
    return "" if any(name in written for name in names) else " (default)"


def drive_words(made) -> str:
    """The drives of a problem in words, such as "2 samples (20 ms) of dead time", or that no dead time was given."""
    return "no dead time given" if made.drive is None else drive_in_words(made.drive, made.Ts)


def start_and_target(made, given: dict) -> list:
    """Sentences: the joint values at the start, the first point of the path, and the tasks of a stack; and where it is
    so, that the start is near a singularity.

    Args: given: the options that the user gave, {name: value}.
    """
    units = ", ".join(dict.fromkeys(made.law.chain.units))
    named = any(given.get(name) is not None for name in PATH) or str(given.get("reference")).lower().endswith(".csv")
    begins = " (on the path)" if given.get("begin") == "on-path" else "" if "q0" in given else " (default)"
    law, begun = made.law, [f"Start: q0 = {in_words(made.q0)} {units}{begins}."]
    begun += filter(None, [near_singular_start(law.chain, law.task, made.q0, float(law.near_singular))])
    if made.tables is not None:
        return [*begun, *(f"{_of_stack(made, name, table)}." for name, table in made.tables.items())]
    return [*begun, f"{_first_point(made, given.get('reference', 'hold'), '' if named else ' (default)')}."]


def _of_stack(made, name, table) -> str:
    """A task of a stack in words: its tips, level, gain and path."""
    law, own = made.law, made.law.task.alone(name)
    tips = " and ".join(path[-1] for path, _ in own.targets)
    what = f"{own.m} joint{'s' * (own.m > 1)}" if tips == "joints" else f"{' '.join(own.targets[0][1].names)} of {tips}"
    alpha = np.asarray(law.alpha, float)
    alpha = alpha if alpha.ndim == 0 else alpha[law.task.of(name)]
    alpha, z = (in_words(v[0] if v.ndim == 1 and np.ptp(v) == 0 else v) for v in (alpha, alpha * made.Ts))
    gain = f"alpha = {alpha.removesuffix('.')} 1/s{'' if 'alpha' in table else ' (of all)'}, z = {z.removesuffix('.')}"
    paths = "; ".join(_path_of_stack(made, name, one) for one in own.targets)
    paths += "" if {"reference", *PATH} & set(table) else " (default)"
    return f"{name}: {what}{_level_of(law, name)}; {gain}; {paths}"


def _level_of(law, name) -> str:
    """The level of a task of a stack, such as ", level 1 of 2 (Damped, λ = 0.001)"; "" without levels."""
    if not hasattr(law.inverse, "names"):
        return ""
    level = next(i for i, names in enumerate(law.inverse.names) if name in names)
    one = law.inverse.damping[level]
    return f", level {level + 1} of {len(law.inverse.names)} ({type(one).__name__}, λ = {float(one.damping):g})"


def _path_of_stack(made, name, target) -> str:
    """A path of a stack's task, such as "circle from 0.7 0.9 -0.05 m"."""
    path, parts = target
    one = made.reference[name]
    one = one if hasattr(one, "curve") else one[path[-1]]
    kind, aim = type(one.curve).__name__.lower(), np.asarray(aims_of(one, parts, 0.0)[0], float)
    if parts.parts[0].turns or len(aim) > 3:
        return kind
    return f"{kind} from {' '.join(f'{v:.4g}' for v in aim)} {', '.join(dict.fromkeys(parts.units))}"


def _first_point(made, name, default) -> str:
    task, said, away = made.law.task, [], ""
    first, here = (aims_of(r, task, 0.0) for r in (made.reference, hold_at(made.law.chain, task, made.q0)))
    for part, aim, own in zip(task.parts, first, here, strict=True):
        values = np.array(quaternions(np.array(aim, float)) if part.turns else aim, float)
        names, unit = ("quaternion w x y z", "") if part.turns else (" ".join(part.names), f" {part.units[0]}")
        said.append(f"{names} = {' '.join(f'{v:.5g}' for v in values)}{unit}")
        jump = 0.0 if part.turns else float(np.linalg.norm(values - own))
        if jump > 1e-3:
            away = f"; the start is {1e3 * jump:.3g} mm away from it (--begin on-path begins there)"
    if name == "hold":
        return f"Target {', '.join(said)}{default}"
    return f"Path {name}, from {', '.join(said)}{default}{away}"
