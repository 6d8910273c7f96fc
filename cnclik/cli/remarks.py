"""Remarks on input that is accepted but probably not meant, as lines on stderr and as an entry of JSON."""

import contextlib
import json
import sys
import warnings

from cnclik.errors import Remark

_said = []  # remarks of the running command


@contextlib.contextmanager
def listening():
    """Context manager that prints each remark of the library once, on stderr; other warnings are not changed."""
    _said.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("always", Remark)
        usual = warnings.showwarning

        def show(message, category, *rest, **more):
            if not issubclass(category, Remark):
                usual(message, category, *rest, **more)
            elif str(message) not in _said:
                _said.append(str(message))
                print(f"cnclik: {message}", file=sys.stderr)

        warnings.showwarning = show
        yield


def print_json(table: dict) -> None:
    """Print a verb's answer as JSON, with its `remarks`."""
    print(json.dumps(table | {"remarks": list(_said)}, allow_nan=False))
