"""Remarks: what a command does although it is probably not meant, as lines on stderr and in what is printed as JSON."""

import contextlib
import json
import sys
import warnings

from cnclik.errors import Remark

_said = []  # of the command that runs


@contextlib.contextmanager
def listening():
    """Context manager: each remark of the library, once, is a line on stderr; other warnings go their way."""
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
    """Print a verb's answer as JSON, with the `remarks` there were."""
    print(json.dumps(table | {"remarks": list(_said)}, allow_nan=False))
