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
    np.savetxt(tmp_path / "n.csv", P, delimiter=",", header="made by us\nx,y,z")  # as NumPy writes a header
    np.testing.assert_array_equal(read_points("TARGETS", tmp_path / "n.csv", position())[1], P)
    assert read_columns("LOG", tmp_path / "n.csv")[0] == ("x", "y", "z")


def test_columns_of_one_of_several_tips(tmp_path):
    file = written(tmp_path / "f.csv", "left.x,left.y,left.z,right.z,right.y,right.x", [*P.T, *P.T[::-1]])
    for tip in ("left", "right"):
        np.testing.assert_array_equal(read_points("TARGETS", file, position(), tip=tip)[1], P)


@pytest.mark.parametrize(
    ("head", "told"),
    [
        ("x,y,z,qx,qy,qz,q4", "have columns time x y z qw qx qy qz, but f.csv has 'q4'"),
        ("x,y,z,qx,qy,qz,Qw", r"but f.csv has 'Qw' \(did you mean 'qw'\?\)"),
        ("x,y,z,x,qx,qy,qz", "name each column once, but f.csv has x y z x qx qy qz"),
        ("x,y,z,qx,qy,qz,time", "have columns x y z qw qx qy qz, but f.csv lacks qw"),
        ("x,y,qw,qx,qy,qz,time", "but f.csv lacks z"),
        ("x,y,z,qx,qy,qz", "have a name for each column, but f.csv has 6 names and 7 columns"),
    ],
)
def test_what_is_unknown_doubled_or_missing_is_refused(head, told, tmp_path):
    file = written(tmp_path / "f.csv", head, list(VALUES.values()))
    with pytest.raises(ck.ArgumentError, match=told):
        read_points("TARGETS", file, pose())


@pytest.mark.parametrize("slip", ["1_0", "０．５", "1٫5", "0x10", "1e", "--1", "${len}", "1d5", "½"])
def test_numbers_are_what_they_look_like(slip, tmp_path):
    (tmp_path / "f.csv").write_text(f"1,2,3\n{slip},2,3\n", encoding="utf-8")
    with pytest.raises(ck.ArgumentError, match="row 2 of f"):
        read_points("TARGETS", tmp_path / "f.csv", pose())
    with pytest.raises(ck.ArgumentError, match="`robot` must give link lengths"):
        ck.problem_from(f"planar:1,{slip}")


def test_what_was_probably_meant_is_said(tmp_path):
    for text, told in (
        ("1;2;3\n4;5;6\n", "separated by commas"),
        ('"0,25",1\n', "write 0.25"),
        ("1_0,1\n", "write 10"),
    ):
        (tmp_path / "f.csv").write_text(text)
        with pytest.raises(ck.ArgumentError, match=told):
            read_points("TARGETS", tmp_path / "f.csv", pose())
