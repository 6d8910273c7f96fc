"""The command line: one module per verb, each loaded only when its verb is used.

A verb's module holds a dataclass `Args` (its options, read by tyro) and `run(args)`. To add one, name it
in `VERBS`.
"""

import importlib
import os
import sys

VERBS = {
    "reproduce": "run the paper's experiments: figures, data and its claims, reading by reading",
    "robots": "show a URDF file: its tree, joints, limits and candidate tips",
    "solve": "run one loop on one robot: trajectory, figures, summary",
    "stability": "which gain is safe at which sampling time: limits, margins, regions and measured maps",
    "sweep": "run a study of many loops from one TOML file, resumable, with its figures",
    "plot": "draw the figures of a finished sweep",
    "tune": "gains by gradient under a stability margin: tuned.json, figures, one-page summary",
    "rivals": "tuning by gradient against grid search, Nelder-Mead and a gain picked by hand",
    "bench": "evaluations per second, compile time, memory and cost of gradients on this machine",
}


def main(argv=None) -> None:
    """Entry point of `cnclik`. Exit code 2, and one line on stderr, for arguments that can't be used."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv[:1] in (["-V"], ["--version"]):
        from cnclik import __version__

        print(f"cnclik {__version__}")
        return
    if not argv or argv[0] in ("-h", "--help"):
        print(_overview())
        return
    from cnclik import errors

    try:
        verb = errors.one_of("verb", argv[0], VERBS)
        _prepare()
        from cnclik.cli import arguments

        module = importlib.import_module(f"cnclik.cli.{verb}")
        module.run(arguments.parse(module.Args, argv[1:], prog=f"cnclik {verb}", description=VERBS[verb]))
    except errors.ArgumentError as error:
        print(f"cnclik: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("cnclik: Interrupted; what was complete is kept.", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output, such as `head`, has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def _prepare() -> None:
    """Float64 and no window: the command line is for numbers that are quoted and figures that are saved."""
    os.environ.setdefault("MPLBACKEND", "agg")
    import jax

    jax.config.update("jax_enable_x64", True)


def _overview() -> str:
    width = max(map(len, VERBS))
    lines = [f"  {verb:<{width}}  {what}" for verb, what in VERBS.items()]
    return "\n".join(
        [
            "usage: cnclik VERB [options]",
            "",
            "Closed-loop inverse kinematics as time stepping.",
            "",
            *lines,
            "",
            "cnclik VERB --help lists a verb's options; cnclik --version tells the version.",
        ]
    )
