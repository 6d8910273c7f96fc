"""A share of `python -m tests.faults`: one command killed, stopped and starved."""

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_nothing_is_lost_or_half_written():
    line = [sys.executable, "-m", "tests.faults", "--kills", "3", "--others", "1", "--only", "solve"]
    found = subprocess.run(line, capture_output=True, text=True)
    assert found.returncode == 0 and "Nothing lost" in found.stdout, found.stdout + found.stderr
