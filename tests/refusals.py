"""What is refused: a table of calls, and what is said of each in one line that names the argument."""

import pytest

from cnclik.errors import ArgumentError


def refusals(*cases, of=lambda call: call()):
    """A test of (call, pattern of what is said), or of (what `of` is called with, pattern)."""

    @pytest.mark.parametrize(("call", "says"), cases, ids=range(len(cases)))
    def refused(call, says):
        with pytest.raises(ArgumentError, match=says) as caught:
            of(**call) if isinstance(call, dict) else of(call)
        assert str(caught.value).startswith("Argument `") and "\n" not in str(caught.value)

    return refused
