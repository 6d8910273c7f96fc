"""Poses: every door takes the same forms with the same tolerances, and refuses the same in the same words."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.problem.build import problem_from
from cnclik.reaching.targets import read
from cnclik.task.build import orientation, pose

ARM = ck.planar_arm([0.5, 0.4])
TURN = Rotation.from_rotvec([0.3, -1.1, 0.7])
R, P = TURN.as_matrix(), np.array([0.3, -0.2, 0.5])
W = TURN.as_quat(scalar_first=True)
T = np.block([[R, P[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def at_rest(reference):
    return [np.array(v) for v in reference.curve(0.0)]


def tip_of(chain):
    made = ck.forward(chain, np.zeros(chain.n))
    return [np.array(made.position), np.array(made.rotation)]


def rows(found):
    found = found[0][0]
    return [found[:3], found[3:].reshape(3, 3)]


STRAIGHT = ck.from_dh([0.0], [0.0], [0.0])  # at 0 the tip is where the base is
DOORS = {
    "hold": lambda x: at_rest(ck.hold(x)),
    "line": lambda x: at_rest(ck.line(x, [0.0, 0.0, 0.0], duration=1.0)),
    "reach": lambda x: rows(read(x, pose())),
    "with_tool": lambda x: tip_of(ck.with_tool(STRAIGHT, x)),
    "with_base": lambda x: tip_of(ck.with_base(STRAIGHT, x)),
}
FORMS = {
    "array": T,
    "lists": T.tolist(),
    "JAX": jnp.asarray(T),
    "seven numbers": [*P, *W],
    "Pose": ck.Pose(position=P, rotation=R),
    "SE3": pin.SE3(R, P),
    "an object with a quaternion": types.SimpleNamespace(translation=P, rotation=W),
    "a quaternion of two decimals more": [*P, *(1.004 * W)],
    "rounded to five decimals": np.round(T, 5),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("door", DOORS)
def test_every_door_takes_every_form(door, form):
    place, turn = DOORS[door](FORMS[form])
    near = 1e-5 if form.startswith("rounded") else 2e-7 if form == "JAX" else 1e-14
    np.testing.assert_allclose(place, P, atol=near)
    np.testing.assert_allclose(turn, R, atol=near)
    if form.startswith("rounded"):  # is made a rotation, however rough
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)


SHEARED = T.copy()
SHEARED[0, 1] += 0.01
ENDS = T.copy()
ENDS[3, 3] = 2
MIRRORED = T @ np.diag([1.0, 1, -1, 1])
SCALED = T @ np.diag([1.01, 1.01, 1.01, 1])
WRONG = {
    "transposed": (T.T, "must have the last row 0 0 0 1, but has 0.3 -0.2 0.5 1 .a transposed one has the transl"),
    "last row": (ENDS, "must have the last row 0 0 0 1, but has 0 0 0 2"),
    "scaled": (SCALED, "must hold a rotation, with rows of length 1 at right angles, but is off by 0.0201"),
    "mirrored": (MIRRORED, "must hold a rotation, .* but is mirrored"),
    "sheared": (SHEARED, "must hold a rotation, .* but is off by"),
    "a scaled Pose": (ck.Pose(position=P, rotation=2 * R), "must hold a rotation, .* but is off by 3"),
    "quaternion": ([*P, *(185 * W)], "must hold a unit quaternion w x y z, but has one of norm 185"),
    "no quaternion": ([*P, 0, 0, 0, 0], "must hold a unit quaternion w x y z, but has one of norm 0"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
@pytest.mark.parametrize("door", DOORS)
def test_every_door_refuses_the_same(door, what):
    value, told = WRONG[what]
    with pytest.raises(ck.ArgumentError, match=told):
        DOORS[door](value)


def test_of_many_the_first_wrong_one_is_named():
    many = np.stack([T] * 5)
    for wrong, told in ((T.T, "last row"), (SCALED, "off by 0.0201")):
        many[3] = wrong
        with pytest.raises(ck.ArgumentError, match=f"{told}.* at index 3"):
            read(many, pose())
    turns = np.stack([W] * 5)
    turns[2] *= 1.02
    for door in (
        lambda q: ck.waypoints([0, 1, 2, 3, 4], None, q),
        lambda q: read(q, orientation()),
        lambda q: read((np.zeros((5, 3)), q), pose()),
    ):
        with pytest.raises(ck.ArgumentError, match=r"hold unit quaternions .* norm 1\.02 at index 2"):
            door(turns)
    with pytest.raises(ck.ArgumentError, match=r"`target` must hold a unit quaternion .* norm 1\.02"):
        problem_from("panda", target=[*P, *(1.02 * W)])


def test_entries_may_be_traced():
    def place(x):
        at = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.2], [0.0, 0.0, 0.0, 1.0]]
        held = ck.hold([x, 0.3]).curve, ck.with_tool(STRAIGHT, at).tips[0].offset, ck.hold(at).curve
        return sum(one.position[0] for one in held)

    assert jax.jit(jax.value_and_grad(place))(2.0) == (6, 3)


def test_four_quaternions_are_no_transform():
    four = Rotation.random(4, random_state=0).as_quat(scalar_first=True)
    rows, alone = read(four, orientation())
    assert rows.shape == (4, 12) and not alone
    assert read(T, orientation())[1]  # a translation tells
    assert read(np.eye(4), orientation())[1]  # its last row is a transform's
    assert read((None, np.eye(4)), orientation())[0].shape == (4, 12)
    assert read(np.eye(4)[None], orientation())[0].shape == (1, 12)
    assert read(np.eye(4), pose())[1]  # a pose has one reading


def test_a_list_of_poses_of_pinocchio_is_its_transforms():
    some = [pin.SE3(R, P), pin.SE3(R.T, -P)]
    for task in (pose(), orientation()):
        found, alone = read(some, task)
        np.testing.assert_array_equal(found, read(np.stack([one.homogeneous for one in some]), task)[0])
        assert not alone
