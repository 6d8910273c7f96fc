"""`cnclik view`: a run in a browser, with a slider over its time."""

import contextlib
import dataclasses
import signal
import threading

from cnclik.cli import terminal
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions
from cnclik.cli.problem import MeasuredOptions, ProblemOptions, problem


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, MeasuredOptions, ProblemOptions):
    """Run a loop, or take a run of solve, and play it in a browser.

    cnclik view ROBOT --stack FILE.toml"""

    robot: str = option(metavar="ROBOT|FILE", positional=True)
    """A robot, as for solve; or what to play: trajectory.nc, or a folder of solve."""
    N: int = 500
    """Number of steps."""
    host: str = "localhost"
    """Host name or address to listen on; with 0.0.0.0 other machines can connect."""
    port: int = 8080
    """Port to listen on; if it is in use, the next free one."""


def run(args: Args) -> None:
    from cnclik.show.viewer.front import is_run, view

    what = args.robot if is_run(args.robot) else problem(args)
    viewer = view(what, robot=args.robot, host=args.host, port=args.port)
    print(f"{viewer.url} (Ctrl-C ends)", flush=True)
    if signal.getsignal(signal.SIGINT) is terminal.end:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # Ctrl-C ends the viewer
    try:
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    finally:
        viewer.stop()
