"""CSV files of poses are read by the names of their columns, or in order; numbers are what they look like."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.problem.tables import read_columns, read_points
from cnclik.task.build import orientation, pose, position

W = Rotation.from_rotvec([[0.3, -1.1, 0.7], [0.1, 0.2, 2.9]]).as_quat(scalar_first=True)
P = np.array([[0.3, -0.2, 0.5], [0.4, 0.1, 0.45]])
VALUES = dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz"), np.hstack([P, W]).T, strict=True))


def written(path, head, columns):
    lines = [",".join(f"{v:.17g}" for v in row) for row in np.stack(columns, 1)]
    path.write_text("\n".join([*[head] * bool(head), *lines]) + "\n", encoding="utf-8-sig")  # as spreadsheets do
    return path


def test_columns_have_names_in_any_order_or_their_order_without(tmp_path):
    for names in itertools.islice(itertools.permutations(VALUES), 0, 5040, 631):
        file = written(tmp_path / "f.csv", ",".join(names), [VALUES[name] for name in names])
        for task, wanted in ((pose(), np.hstack([P, W])), (position("xy"), P), (orientation(), W)):
            np.testing.assert_array_equal(read_points("TARGETS", file, task)[1], wanted)
    file = written(tmp_path / "f.csv", "", [np.array([0.0, 2.0]), *VALUES.values()])
    times, points = read_points("reference", file, pose(), timed=True)
    np.testing.assert_array_equal(times, [0.0, 2.0])
    np.testing.assert_array_equal(points, np.hstack([P, W]))
    (tmp_path / "log.csv").write_text("# made by us\n\nt,state,q\n0,run,1.5\n1,,\n")
    names, table = read_columns("LOG", tmp_path / "log.csv")
    assert names == ("t", "state", "q")
    np.testing.assert_array_equal(table, [[0.0, np.nan, 1.5], [1.0, np.nan, np.nan]])


@pytest.mark.parametrize(
    ("head", "told"),
    [
        ("x,y,z,qx,qy,qz,Qw", "have columns x y z qw qx qy qz, but f.csv has x y z qx qy qz Qw"),
        ("x,y,qw,qx,qy,qz,time", "have columns x y z qw qx qy qz, but f.csv has x y qw"),
        ("x,y,z,qx,qy,qz", "row 1 of f.csv has 7 of 6"),
    ],
)
def test_what_is_missing_is_refused(head, told, tmp_path):
    file = written(tmp_path / "f.csv", head, list(VALUES.values()))
    with pytest.raises(ck.ArgumentError, match=told):
        read_points("TARGETS", file, pose())


@pytest.mark.parametrize("slip", ["1_0", "０．５", "1٫5", "0x10", "1e", "--1", "${len}", "1d5", "½"])
def test_numbers_are_what_they_look_like(slip, tmp_path):
    (tmp_path / "f.csv").write_text(f"1,2,3\n{slip},2,3\n", encoding="utf-8")
    with pytest.raises(ck.ArgumentError, match="row 2 of f"):
        read_points("TARGETS", tmp_path / "f.csv", pose())
    with pytest.raises(ck.ArgumentError, match="`robot` must give link lengths"):
        ck.problem.problem_from(f"planar:1,{slip}")


def test_what_was_probably_meant_is_said(tmp_path):
    for text, told in (
        ("1;2;3\n4;5;6\n", "separated by commas"),
        ('1,1,1\n"0,25",1,1\n', "write 0.25"),
        ("1,1,1\n1_0,1,1\n", "write 10"),
    ):
        (tmp_path / "f.csv").write_text(text)
        with pytest.raises(ck.ArgumentError, match=told):
            read_points("TARGETS", tmp_path / "f.csv", pose())
