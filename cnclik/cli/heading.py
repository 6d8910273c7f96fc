"""Heading: what was asked, above every answer: robot, tip, task, dead time, start and target; defaults are named."""

from cnclik.problem.options import PATH
from cnclik.quantities import in_samples


def name_and_tip(name, tip) -> str:
    """Such as "panda, tip flange", also where the name has the tip."""
    return ", tip ".join(filter(None, (name.removesuffix(f" {tip}"), tip)))


def robot_and_task(name, tip, task) -> str:
    """Such as "panda, tip flange, task x y z rx ry rz"."""
    return f"{name_and_tip(name, tip)}, task {' '.join(task.names)}"


def unless_given(written, *names) -> str:
    """The word " (default)" where none of the options was written. Args: written: names of those that were."""
    return "" if any(name in written for name in names) else " (default)"


def assumed_drives(made) -> list:
    """A sentence about drives of which nothing but dead time was given."""
    from cnclik.integrate.drive import Drive
    from cnclik.stability.recommend import assumed_of

    said = assumed_of(made.drive or Drive(), made.Ts)
    measure = (
        "A lag asks for a smaller gain: measure it with `cnclik diagnose LOG.csv --step`, which prints the options"
    )
    return [f"{said} {measure} to give here."] if said else []


def dead_time(made) -> str:
    """The dead time of a problem in samples and ms, or that none was given."""
    if made.drive is None or not made.drive.lumped.delay:
        return "no dead time" + " given" * (made.drive is None)
    late = f"dead time {in_samples(made.drive.delay, made.Ts)}"
    measured = made.drive.measurement_delay
    return late + (f", and of the measurement {in_samples(measured, made.Ts)}" if measured else "")


def start_and_target(made, given: dict) -> list:
    """Two sentences: the joint values that the loop begins with, and where its path begins.

    Args: given: what the user gave, as `cnclik.cli.problem.table` has it.
    """
    from cnclik.record import in_words

    units = ", ".join(dict.fromkeys(made.law.chain.units))
    named = any(given.get(name) is not None for name in PATH) or str(given.get("reference")).lower().endswith(".csv")
    begins = " (on the path)" if given.get("begin") == "on-path" else "" if "q0" in given else " (default)"
    return [
        f"Start: q0 = {in_words(made.q0)} {units}{begins}.",
        f"{_first_point(made, given.get('reference', 'hold'), '' if named else ' (default)')}.",
    ]


def _first_point(made, name, default) -> str:
    import numpy as np

    from cnclik.law.paths import hold_at
    from cnclik.law.reference import aims_of
    from cnclik.robot.poses import quaternions

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
