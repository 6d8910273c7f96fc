"""Remarks on input that is accepted but probably not meant, as lines on stderr and as an entry of JSON."""

import contextlib
import json
import sys
import warnings

from cnclik.cli.arguments import of_options
from cnclik.errors import Remark

_said = []  # remarks of the running command


@contextlib.contextmanager
def listening(Args):
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
