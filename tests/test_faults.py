"""A share of `python -m tests.faults`: one command killed, stopped and starved; and what an interrupt leaves of it."""

import signal
import subprocess
import sys

import pytest

FAULTS = [sys.executable, "-m", "tests.faults"]


@pytest.mark.slow
def test_nothing_is_lost_or_half_written():
    line = [*FAULTS, "--kills", "3", "--others", "1", "--only", "solve"]
    found = subprocess.run(line, capture_output=True, text=True)
    assert found.returncode == 0 and "Nothing lost" in found.stdout, found.stdout + found.stderr


def test_what_was_tried_before_an_interrupt_is_told():
    line = [*FAULTS, "--kills", "1", "--others", "100", "--only", "reach"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        shown = [process.stdout.readline() for _ in range(3)]
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
    assert shown[2] == "| reach | kill | 1 | 1 |\n" and process.returncode == 130
    assert "of seed 0 in 0 min" in rest
