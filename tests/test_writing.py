"""Each file is whole or not there, and what others wrote stays; what cannot be read is refused in one line."""

import errno
import os
import tempfile
import time

import numpy as np
import pytest
import xarray

import cnclik as ck
from cnclik import reading, writing
from cnclik.errors import ArgumentError
from cnclik.measure.files import save_netcdf
from cnclik.problem.tables import read_columns
from cnclik.writing import output_folder

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.name != writing.LIST)


def test_files_appear_whole_and_others_stay(tmp_path):
    out = tmp_path / "a" / "b"
    out.mkdir(parents=True)
    (out / "one.txt").write_text("old")
    (out / "other.txt").write_text("kept")

    def make(path):
        path.write_text("1")
        assert (out / "one.txt").read_text() == "old"

    with output_folder(out) as folder:
        folder.write("one.txt", make)
        folder.write_text("sub/two.txt", "2")
        assert (out / "one.txt").read_text() == "1"
    assert files(out) == ["one.txt", "other.txt", "sub", "sub/two.txt"]


def test_a_file_of_others_among_ours_stays(tmp_path):
    """Also one that the user has changed since, or put in the place of ours."""
    out = tmp_path / "out"

    def write(text, overwrite=False):
        with output_folder(out, overwrite=overwrite) as folder:
            folder.write_text("README.md", text)
            folder.write_text("summary.csv", "a,b\n")

    for text in ("first", "second", "second"):
        write(text)
    for name in ("README.md", "summary.csv"):
        before = (out / name).read_text()
        (out / name).write_text(f"{before}mine")
        with pytest.raises(ArgumentError, match=rf"{name} there is not cnclik's own \(--overwrite"):
            write("third")
        assert (out / name).read_text() == f"{before}mine"
        write("fourth", overwrite=True)
    write("fifth")
    assert (out / "README.md").read_text() == "fifth"
    (out / "README.md").unlink()
    (out / "README.md").symlink_to(tmp_path / "none")
    with pytest.raises(ArgumentError, match=r"README\.md there is not"):
        write("sixth")


def half(path, problem):
    path.write_text("half")
    raise problem


def test_an_interrupt_leaves_what_was(tmp_path):
    old = tmp_path / "old"
    old.mkdir()
    (old / "one.txt").write_text("old")
    for out in (old, tmp_path / "new"):
        with pytest.raises(KeyboardInterrupt), output_folder(out) as folder:
            folder.write("one.txt", lambda path: half(path, KeyboardInterrupt))
    assert files(tmp_path) == ["old", "old/one.txt"] and (old / "one.txt").read_text() == "old"


def test_what_does_not_take_a_file_is_one_line_and_costs_no_file_before_it(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "out" / "one.txt" / "theirs").mkdir(parents=True)
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ArgumentError, match="`out` must be a folder that can be written into"), output_folder(out):
            pass
    with pytest.raises(ArgumentError, match=r"one\.txt is a folder there"), output_folder(tmp_path / "out") as folder:
        folder.write_text("one.txt", "1")
    said = r"that takes all files, but .*No space left on device \(two\.txt; files before it are kept\)"
    with pytest.raises(ArgumentError, match=said), output_folder(tmp_path / "out") as folder:
        folder.write_text("sub/one.txt", "1")
        folder.write("two.txt", lambda path: half(path, FULL))
    assert files(tmp_path / "out") == ["one.txt", "one.txt/theirs", "sub", "sub/one.txt"]


def test_what_stands_in_the_way_is_known_before_any_work(tmp_path, monkeypatch):
    """A file of another in a folder of ours; a folder in its place; a full disk."""
    (tmp_path / "numbers.csv").write_text("theirs")
    (tmp_path / "there.png").mkdir()
    for file, why in (("numbers.csv", "is not cnclik's own"), ("there.png", "is a folder there")):
        with (
            pytest.raises(ArgumentError, match=why),
            output_folder(tmp_path, overwrite=False, files=["first.txt", file]),
        ):
            raise AssertionError("work has begun")

    def no_room(**where):
        raise FULL

    monkeypatch.setattr(tempfile, "TemporaryFile", no_room)
    with pytest.raises(ArgumentError, match="No space left"), output_folder(tmp_path / "out"):
        raise AssertionError
    assert not (tmp_path / "out").exists()


def test_netcdf_never_opens_a_file_that_hdf5_could_crash_on(tmp_path):
    """HDF5 ends the process where a disk is full; Python's own files raise."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    with pytest.raises(OSError, match="No space left"):
        save_netcdf(xarray.Dataset({"a": ("x", np.arange(1e4))}), "/dev/full")


def test_what_a_killed_process_left_is_removed(tmp_path):
    old, young = tmp_path / ".partial-old", tmp_path / ".partial-young"
    for left in (old, young):
        left.mkdir()
        (left / "one.txt").write_text("half")
    os.utime(old, (time.time() - 4000,) * 2)
    with output_folder(tmp_path):
        pass
    assert os.listdir(tmp_path) == [young.name]  # another process may be at it


def test_what_is_no_file_is_told_in_one_line(tmp_path):
    odd = {"Is a directory": tmp_path, "is larger": "/dev/zero", "null": "with\0null"}
    odd |= {"File name too long": tmp_path / ("a" * 5000), "No such file": tmp_path / "none"}
    for told, path in odd.items():
        with pytest.raises(ck.ArgumentError, match=told) as error:
            reading.read_bytes("path", path, "a URDF file")
        assert str(error.value).startswith("Argument `path` must name a URDF file") and "\n" not in str(error.value)


def test_csv_fields_and_bytes_that_are_no_text(tmp_path):
    (tmp_path / "long.csv").write_text("0," + "1" * 200_000 + "\n")
    (tmp_path / "latin.csv").write_bytes(b"0,\xff\n")
    for name, told in (("long.csv", "field larger than field limit"), ("latin.csv", "is no text")):
        with pytest.raises(ck.ArgumentError, match=told):
            read_columns("reference", tmp_path / name)
