"""A share of the inputs of `python -m tests.stress.fuzz`, the same in every run."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from tests.stress.fuzz.judge import judge, repeat
from tests.stress.fuzz.rooms import ROOMS

COUNTS = {"urdf": 500, "toml": 250, "tables": 400, "expressions": 1200, "arguments": 80, "logs": 40, "stores": 12}
COUNTS |= {"poses": 300, "stacks": 150, "exports": 8}


AT_WORK = """
import os, pathlib, signal, sys, time
from tests.stress.fuzz import many

def batch(name, numbers, place):
    pathlib.Path(place).write_text(f"{os.getpid()}\\n")
    time.sleep(600)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # behind `&` it is ignored
    many.batch = batch
    list(many.verdicts({"urdf": 1}, sys.argv[1], 1))
"""


def test_an_interrupt_ends_what_is_at_work(tmp_path):
    script, place = tmp_path / "at_work.py", tmp_path / "place"
    script.write_text(AT_WORK)
    root = pathlib.Path(__file__).parents[3]
    line = [sys.executable, str(script), str(place)]
    with subprocess.Popen(line, env=os.environ | {"PYTHONPATH": str(root)}, stderr=subprocess.DEVNULL) as process:
        try:
            while not (place.exists() and place.read_text().endswith("\n")):
                assert process.poll() is None
                time.sleep(0.1)
            process.send_signal(signal.SIGINT)
            process.wait(30)
        finally:
            process.kill()
    with pytest.raises(ProcessLookupError):
        os.kill(int(place.read_text()), 0)


FOUND = [  # what did harm: room, seed, number
    ("logs", 79, 272),
    ("arguments", 80, 696),
    ("logs", 80, 335),
    ("arguments", 81, 2498),
    ("toml", 81, 7087),
    ("toml", 82, 13920),
    ("arguments", 200, 1281),  # an integer of 5,000 digits
    ("toml", 401, 1818),  # a delay of a measurement of more digits than a float takes
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
