"""URDF files: random trees that are valid, then mutated, from a wrong number to a byte that flipped."""

import contextlib
import copy
import io
import xml.etree.ElementTree as ET

import numpy as np

from cnclik.cli import main
from cnclik.errors import ArgumentError
from cnclik.robot.model import frames, jacobian_rows, modelled
from cnclik.robot.posture import arm_length, start_posture
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from cnclik.task.build import position
from tests.stress.fuzz.judge import one_line
from tests.stress.fuzz.nasty import NUMBERS, TEXTS, any_of, chance, damaged, slipped

TYPES = ("revolute", "continuous", "prismatic", "fixed", "revolute", "revolute", "floating", "planar")
LIMITS = (  # one-sided, frozen, huge, without 0, crossed
    *(
        ("-1e16", "1e16"),
        ("0", "1e16"),
        ("0", "0"),
        ("0.5", "0.5"),
        ("1", "2"),
        ("-2", "-1"),
        ("2", "1"),
        ("-inf", "2"),
    ),
    *(
        ("-1.5", "inf"),
        ("-6.3", "6.3"),
        ("-180", "180"),
        ("", "1"),
        ("-1e-9", "1e-9"),
        ("-1e308", "1e308"),
        ("0", "nan"),
    ),
)
SPEEDS = ("1", "1", "1", "0", "1e16", "1e-9", "-1", "inf")
HEADS = (
    *(b"", b"", b'<?xml version="1.0"?>', b'<?xml version="1.0" encoding="klingon"?>', b"\xef\xbb\xbf", b"\n", b"\x00"),
    *(b'<?xml version="1.0" encoding="utf-16"?>', b'<?xml version="1.0" encoding="latin-1"?>', b"<!-- a -- b -->"),
    b'<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>',
    b'<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
)


def draw(rng) -> bytes:
    robot = _tree(rng, int(rng.integers(1, 12)) if chance(rng, 0.995) else int(rng.integers(200, 1500)))
    for _ in range(int(rng.integers(4))):
        _mutate(rng, robot)
    with contextlib.suppress(TypeError, ValueError):  # what can't be written is no input
        data = ET.tostring(robot)
        if chance(rng, 0.1):
            data = any_of(rng, HEADS) + data
        if chance(rng, 0.1):
            data = data.replace(b'"0"', b'"&b;"', 2)
        if chance(rng, 0.02):
            data = data.decode(errors="replace").encode(any_of(rng, ("utf-16", "utf-32", "utf-7", "cp037")))
        return damaged(rng, data) if chance(rng, 0.2) else data
    return rng.bytes(int(rng.integers(300)))


def _tree(rng, count):
    robot = ET.Element("robot", name="r")
    ET.SubElement(robot, "link", name="l0")
    thin = chance(rng, 0.5)
    for k in range(1, count):
        ET.SubElement(robot, "link", name=f"l{k}")
        joint = ET.SubElement(robot, "joint", name=f"j{k}", type=any_of(rng, TYPES[: 6 if chance(rng, 0.9) else 8]))
        ET.SubElement(joint, "parent", link=f"l{k - 1 if thin else int(rng.integers(k))}")
        ET.SubElement(joint, "child", link=f"l{k}")
        if chance(rng, 0.7):
            ET.SubElement(joint, "origin", xyz=_three(rng), rpy=_three(rng))
        if chance(rng, 0.7):
            ET.SubElement(joint, "axis", xyz=any_of(rng, ("0 0 1", "0 1 0", "1 0 0", "-1 0 0", "1 1 0", "0.1 0.2 0.3")))
        lower, upper = any_of(rng, LIMITS) if chance(rng, 0.3) else ("-1.5", "2")
        ET.SubElement(joint, "limit", lower=lower, upper=upper, velocity=any_of(rng, SPEEDS), effort="10")
        if k > 1 and chance(rng, 0.1):
            ET.SubElement(joint, "mimic", joint=f"j{int(rng.integers(1, k + 1))}", multiplier="-2", offset="0.1")
    return robot


def _three(rng):
    return " ".join(f"{v:.3g}" for v in rng.normal(size=3)) if chance(rng, 0.7) else "0 0 0"


def _mutate(rng, robot):
    parents = [e for e in robot.iter() if len(e)]
    one = any_of(rng, [*robot.iter()])
    keys = [*one.attrib]
    key = any_of(rng, keys) if keys else "name"
    match int(rng.integers(11)):
        case 0 | 1 | 2:
            words = one.get(key, "0").split() or ["0"]
            words[int(rng.integers(len(words)))] = any_of(rng, NUMBERS)
            one.set(key, " ".join(words))
        case 3:
            one.set(key, any_of(rng, TEXTS))
        case 4:
            one.attrib.pop(key, None)
        case 5:
            one.set(slipped(rng, key) or "x", one.attrib.pop(key, "1"))
        case 6 if parents:
            parent = any_of(rng, parents)
            parent.remove(any_of(rng, [*parent]))
        case 7 if parents:
            any_of(rng, parents).append(copy.deepcopy(any_of(rng, [*robot.iter()][1:] or [robot])))
        case 8:
            one.tag = any_of(
                rng, ("link", "joint", "origin", "mimic", "limit", "robot", "xacro:macro", "gazebo", "a:b")
            )
        case 9:
            names = [e.get("name", "") for e in robot.iter() if e.tag in ("link", "joint")]
            one.set(any_of(rng, ("link", "joint", "name", key)), any_of(rng, names) if names else "l0")
        case _:
            one.text = any_of(rng, TEXTS)


def attempt(data: bytes, folder) -> None:
    """The tree, the chains to some of its tips, where their tips are; and what `cnclik robots` says of it."""
    file = folder / "robot.urdf"
    file.write_bytes(data)
    tree = read_urdf(file)
    for base, tip in ((None, (*tree.tips(), None)[0]), (tree.links[0], tree.links[-1])):
        with contextlib.suppress(ArgumentError):
            _sound(chain(tree, tip, base))
    if len(data) % 8 == 0:
        said = io.StringIO()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            code = 0
            try:
                main(["robots", str(file)])
            except SystemExit as leaving:
                code = leaving.code
        one_line(code, said.getvalue())


def _sound(made) -> None:
    """All that follows from a chain is finite: its tip and Jacobian at zero and where a loop would start."""
    q = start_posture(made, position())
    assert np.isfinite(arm_length(made)) and np.isfinite(q).all(), f"length {arm_length(made)}, start {q}"
    lower, upper = np.array(made.lower), np.array(made.upper)
    assert ((lower <= q) & (q <= upper)).all(), f"the start {q} is not within {lower} and {upper}"
    for at in (np.zeros(made.n), q):
        found = frames(modelled(made), at)
        rows = jacobian_rows(modelled(made), found, (0, 1, 2), (0, 1, 2))
        for values in (found.position, found.rotation, rows):
            assert np.isfinite(np.asarray(values, float)).all(), f"{values} at {at}"
    str(made), made.units, made.periodic
