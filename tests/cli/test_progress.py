"""The one progress bar, with and without a terminal."""

import re
import sys

import pytest

from cnclik.cli import progress


@pytest.mark.parametrize(
    "given, says",
    [
        ((0, 40, 3.0), "compiling, loops"),
        ((0, 40, 3.0, "compiling EE"), "compiling EE"),
        ((10, 4000, 2.0), "10 of 4,000 loops, 5/s"),
        ((30, None, 60.0, "loss 0.1"), "30 loops, loss 0.1"),
        ((1, 2, 50.0, "the 5-dof arm"), "1 of 2 loops, the 5-dof arm"),
    ],
)
def test_words(given, says):
    assert progress.words("loops", *given) == says


def test_lines_without_a_terminal(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    with progress.bar("loops") as report:
        for now[0], done in ((1.0, 5), (11.0, 10), (12.0, 20), (22.0, 80)):
            report(done, 100, "EE")
    assert capsys.readouterr().err.splitlines() == [
        "10 of 100 loops, EE, 99 s left",
        "80 of 100 loops, 4/s, EE, 6 s left",
    ]


def test_another_total_is_another_phase(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    with progress.bar("done") as report:
        for now[0], done, total in ((100.0, 2, 2), (100.0, 0, 16), (112.0, 8, 16)):
            report(done, total)
    assert capsys.readouterr().err.splitlines() == ["2 of 2 done, 0 s left", "8 of 16 done, 12 s left"]


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


def test_a_terminal_is_told_what_is_waited_for(monkeypatch):
    import jax
    from rich import progress as bars

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    said, update = [], bars.Progress.update
    monkeypatch.setattr(bars.Progress, "update", lambda s, *a, **k: (said.append(k["description"]), update(s, *a, **k)))
    with progress.bar("steps") as report:
        jax.jit(lambda x: x + 17.25)(1.0)
        report(1, 2)
        jax.jit(lambda x: x + 18.25)(1.0)
    said = [re.sub(r", [\d,]+/s", "", text) for text in said]
    assert [text for i, text in enumerate(said) if text not in said[:i]] == [
        "tracing, steps", "compiling, steps", "running, steps", "1 of 2 steps"
    ]  # fmt: skip
