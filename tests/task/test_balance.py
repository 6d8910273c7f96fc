"""The centre of mass: values and rows against Pinocchio, as a task and as walls; what is refused."""

import jax
import numpy as np
import pinocchio as pin
import pytest

import cnclik as ck
from cnclik.errors import Remark
from cnclik.robot.model import modelled
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from cnclik.task.parts import At
from cnclik.task.task import coordinates, rows
from tests.oracles import central_differences, close, robot_file
from tests.refusals import refusals
from tests.robot.test_trees import ARMS, G1, ROBOTS, ROOT, postures
from tests.robot.test_urdf import Pinocchio

FEET = ["left_ankle_roll_link", "right_ankle_roll_link"]


class Weighed(Pinocchio):
    """With a free base, as Pinocchio leaves out what is fixed to a fixed one."""

    def __init__(self, path):
        super().__init__(path, pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()))

    def center(self, names, q):
        full, columns = self.posed(names, q)
        j = pin.jacobianCenterOfMass(self.model, self.data, full) @ columns
        return self.data.com[0].copy(), j, self.data.mass[0]


@pytest.mark.parametrize("name", ["g1", "talos", "icub", "pr2"])
def test_it_is_pinocchios(name):
    """Breaks for a link that is left out, and for a joint that moves what it does not carry."""
    tree, other = read_urdf(ROOT / ROBOTS[name]), Weighed(ROOT / ROBOTS[name])
    robot = chain(tree, tips=tree.tips())
    task, model = ck.center_of_mass().on(robot), modelled(robot)
    every = postures(robot, 3)
    for q, found in zip(every, task.rows_at(model, every), strict=True):
        place, j, mass = other.center(robot.joint_names, q)
        close(ck.com(robot, q), place, atol=1e-12)
        close(found, j, atol=1e-12)
        close(sum(mass for mass, _ in robot.masses), mass, rtol=1e-12)


def seen(robot, task):
    task, model = task.on(robot), modelled(robot)
    return jax.jit(lambda q: (coordinates(task, At(model, q)), rows(task, At(model, q))))


BESIDE = {"lead": "", "first": '<mimic joint="lead" multiplier="2" offset="0.1"/>', "second": '<mimic joint="first"/>'}


@pytest.mark.parametrize(("freeze", "stands"), [({}, 0.4), ({"lead": 0.7}, 0.7)])
def test_mimics_beside_a_tip_follow_where_their_leader_stands(freeze, stands):
    """A mimic of a mimic, too: breaks where a leader counts as at 0 that its limits or `freeze` keep elsewhere."""
    mass, ends = '<inertial><origin xyz="0.3 0 0"/><mass value="1"/></inertial>', ["arm", *BESIDE]
    body = "".join(f'<link name="{link}">{mass}</link>' for link in ["base", *ends])
    for name, parent in zip(ends, ["base", "base", "lead", "first"], strict=True):
        limit = f'<limit lower="{0.4 if name in BESIDE else -1}" upper="1" velocity="1"/>{BESIDE.get(name, "")}'
        links = f'<parent link="{parent}"/><child link="{name}"/><origin xyz="0.2 0 0"/><axis xyz="0 0 1"/>'
        body += f'<joint name="{name}" type="revolute">{links}{limit}</joint>'
    text = f'<robot name="r">{body}</robot>'
    arm, whole = ck.load_urdf(text, tip="arm", freeze=freeze), ck.load_urdf(text, tips=ends)
    assert whole.joint_names == ("arm", "lead")
    close(ck.com(arm, [0.3]), ck.com(whole, [0.3, stands]), atol=1e-14)


def test_rows_as_seen_from_a_foot_are_derivatives():
    robot = ck.load_urdf(G1, tips=[*ARMS, *FEET])
    made, (q,) = seen(robot, ck.center_of_mass("xz", relative_to=FEET[0])), postures(robot, 1, seed=4)
    close(made(q)[1], central_differences(lambda many: [made(one)[0] for one in many], q), atol=1e-10)
    close(made(q)[0], ck.com(robot, q, relative_to=FEET[0])[np.array([0, 2])], atol=1e-14)


def test_robots_that_are_put_together_weigh_both():
    """Two Pandas on a torso: their masses where they stand."""
    torso = ck.load_urdf(G1, tips={"left": "torso_link", "right": ("torso_link", [0, 0, 0.4])})
    panda = ck.load_urdf(robot_file("panda"), tip="panda_hand")
    robot = ck.with_base(
        ck.join(ck.join(torso, panda, at="left", prefix="a_"), panda, at="right", prefix="b_"), [1, 2, 3]
    )
    (q,), arms = postures(torso, 1), postures(panda, 2)
    each = [(torso, ck.com(torso, q))]
    for tip, own in zip(("left", "right"), arms, strict=True):
        at = ck.forward(torso, q, tip=tip)
        each.append((panda, at.position + at.rotation @ ck.com(panda, own)))
    weights = [sum(mass for mass, _ in robot.masses) for robot, _ in each]
    wanted = np.average([np.asarray(c) for _, c in each], axis=0, weights=weights) + np.array([1, 2, 3])
    close(ck.com(robot, np.concatenate([q, *arms])), wanted, atol=1e-13)
    for mixed in (ck.join(torso, ck.panda(), at="left"), ck.join(ck.panda(), torso)):
        with pytest.raises(ck.ArgumentError, match=r"`robot` must have masses.* has none, or was joined from one"):
            ck.com(mixed, np.zeros(mixed.n))
    assert ck.join(ck.panda(), ck.panda(), prefix="b_").masses == ()


test_what_does_not_fit_is_refused = refusals(
    (lambda: ck.com(ck.panda(), np.zeros(7)), "`robot` must have masses, as of a URDF file .* but has none"),
    (lambda: ck.Law(ck.panda(), ck.center_of_mass("xy"), alpha=1.0), "`robot` must have masses"),
    (lambda: ck.center_of_mass("yx"), "`axes` must be letters"),
    (lambda: ck.center_of_mass(relative_to="foot").on(ck.load_urdf(G1, tip=ARMS[0])), "`tip` must be one of"),
)


ARM = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="{}"/></inertial></link>
<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>"""


def test_an_inertial_that_cannot_be_read_is_remarked_on():
    with pytest.warns(Remark, match="Link 'b' of the text has an inertial of 'heavy 0 0 0'"):
        assert ck.load_urdf(ARM.format("heavy")).masses == ()
    assert ck.load_urdf(ARM.format("2.5")).masses[1][0] == 2.5
