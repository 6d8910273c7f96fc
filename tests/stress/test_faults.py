"""A share of `python -m tests.stress.faults`: a command killed, stopped and starved; what an interrupt leaves of it."""

import subprocess
import sys

import pytest

from tests.stress import faults


@pytest.mark.slow
def test_nothing_is_lost_or_half_written():
    line = [sys.executable, "-m", "tests.stress.faults", "--kills", "3", "--others", "1", "--only", "solve"]
    found = subprocess.run(line, capture_output=True, text=True)
    assert found.returncode == 0 and "Nothing lost" in found.stdout, found.stdout + found.stderr


def test_what_was_tried_before_an_interrupt_is_told(capsys):
    def found():
        yield "reach", "kill", None
        assert capsys.readouterr().out.endswith("| reach | kill | 1 | 1 |\n")
        yield "reach", "stop", None
        yield "reach", "stop", "half a file"
        raise KeyboardInterrupt

    tried, wrong = faults.told(found(), {"kill": (None, 1), "stop": (None, 100)})
    assert (tried, wrong) == (3, ["half a file"]) and capsys.readouterr().out == "| reach | stop | 2 | 1 |\n"
