"""`cnclik check`: which limits a log of joint values breaks, and what is wrong with its rows."""

import sys
from pathlib import Path
from typing import Any

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

    found = read(log, **columns)
    chain = None
    if robot is not None:
        from cnclik.problem.names import load

        chain = load(robot, tip)
    elif tip is not None:
        raise errors.fail("tip", "come with ROBOT", "comes without")
    limits = limits or (robot if robot in PUBLISHED else None)
    if limits is not None and not Path(limits).suffix:
        errors.one_of("limits", limits, (*PUBLISHED, "FILE.csv"))
    table = _table(Path(limits)) if limits is not None and limits not in PUBLISHED else limits
    sent, moved = ([], []) if found.chosen else found.pairs()
    places = found.chosen or moved or found.joints()
    whole = found.columns([*places, *sent])
    q, command = whole[:, : len(places)], whole[:, len(places) :] if sent else None
    t, names = None if found.t is None else found.t[: len(q)], [found.names[i] for i in (*places, *sent)]
    asked: dict[str, Any] = dict(limits=table, chain=chain, command=command, resolution=resolution, names=names)
    with errors.called("q", "LOG"):
        answer = check_log(t, q, Ts=found.Ts, **asked)
    if json:
        found_in = {"findings": answer.findings, "broken": len(answer.broken)}
        print_json(found_in | {"Ts": answer.Ts, "rows": answer.rows})
    else:
        print(answer)
        print(f"{answer.rows} rows, Ts = {1e3 * answer.Ts:.4g} ms ({found.stamps}).")
    if answer.broken:
        sys.exit(1)


def _table(file) -> dict:
    """{quantity: (k,)} of a table of limits."""
    from cnclik.diagnosis.check import ORDERS
    from cnclik.problem.tables import read_columns

    names, table = read_columns("limits", file)
    for name in names:
        errors.one_of("limits", name, (*ORDERS, "joint"))
    return {name: table[:, i] for i, name in enumerate(names) if name in ORDERS}
