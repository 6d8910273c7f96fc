"""Files that a user names: whatever they turn out to be, it is one line."""

import os

import numpy as np
import pytest

import cnclik as ck
from cnclik import reading
from cnclik.cli import main
from cnclik.problem.tables import read_columns


@pytest.fixture
def odd(tmp_path):
    """Names of what is no file, by what is told of them."""
    os.mkfifo(tmp_path / "pipe")
    return {
        "is a folder": tmp_path,
        "is a device, pipe or socket": tmp_path / "pipe",
        "File name too long": tmp_path / ("a" * 5000),
        "No such file": tmp_path / "none",
        "null": "with\0null",
    }


def test_what_is_no_file_is_told_in_one_line(odd):
    for told, path in {**odd, "is a device": "/dev/zero"}.items():
        with pytest.raises(ck.ArgumentError, match=told) as error:
            reading.read_bytes("path", path, "a URDF file")
        assert str(error.value).startswith("Argument `path` must name a URDF file") and "\n" not in str(error.value)


def test_what_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MOST_BYTES", 1 << 20)
    (tmp_path / "small").write_text("text")
    assert reading.read_bytes("path", bytes(tmp_path / "small"), "a URDF file") == b"text"  # a name as bytes
    (tmp_path / "large").write_bytes(b"0" * ((1 << 20) + 1))
    with pytest.raises(ck.ArgumentError, match="of at most 1 MiB, but 'large' is larger"):
        reading.read_bytes("path", tmp_path / "large", "a URDF file")


def test_every_verb_refuses_them(odd, capsys, tmp_path):
    pipe = str(odd["is a device, pipe or socket"])
    commands = (["robots", pipe], ["sweep", pipe], ["reach", "planar:1,1", pipe + ".csv"], ["solve", pipe + ".urdf"])
    os.mkfifo(pipe + ".csv")
    os.mkfifo(pipe + ".urdf")
    for argv in commands:
        with pytest.raises(SystemExit) as leaving:
            main(argv)
        said = capsys.readouterr().err
        assert leaving.value.code == 2 and "pipe" in said and said.count("\n") == 1, argv


def test_csv_fields_and_bytes_that_are_no_text(tmp_path):
    (tmp_path / "long.csv").write_text("0," + "1" * 200_000 + "\n")
    (tmp_path / "latin.csv").write_bytes(b"0,\xff\n")
    for name, told in (("long.csv", "field larger than field limit"), ("latin.csv", "is no text")):
        with pytest.raises(ck.ArgumentError, match=told):
            read_columns("reference", tmp_path / name)


def test_numbers_too_wild_for_a_spline():
    for times, places in (([0, 1e-320, 2], [[0.0], [1.0], [2.0]]), ([0, 1, 2], [[1e308], [-1e308], [1e308]])):
        places = np.concatenate([places, np.zeros((3, 2))], axis=1)
        with pytest.raises(ck.ArgumentError, match="`positions` must be such that a smooth path leads through them"):
            ck.waypoints(times, places)
