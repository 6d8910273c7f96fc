"""Tables of poses are read by their columns' names; numbers are what they look like, and nothing else."""

import itertools
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.errors import Remark
from cnclik.problem.build import problem_from
from cnclik.problem.columns import meanings
from cnclik.problem.tables import read_columns, read_targets
from cnclik.reaching.targets import read
from cnclik.task.build import orientation, pose, position

W = Rotation.from_rotvec([[0.3, -1.1, 0.7], [0.1, 0.2, 2.9]]).as_quat(scalar_first=True)
P = np.array([[0.3, -0.2, 0.5], [0.4, 0.1, 0.45]])
VALUES = dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz"), np.hstack([P, W]).T, strict=True))
HEADS = {
    "ROS": "x,y,z,qx,qy,qz,qw",
    "ours": "x,y,z,qw,qx,qy,qz",
    "quaternion first": "qw,qx,qy,qz,x,y,z",
    "px": "px, py, pz, q_x, q_y, q_z, q_w",
    "pos": "pos_x,pos_y,pos_z,quat_x,quat_y,quat_z,quat_w",
    "a bag": "/pose/position/x,/pose/position/y,/pose/position/z,/pose/orientation/x,/pose/orientation/y,"
    "/pose/orientation/z,/pose/orientation/w",
    "dotted": "position.x,position.y,position.z,orientation.x,orientation.y,orientation.z,orientation.w",
    "camel": "positionX,positionY,positionZ,orientationX,orientationY,orientationZ,orientationW",
    "units": "x [m],y [m],z [m],qx,qy,qz,qw",
    "capitals": "X,Y,Z,QX,QY,QZ,QW",
}


def canonical(head):
    return [what for what, _ in meanings("TARGETS", "f", [name.strip() for name in head.split(",")])]


def written(path, head, columns):
    lines = [",".join(f"{v:.17g}" for v in row) for row in np.stack(columns, 1)]
    path.write_text("\n".join([*[head] * bool(head), *lines]) + "\n")
    return path


@pytest.mark.parametrize("spelling", HEADS)
def test_columns_are_read_by_name(spelling, tmp_path):
    head = HEADS[spelling]
    names = canonical(head)
    file = written(tmp_path / "targets.csv", head, [VALUES[name] for name in names])
    rows, _ = read(read_targets(file, pose()), pose())
    np.testing.assert_allclose(rows[:, :3], P, atol=1e-15)
    np.testing.assert_allclose(
        rows[:, 3:].reshape(-1, 3, 3), Rotation.from_quat(W, scalar_first=True).as_matrix(), atol=1e-15
    )
    np.testing.assert_allclose(read(read_targets(file, position()), position())[0][:, :3], P)
    np.testing.assert_allclose(read(read_targets(file, orientation()), orientation())[0][:, 3:], rows[:, 3:])
    names = ["time", *names]
    file = written(tmp_path / "path.csv", f"timestamp,{head}", [np.array([0.0, 2.0]), *map(VALUES.get, names[1:])])
    reference = problem_from("panda", reference=str(file)).reference
    for t, k in ((0.0, 0), (2.0, 1)):
        place, turn = reference.curve(t)
        np.testing.assert_allclose(place, P[k], atol=1e-6)
        np.testing.assert_allclose(turn, Rotation.from_quat(W[k], scalar_first=True).as_matrix(), atol=1e-5)


def test_names_in_a_comment_above_the_numbers_are_a_header(tmp_path):
    """np.savetxt writes one so; other comments are none, nor is a row that was commented out."""
    names = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    file = tmp_path / "targets.csv"
    np.savetxt(
        file, np.stack([VALUES[name] for name in names], 1), delimiter=",", header=f"made by us\n{','.join(names)}"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", Remark)
        np.testing.assert_allclose(read_targets(file, pose()), np.stack(list(VALUES.values()), 1), atol=1e-15)
    assert read_columns("LOG", file)[0] == tuple(names)
    for comment in ("# in metres, in the base frame, by hand", "# 1e-3,2e-3,nan", "# x y z", "#"):
        written(file, comment, P.T)
        with pytest.warns(Remark, match="no header; its columns were read as x y z"):
            np.testing.assert_array_equal(read_targets(file, position()), P)


def test_every_order_of_the_columns_is_one_file(tmp_path):
    for names in itertools.islice(itertools.permutations(VALUES), 0, 5040, 331):
        file = written(tmp_path / "targets.csv", ",".join(names), [VALUES[name] for name in names])
        np.testing.assert_array_equal(read_targets(file, pose()), np.stack(list(VALUES.values()), 1))


def test_units_and_transforms_in_heads(tmp_path):
    file = written(tmp_path / "t.csv", "x [mm],y (mm),z [cm]", [1e3 * P[:, 0], 1e3 * P[:, 1], 1e2 * P[:, 2]])
    np.testing.assert_allclose(read_targets(file, position()), P, rtol=1e-15)
    whole = np.tile(np.eye(4), (2, 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = Rotation.from_quat(W, scalar_first=True).as_matrix(), P
    columns = {f"t{i}{j}": whole[:, i, j] for i in range(4) for j in range(4)}
    names = sorted(columns, key=lambda name: name[::-1])  # column by column
    file = written(tmp_path / "t.csv", ",".join(names), [columns[name] for name in names])
    np.testing.assert_array_equal(read_targets(file, pose()), whole)
    file = written(tmp_path / "way.csv", "time [ms],y,x", [np.array([0.0, 2000.0]), P[:, 1], P[:, 0]])
    found = problem_from("planar:0.4,0.4", task="xy", reference=str(file)).reference
    np.testing.assert_allclose(found.curve(2.0)[0], P[1, :2], atol=1e-6)


@pytest.mark.parametrize(
    ("head", "told"),
    [
        ("x,y,z,qx,qy,qz,q4", "columns such as time, x, y, z, qw, qx, qy, qz, but f.csv has 'q4'"),
        ("x,y,z,roll,pitch,yaw,w", "but f.csv has 'roll'"),
        ("x,y,z,w,x,y,z", "name each column once, .* f.csv has 'x' and 'x'"),
        ("x,y,z,qx,q_x,qz,qw", "name each column once, .* f.csv has 'qx' and 'q_x'"),
        ("x,y,z,qx,qy,qz,time", "all of qw … qz, but f.csv lacks qw"),
        ("x [in],y,z,qx,qy,qz,qw", r"x must be in m, cm, mm, um, but f.csv has 'x \[in\]'"),
        ("x,y,qw,qx,qy,qz,t", "columns z for this task, but f.csv has x y qw qx qy qz time"),
        ("x,y,z,qx,qy,qz", "name every column, but f.csv has 6 names and 7 columns|lacks qw"),
    ],
)
def test_what_is_unknown_doubled_or_missing_is_refused(head, told, tmp_path):
    file = written(tmp_path / "f.csv", head, list(VALUES.values()))
    with pytest.raises(ck.ArgumentError, match=told):
        read_targets(file, pose())


def test_without_a_head_the_order_is_told(tmp_path):
    file = written(tmp_path / "f.csv", "", list(VALUES.values()))
    with pytest.warns(Remark, match="f.csv has no header; its columns were read as x y z qw qx qy qz"):
        read_targets(file, pose())
    file = written(tmp_path / "way.csv", "", [np.array([0.0, 1.0]), *P.T])
    with pytest.warns(Remark, match="way.csv has no header; its columns were read as time x y z"):
        problem_from("panda", reference=str(file))
    file = written(tmp_path / "way.csv", "", [np.array([0.0, 1.0]), *P.T[:2]])
    with pytest.warns(Remark, match="read as time x y"):
        problem_from("planar:0.4,0.4", task="xy", reference=str(file))


SLIPS = ["1_0", "０．５", "1٫5", "0x10", "1e", "--1", "${len}", "1d5", "½"]


@pytest.mark.parametrize("slip", SLIPS)
def test_numbers_are_what_they_look_like(slip, tmp_path):
    (tmp_path / "f.csv").write_text(f"1,2,3\n{slip},2,3\n", encoding="utf-8")
    with pytest.raises(ck.ArgumentError, match="row 2 of f"):
        read_targets(tmp_path / "f.csv", pose())
    with pytest.raises(ck.ArgumentError, match=r"`path` .* joint 'j1' of the text has origin xyz"):
        ck.load_urdf(f"""<robot name="a"><link name="a"/><link name="b"/><joint name="j1" type="continuous"><parent
        link="a"/><child link="b"/><origin xyz="0 0 {slip}"/></joint></robot>""")
    with pytest.raises(ck.ArgumentError, match="`robot` must give link lengths"):
        problem_from(f"planar:1,{slip}")


def test_what_was_probably_meant_is_said(tmp_path):
    for text, told in (("1;2;3\n4;5;6\n", "separated by commas"), ('"0,25",1\n', "write 0.25"), ("1_0,1\n", "write 10"),
                       ("x;y\n1;2\n", "separated by commas")):  # fmt: skip
        (tmp_path / "f.csv").write_text(text)
        with pytest.raises(ck.ArgumentError, match=told):
            read_targets(tmp_path / "f.csv", pose())
