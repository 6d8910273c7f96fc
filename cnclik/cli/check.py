"""`cnclik check`: which limits a log of joint values breaks, and what is wrong with its rows."""

import sys
from pathlib import Path

from cnclik import errors
from cnclik.cli.common import print_json
from cnclik.cli.log import read

TAKES = ("log",)


def run(
    log: str,
    robot: str | None = None,
    *,
    tip: str | None = None,
    limits: str | None = None,
    resolution: float = 0.0,
    json: bool = False,
    **columns,
) -> None:
    """Print one table; exit with code 1 if a limit is broken.

    Args:
      robot: a URDF or MJCF file or a built-in robot: for its limits of position and velocity, and how far its tip
        strays.
      tip: the tip, where the robot has several.
      limits: limits of velocity, acceleration and jerk: published ones (panda, fr3), or FILE.csv, a table with columns
        of these names and a row for each joint.
      resolution: resolution of the encoders [rad, m].
    """
    from cnclik.diagnosis.check import PUBLISHED, check_log

    recorded, chain = read(log, **columns), None
    if robot is not None:
        from cnclik.problem.names import load

        chain = load(robot, tip)
        motion = recorded.motion  # joints of that name, too, such as index_1 at rest, which may be a counter elsewhere
        recorded.motion = [i for i, name in enumerate(recorded.names) if i in motion or name in chain.joint_names]
    elif tip is not None:
        raise errors.fail("tip", "come with ROBOT", "comes without")
    limits = limits or (robot if robot in PUBLISHED else None)
    if limits is not None and Path(limits).suffix.lower() != ".csv":  # a robot's file comes after LOG
        errors.one_of("limits", limits, (*PUBLISHED, "FILE.csv"))
    own, table = _table(limits)
    joints = own if chain is None else [*chain.joint_names]
    if sorted(own) == sorted(joints):
        table = table | {what: [values[own.index(joint)] for joint in joints] for what, values in table.items()}
    places, sent = recorded.moved(), [] if recorded.chosen else recorded.pairs()[0]
    places, sent = (_in_order(some, recorded.names, joints) for some in (places, sent))
    whole = recorded.columns([*places, *sent])
    q, command = whole[:, : len(places)], whole[:, len(places) :] if sent else None
    t, names = None if recorded.t is None else recorded.t[: len(q)], [recorded.names[i] for i in (*places, *sent)]
    with errors.called("q", "LOG"), errors.called("t", recorded.stamps.partition(",")[0]):
        units = ["m" if recorded.lengths[i] else "rad" for i in places] if chain is None else None
        answer = check_log(
            t,
            q,
            Ts=recorded.Ts,
            limits=table,
            chain=chain,
            command=command,
            resolution=resolution,
            names=names,
            units=units,
        )
    if json:
        findings = {"findings": answer.findings, "broken": len(answer.broken)}
        print_json(findings | {"Ts": answer.Ts, "Ts_from": recorded.stamps, "rows": answer.rows})
    else:
        print(f"{answer}\n{answer.rows} rows, Ts = {1e3 * answer.Ts:.4g} ms ({recorded.stamps}).")
    if answer.broken:
        sys.exit(1)


def _in_order(places, names, joints) -> list:
    """Columns in the order of the joints whose names they hold, if each joint has one; else as they come."""
    of = [max((joint for joint in joints if joint in names[i]), key=len, default="") for i in places]
    found = any(of) and sorted(filter(None, of)) == sorted(joints)
    return [places[of.index(joint)] for joint in joints] if found else places


def _table(limits) -> tuple[list, dict]:
    """(names of joints, {quantity: (k,)}) of limits, published ones or a table's; names are [] where there are none."""
    from cnclik.diagnosis.check import ORDERS, PUBLISHED
    from cnclik.problem.tables import read_columns, read_rows

    if limits is None or limits in PUBLISHED:
        return [f"{limits}_joint{i}" for i in range(1, 8)] if limits else [], PUBLISHED.get(limits, {})
    names, table = read_columns("limits", Path(limits))
    for name in names:
        errors.one_of("limits", name, (*ORDERS, "joint"))
    joints = [row[names.index("joint")].strip() for row in read_rows("limits", limits)[1:]] if "joint" in names else []
    return joints, {name: table[:, i] for i, name in enumerate(names) if name in ORDERS}
