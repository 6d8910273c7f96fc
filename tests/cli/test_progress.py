"""The one progress bar, with and without a terminal."""

import sys

from cnclik.cli import progress


def test_lines_without_a_terminal(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    with progress.bar("loops") as report:
        for now[0], *each in [(0.0, 0, 400), (50.0, 100, 400, "EE"), (59.0, 200, 400), (61.0, 300, 400)]:
            report(*each)
    assert capsys.readouterr().err.splitlines() == ["100 of 400 loops, EE", "300 of 400 loops"]


def test_a_terminal_gets_a_bar(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.bar("loops") as report:
        report(0, 3)
        report(2, 3, "[EE]")
    out, err = capsys.readouterr()
    assert out == "" and "2 of 3 loops" in err and "[EE]" in err
