"""`cnclik view`: a robot with its loop in a browser, with sliders; or a saved run, played."""

import contextlib
import dataclasses
import signal
import threading
from pathlib import Path

from cnclik import errors
from cnclik.cli import terminal
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions
from cnclik.cli.problem import MeasuredOptions, ProblemOptions, problem
from cnclik.writing import checked_file


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, MeasuredOptions, ProblemOptions):
    """Show a robot live with sliders, or play a run of `solve`, answers of `reach`, or a loop of a sweep. The robot has
    one tip or several:

    cnclik view ROBOT --stack FILE.toml"""

    robot: str = option(metavar="ROBOT|FILE", positional=True)
    """A robot, as for solve; or what to play: trajectory.nc, .csv, .npz, a folder of solve or of a sweep."""
    file: Path | None = option(None, positional=True)
    """After a ROBOT: a file to play that does not name its robot. After a FILE: a second one to show beside it."""
    N: int = 500
    """Number of steps."""
    host: str = "localhost"
    """Host name or address to listen on; with 0.0.0.0 other machines can connect."""
    port: int = 8080
    """Port to listen on; if it is in use, the next free one."""
    html: Path | None = None
    """Write the moving scene as one page, FILE.html, and exit."""


def run(args: Args) -> None:
    from cnclik.show.viewer import front, need

    need.require_viser()
    errors.integer("port", args.port, at_least=1, at_most=65_000)
    if args.html is not None:
        checked_file("html", args.html, ".html", overwrite=args.overwrite)
    motions, live = _shown(args)
    if args.html is not None:
        print(f"Wrote {front.write_page(live.motions() if live else motions, args.html)}.")
        return
    viewer = front.Viewer(motions, live, host=args.host, port=args.port)
    print(f"{viewer.url} (Ctrl-C ends)", flush=True)
    if signal.getsignal(signal.SIGINT) is terminal.end:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # Ctrl-C ends the viewer
    try:
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    finally:
        viewer.stop()


def _shown(args):
    """(motions, live)."""
    from cnclik.problem.stack import read_stack, tables_from, tips_of
    from cnclik.show.viewer import files, front
    from cnclik.show.viewer.live import Live

    if files.is_result(args.robot):
        named = [args.robot] if args.file is None else [args.robot, args.file]
        return [motion for one in named for motion in files.read_motions(one)][: front.MOST], None
    if args.file is not None:
        tips = None
        if args.stack is not None:
            written = read_stack(args.stack)
            tables_from(written, {})  # checked
            tips = tips_of(written)
        robot = files.robot_of(args.robot, args.tip, args.base, args.lengths, tips)
        return files.read_motions(args.file, robot), None
    made = problem(args)
    return [], Live(made, links=files.links_of(args.robot, args.base, made.law.chain))
