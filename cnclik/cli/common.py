"""What several verbs do: JAX's settings, the problem that options describe, tables, JSON and remarks."""

import contextlib
import gc
import json
import os
import sys
import warnings

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import of_options

_said = []  # remarks of the running command


def prepare() -> None:
    """Load JAX and set float64 and the cache of compiled programs, which JAX_ENABLE_COMPILATION_CACHE=0 switches off.

    Raises: ArgumentError where JAX finds no device to run on.
    """
    gc.disable()  # it takes an eighth of the time of imports, and finds nothing
    try:
        import jax

        jax.config.update("jax_enable_x64", True)
        jax.devices()
    except (RuntimeError, AssertionError):
        named = repr(os.environ.get("JAX_PLATFORMS") or "not set")
        raise errors.fail("JAX_PLATFORMS", "name a platform that is there", f"is {named}") from None
    finally:
        gc.enable()
    from cnclik.cache import use_cache

    use_cache()


def problem(robot, loop, **defaults):
    """The `Problem` of a robot and of the options that a user gave. Raises: ArgumentError."""
    prepare()
    from cnclik.problem.file import problem_of

    with progress.bar("start and path"):
        return problem_of(robot, **({} if robot.endswith(".py") else defaults) | loop)


def print_table(rows, header=(), *, title=None, left=1, style=lambda row: None, **look) -> None:
    """Print rows of texts as a table; the first `left` columns are aligned left; style(row) is rich's name of it."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    title = title and Text(title, style="table.title")
    shown = Table(title=title, title_justify="left", show_header=bool(header), **look)
    for i, name in enumerate(header):
        shown.add_column(Text(name), justify="left" if i < left else "right")
    for row in rows:
        shown.add_row(*map(Text, row), style=style(row))
    Console().print(shown)


@contextlib.contextmanager
def remarks(verb):
    """Context manager that prints each remark of the library once, on stderr, with the names of a verb's options."""
    _said.clear()
    usual = warnings.showwarning

    def show(message, category, *rest, **more):
        if not issubclass(category, errors.Remark):
            usual(message, category, *rest, **more)
        elif (text := of_options(verb, message)) not in _said:
            _said.append(text)
            print(f"cnclik: {text}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", errors.Remark)
        warnings.showwarning = show
        yield


def print_json(table: dict) -> None:
    """Print a verb's answer as JSON, see `plain`, with its `remarks`."""
    from cnclik.measure.files import plain

    print(json.dumps(plain(table | {"remarks": _said}), allow_nan=False))
