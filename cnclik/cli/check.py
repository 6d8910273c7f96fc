"""`cnclik check`: which limits a log of joint values breaks, and what is wrong with its rows."""

import dataclasses
import pathlib
import sys

from cnclik import errors
from cnclik.cli.arguments import option
from cnclik.cli.common import print_json
from cnclik.cli.log import LogOptions, read


@dataclasses.dataclass(kw_only=True)
class Args(LogOptions):
    robot: str | None = None
    """A URDF or MJCF file or a built-in robot: for its limits of position and velocity, and how far its tip strays."""
    tip: str | None = None
    """The tip, where the robot has several."""
    limits: str | None = option(None, metavar="NAME|FILE.csv")
    """Limits of velocity, acceleration and jerk: published ones (panda, fr3), or a table with columns of these names
    and a row for each joint."""
    resolution: float = option(0.0, unit="q")
    """Resolution of the encoders [rad, m]."""


def run(args: Args) -> None:
    """Print one table; exit with code 1 if a limit is broken."""
    from cnclik.diagnosis.check import PUBLISHED, check_log

    log = read(args)
    chain = None
    if args.robot is not None:
        from cnclik.problem.names import load

        chain = load(args.robot, args.tip)
    elif args.tip is not None:
        raise errors.fail("tip", "come with --robot", "comes without")
    limits = args.limits or (args.robot if args.robot in PUBLISHED else None)
    if limits is not None and limits not in PUBLISHED:
        limits = _table(pathlib.Path(limits))
    sent, moved = ([], []) if args.columns else log.pairs()
    places = log.chosen(args.columns) or moved or log.joints()
    whole = log.columns([*places, *sent])
    q, command = whole[:, : len(places)], whole[:, len(places) :] if sent else None
    t = None if log.t is None else log.t[: len(q)]
    with errors.called("q", "LOG"):
        found = check_log(
            t, q, Ts=args.Ts, limits=limits, chain=chain, command=command, resolution=args.resolution,
            names=[log.names[i] for i in (*places, *sent)],
        )  # fmt: skip
    if args.json:
        print_json({"findings": found.findings, "broken": len(found.broken), "Ts": found.Ts, "rows": found.rows})
    else:
        print(found)
        print(f"{found.rows} rows, Ts = {1e3 * found.Ts:.4g} ms ({log.stamps}).")
    sys.exit(1 if found.broken else 0)


def _table(file) -> dict:
    """{quantity: (k,)} of a table of limits."""
    from cnclik.diagnosis.check import ORDERS
    from cnclik.problem.tables import read_columns

    names, table = read_columns("limits", file)
    for name in names:
        errors.one_of("limits", name, (*ORDERS, "joint"), ", as columns")
    return {name: table[:, i] for i, name in enumerate(names) if name in ORDERS}
