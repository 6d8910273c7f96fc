"""What several verbs do: JAX's settings, the problem that options describe, tables, JSON and remarks."""

import contextlib
import json
import sys
import warnings

from cnclik import errors
from cnclik.cli.arguments import of_options

_said = []  # remarks of the running command


def prepare() -> None:
    """Load JAX in float64, with the cache of compiled programs (off with JAX_ENABLE_COMPILATION_CACHE=0)."""
    import jax

    from cnclik.cache import use_cache

    jax.config.update("jax_enable_x64", True)
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        raise errors.fail("JAX_PLATFORMS", "name a platform that is there", str(error)) from None
    use_cache()


def problem(robot, loop):
    """The `Problem` of a robot and of the options that a user gave. Raises: ArgumentError."""
    prepare()
    from cnclik.problem.file import problem_of

    return problem_of(robot, **loop)


def print_table(*rows, left=1) -> None:
    """Print rows of texts in columns, of which the first `left` are aligned left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [f"{text:{'<' if k < left else '>'}{widths[k]}}" for k, text in enumerate(row)]
        print("  ".join(cells).rstrip())


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
