"""The command line: one module per verb, each loaded only when its verb is used.

A verb's module holds a dataclass `Args` (its options, see `arguments`) and `run(args)`. To add one, name it
in `VERBS`.
"""

import contextlib
import gc
import importlib
import os
import sys
import time

from cnclik.cli import terminal
from cnclik.version import __version__

_BEGUN = time.time()
_NO_PLATFORM = RuntimeError, AssertionError  # what JAX raises where it doesn't find what it is to run on
VERBS = {
    "reproduce": "run the paper's experiments: figures, data and its claims, reading by reading",
    "robots": "show a robot's file: its tree, joints, limits and candidate tips",
    "solve": "run one loop on one robot: trajectory, figures, summary",
    "reach": "joint values that put the tip at targets: one or a million, with a reason where none do",
    "stability": "which gain is safe at which sampling time: limits, margins, regions and measured maps",
    "diagnose": "from a recording: does the loop ring, how late is the robot, which gain would end it; its drive",
    "sweep": "run a study of many loops from one TOML file, resumable, with its figures",
    "plot": "draw the figures of a finished sweep",
    "tune": "gains by gradient under a stability margin: tuned.json, figures, one-page summary",
    "view": "a robot and its loop in a browser, with sliders; or a finished run, played; or one page that moves",
    "export": "the step as C for a controller: header, source, test vectors, README",
}


def main(argv=None) -> None:
    """Entry point of `cnclik`.

    What is wrong is one line on stderr; the exit code is 2 for arguments that can't be used, 1 for figures or output
    that could not be written, 130 after an interrupt, 143 after SIGTERM.
    """
    process = argv is None
    argv = list(sys.argv[1:] if process else argv)
    if process:
        os.environ["MPLBACKEND"] = "agg"  # figures go to files: what windows are drawn with has no say
    with terminal.guarded(process):
        if argv[:1] in (["-V"], ["--version"]):
            print(f"cnclik {__version__}")
        elif not argv or argv[0] in ("-h", "--help"):
            print(_overview())
        else:
            _run(*argv)


def _run(verb, *options) -> None:
    from cnclik import errors, reading
    from cnclik.cli import arguments, common, remarks
    from cnclik.show.output import FigureError

    try:
        errors.one_of("verb", verb, VERBS)
        with _nothing_collected():
            module = importlib.import_module(f"cnclik.cli.{verb}")
            args = arguments.parse(module.Args, options, prog=f"cnclik {verb}", description=VERBS[verb])
        _check_report(args, ["cnclik", verb, *options])
        if isinstance(args, common.ComputeOptions):  # the others are quick without JAX
            with _nothing_collected():
                _prepare(args.cache)
        with remarks.listening(), reading.remembered(), _watched(args) as spans:
            module.run(args)
            if spans is not None:
                print(spans)
    except errors.ArgumentError as error:
        _leave(2, error)
    except FigureError as error:
        _leave(1, error)
    except ImportError as error:  # of what draws: what was computed is written before that is loaded
        _leave(1, errors.in_a_line(error))
    except _NO_PLATFORM:
        if _has_platform():
            raise
        named = repr(os.environ.get("JAX_PLATFORMS") or "not set")
        _leave(2, errors.fail("JAX_PLATFORMS", "name a platform that is there", f"is {named}"))


def _check_report(args, argv) -> None:
    """Look whether a report can be written, before anything is computed; and tell it of the command."""
    if getattr(args, "report", None) is not None:
        import shlex

        from cnclik.writing import checked_file

        checked_file("report", args.report, ".html", overwrite=args.overwrite)
        args.typed = shlex.join(argv)


def _has_platform() -> bool:
    """Whether JAX finds what it is to run on, for which it looks when it first needs it."""
    if "jax" in sys.modules:
        try:
            sys.modules["jax"].devices()
        except _NO_PLATFORM:
            return False
    return True


def _leave(code, message) -> None:
    print(f"cnclik: {' '.join(str(message).split())}", file=sys.stderr)
    sys.exit(code)


@contextlib.contextmanager
def _nothing_collected():
    """Context manager: no search for garbage, which takes an eighth of the time of loading modules and finds none."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _watched(args):
    """Context manager that yields the spans of what takes time, where they are asked for, else None."""
    if not getattr(args, "timings", False):
        return contextlib.nullcontext()
    from cnclik.cli import timings

    return timings.watch(_BEGUN)


def _prepare(cache: bool) -> None:
    """Float64, no window, programs kept: for numbers that are quoted and figures that are saved."""
    os.environ.setdefault("MPLBACKEND", "agg")
    import jax

    jax.config.update("jax_enable_x64", True)
    from cnclik.programs import keep

    place = None
    if cache:
        from cnclik.compilation import use_cache

        place = use_cache()
    else:
        jax.config.update("jax_enable_compilation_cache", False)
    keep(None if "JAX_COMPILATION_CACHE_DIR" in os.environ else place)  # others may write where that is


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
