"""`cnclik view`: a run in a browser, with a slider over its time."""

import contextlib
import signal
import threading

from cnclik.cli import terminal
from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import problem

TAKES = PROBLEM


def run(robot: str, **loop) -> None:
    """Run a loop, as solve does with these options, and play it in a browser of this machine."""
    made = problem(robot, loop)
    from cnclik.show.viewer import view

    viewer = view(made.run(), made.law, robot=made.robot if isinstance(made.robot, str) else None)
    print(f"{viewer.url} (Ctrl-C ends)", flush=True)
    if signal.getsignal(signal.SIGINT) is terminal.end:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # Ctrl-C ends the viewer
    try:
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    finally:
        viewer.stop()
