"""What is refused: a table of calls, and what is said of each in one line that names the argument."""

import re

import pytest

from cnclik.errors import ArgumentError


def refusals(*cases, of=lambda call: call()):
    """A test of (call, what is said or its pattern), or of (what `of` is called with, the same)."""

    @pytest.mark.parametrize(("call", "says"), cases, ids=range(len(cases)))
    def refused(call, says):
        with pytest.raises(ArgumentError) as caught:
            of(**call) if isinstance(call, dict) else of(call)
        said = str(caught.value)
        assert says in said or re.search(says, said), said
        assert said.startswith("Argument `") and "\n" not in said

    return refused
