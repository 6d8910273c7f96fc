"""What is refused: a table of calls, and what is said of each in one line that names the argument."""

import pytest

from cnclik.errors import ArgumentError


def refusals(*cases):
    """A test of (call, pattern of what is said)."""

    @pytest.mark.parametrize(("call", "says"), cases, ids=range(len(cases)))
    def refused(call, says):
        with pytest.raises(ArgumentError, match=says) as caught:
            call()
        assert str(caught.value).startswith("Argument `") and "\n" not in str(caught.value)

    return refused
