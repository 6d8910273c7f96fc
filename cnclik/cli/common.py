"""Options and output that several verbs share."""

import contextlib
import dataclasses
import json
import sys
import warnings

from cnclik.cli.arguments import of_options
from cnclik.errors import Remark

_said = []  # remarks of the running command


@dataclasses.dataclass(kw_only=True)
class ComputeOptions:
    """For verbs that compute."""

    computes = True  # whether JAX is needed; no option
    overwrite: bool = False
    """Write over files that cnclik did not make, too."""


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
def remarks(Args):
    """Context manager that prints each remark of the library once, on stderr, with the names of a verb's options;
    other warnings are not changed.
    """
    _said.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("always", Remark)
        usual = warnings.showwarning

        def show(message, category, *rest, **more):
            if not issubclass(category, Remark):
                usual(message, category, *rest, **more)
            elif (text := of_options(Args, message)) not in _said:
                _said.append(text)
                print(f"cnclik: {text}", file=sys.stderr)

        warnings.showwarning = show
        yield


def print_json(table: dict) -> None:
    """Print a verb's answer as JSON, see `plain`, with its `remarks`."""
    from cnclik.measure.files import plain

    print(json.dumps(plain(table | {"remarks": _said}), allow_nan=False))
