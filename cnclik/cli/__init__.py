"""The command line: one module per verb, each loaded only when its verb is used.

A verb's module has a function `run`, whose arguments are its options (see `arguments`), and perhaps TAKES, the groups
of shared options that it takes. To add one, name it in `VERBS`.
"""

import gc
import importlib
import os
import sys

from cnclik.cli import terminal
from cnclik.version import __version__

VERBS = {
    "reproduce": "repeat the paper's experiments: data, figures and a check of its claims",
    "robots": "show what a robot file contains: link tree, joints, limits, possible tips",
    "solve": "run one loop on one robot: trajectory, figures, verdict",
    "reach": "find joint values that put the tip at one target or at a million, with a reason where there are none",
    "stability": "compute which gain is safe at which sampling time: limits, margins, stability regions and maps",
    "check": "read a log of joints: the limits that it breaks and where, missing rows, jumps; exit code 1 if one is",
    "diagnose": "read a recording: does the loop ring, what is its dead time, which gain stops it; or fit its drive",
    "sweep": "run a study of many loops from one TOML file, resumable, with its figures",
    "view": "play a run in a browser: the robot by its meshes, targets, walls, a slider over time",
    "export": "write a step of the loop as C for a controller: header, source, test vectors, README",
}
OVERVIEW = """usage: cnclik VERB [options]

Closed-loop inverse kinematics as time stepping.

{}

cnclik VERB --help lists the options of a verb; cnclik --version prints the version."""


def main(argv=None) -> None:
    """Entry point of `cnclik`.

    An error is one line on stderr. Exit codes: 2 for invalid arguments, 1 for figures or output that could not be
    written, 130 after an interrupt, 143 after SIGTERM.
    """
    process = argv is None
    argv = list(sys.argv[1:] if process else argv)
    if process:
        gc.set_threshold(100_000)  # of what JAX's import and traces make nearly all stays: a tenth of the time
        os.environ["MPLBACKEND"] = "agg"  # figures go to files, whatever backend the user has set for windows
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads slow small matrices down, up to ten times
    with terminal.guarded(process):
        if argv[:1] in (["-V"], ["--version"]):
            print(f"cnclik {__version__}")
        elif argv[:1] in ([], ["-h"], ["--help"]):
            width = max(map(len, VERBS))
            print(OVERVIEW.format("\n".join(f"  {verb:<{width}}  {what}" for verb, what in VERBS.items())))
        else:
            _run(*argv)


def _run(verb, *options) -> None:
    from cnclik import errors
    from cnclik.cli import arguments, common  # not at the top: `cnclik --help` answers at once
    from cnclik.show.output import FigureError

    try:
        module = importlib.import_module(f"cnclik.cli.{errors.one_of('verb', verb, VERBS)}")
        with common.remarks(module):
            module.run(**arguments.parse(module, options, prog=f"cnclik {verb}", description=VERBS[verb]))
        return
    except errors.ArgumentError as error:
        said, code = arguments.of_options(module, error) if verb in VERBS else str(error), 2
    except FigureError as error:
        said, code = str(error), 1
    except ImportError as error:  # of a plotting package; results are already written
        said, code = errors.in_a_line(error), 1
    print(f"cnclik: {' '.join(said.split())}", file=sys.stderr)
    sys.exit(code)
