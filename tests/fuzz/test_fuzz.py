"""A share of the inputs of `python -m tests.fuzz`, the same in every run."""

import pytest

from tests.fuzz.judge import judge, repeat
from tests.fuzz.rooms import ROOMS

COUNTS = {"urdf": 700, "toml": 400, "tables": 600, "expressions": 1500, "arguments": 120, "stores": 15}


@pytest.mark.parametrize("name", ROOMS)
def test_no_input_does_harm(name, tmp_path):
    wrong = []
    for number in range(COUNTS[name]):
        folder = tmp_path / str(number)
        folder.mkdir()
        verdict = judge(ROOMS[name], number, folder)
        if verdict.outcome == "failed":
            wrong.append(f"{repeat(verdict)}\n{verdict.why}")
    assert not wrong, "\n".join(wrong)
