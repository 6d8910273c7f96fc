"""Nothing half-written looks whole."""

import os

import matplotlib.pyplot as plt
import pytest

from cnclik.errors import ArgumentError
from cnclik.show.output import FigureError, draw, output_folder


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def test_files_appear_at_the_end_only(tmp_path):
    out = tmp_path / "a" / "b"
    with output_folder(out) as folder:
        (folder / "one.txt").write_text("1")
        (folder / "sub").mkdir()
        (folder / "sub" / "two.txt").write_text("2")
        assert not (out / "one.txt").exists()
    assert files(out) == ["one.txt", "sub", "sub/two.txt"]


def test_replaces_its_own_files_and_keeps_others(tmp_path):
    (tmp_path / "one.txt").write_text("old")
    (tmp_path / "other.txt").write_text("kept")
    with output_folder(tmp_path) as folder:
        (folder / "one.txt").write_text("new")
    assert (tmp_path / "one.txt").read_text() == "new" and (tmp_path / "other.txt").read_text() == "kept"
    assert files(tmp_path) == ["one.txt", "other.txt"]


@pytest.mark.parametrize("problem", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_failure_leaves_what_was(tmp_path, problem):
    old = tmp_path / "old"
    old.mkdir()
    (old / "one.txt").write_text("old")
    for out in (old, tmp_path / "new" / "deep"):
        with pytest.raises(problem), output_folder(out) as folder:
            (folder / "one.txt").write_text("half")
            raise problem
    assert files(tmp_path) == ["old", "old/one.txt"] and (old / "one.txt").read_text() == "old"


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with (
            pytest.raises(ArgumentError, match="Argument `out` must be a folder that can be written into"),
            output_folder(out),
        ):
            pass


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ArgumentError, match="Permission denied"), output_folder(tmp_path / "out"):
        pass
    tmp_path.chmod(0o700)


def test_a_figure_that_fails_costs_only_itself(tmp_path):
    def fail():
        raise ValueError("no\nink")

    reports = []
    figures = {"a.png": (fail, {}), "b.png": (plt.figure, {"Title": "b"}), "c.pdf": (plt.figure, {"Title": "c"})}
    with pytest.raises(FigureError, match=r"Not drawn: a.png \(ValueError: no ink\)"):
        draw(figures, tmp_path, progress=lambda *report: reports.append(report))
    assert files(tmp_path) == ["b.png", "c.pdf"]
    assert reports == [(k, 3, f"drawing {name}") for k, name in enumerate(figures)]
