"""The one progress bar, with and without a terminal."""

import sys

import pytest

from cnclik.cli import progress


@pytest.mark.parametrize(
    "given, says",
    [
        ((0, 40, 3.0), "compiling, loops"),
        ((0, 40, 3.0, "compiling EE"), "compiling EE"),
        ((10, 4000, 5.0), "10 of 4,000 loops, 5/s"),
        ((30, None, 0.5, "loss 0.1"), "30 loops, loss 0.1"),
        ((1, 2, 0.02, "the 5-dof arm"), "1 of 2 loops, the 5-dof arm"),
    ],
)
def test_words(given, says):
    assert progress.words("loops", *given) == says


@pytest.mark.parametrize(
    ("reports", "said"),
    [
        (
            [(1.0, 5, 100, "EE"), (11.0, 10, 100, "EE"), (12.0, 20, 100, "EE"), (22.0, 80, 100, "EE")],
            ["10 of 100 loops, EE, 180 s left", "80 of 100 loops, 4/s, EE, 6 s left"],
        ),
        # Compiling before the first are done is no work.
        (
            [(0.0, 0, 400), (50.0, 100, 400), (60.0, 200, 400)],
            ["100 of 400 loops", "200 of 400 loops, 10/s, 20 s left"],
        ),
        # Another total is another phase.
        (
            [(100.0, 2, 2), (100.0, 0, 16), (104.0, 4, 16), (112.0, 8, 16)],
            ["2 of 2 loops", "8 of 16 loops, 16 s left"],
        ),
    ],
)
def test_lines_without_a_terminal(capsys, monkeypatch, reports, said):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    with progress.bar("loops") as report:
        for now[0], *each in reports:
            report(*each)
    assert capsys.readouterr().err.splitlines() == said


def test_quiet_is_silent(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.bar("loops", quiet=True) as report:
        report(1, 2)
    assert capsys.readouterr().err == ""


def test_a_terminal_gets_a_bar(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.bar("loops", total=3) as report:
        report(0, 3)
        report(2, 3, "[EE]")
    out, err = capsys.readouterr()
    assert out == "" and "2 of 3 loops" in err and "[EE]" in err
