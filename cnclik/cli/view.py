"""`cnclik view`: a run in a browser, with a slider over its time."""

import contextlib
import dataclasses
import signal
import threading

from cnclik.cli import terminal
from cnclik.cli.problem import ProblemOptions, problem


@dataclasses.dataclass(kw_only=True)
class Args(ProblemOptions):
    """Run a loop, as solve does with these options, and play it in a browser."""

    computes = True
    host: str = "localhost"
    """Host name or address to listen on, at port 8080 or the next free one; with 0.0.0.0 other machines can connect."""


def run(args: Args) -> None:
    from cnclik.show.viewer.front import view

    viewer = view(problem(args), host=args.host)
    print(f"{viewer.url} (Ctrl-C ends)", flush=True)
    if signal.getsignal(signal.SIGINT) is terminal.end:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # Ctrl-C ends the viewer
    try:
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    finally:
        viewer.stop()
