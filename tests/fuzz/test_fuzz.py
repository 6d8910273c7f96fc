"""A share of the inputs of `python -m tests.fuzz`, the same in every run."""

import pytest

from tests.fuzz.judge import judge, repeat
from tests.fuzz.rooms import ROOMS

COUNTS = {"urdf": 500, "toml": 250, "tables": 400, "expressions": 1200, "arguments": 80, "logs": 40, "stores": 12}
COUNTS |= {"poses": 300, "exports": 8}


FOUND = [  # what did harm: room, seed, number
    ("logs", 79, 272),
    ("arguments", 80, 696),
    ("logs", 80, 335),
    ("arguments", 81, 2498),
    ("toml", 81, 7087),
    ("toml", 82, 13920),
    ("arguments", 200, 1281),  # an integer of 5,000 digits
    ("tables", 200, 3485),  # a place of 1e308 m
]


@pytest.mark.parametrize(("name", "seed", "number"), FOUND)
def test_what_was_found_does_no_harm_again(name, seed, number, tmp_path):
    verdict = judge(ROOMS[name], number, tmp_path, seed)
    assert verdict.outcome != "failed", f"{repeat(verdict)}\n{verdict.why}"


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
