"""The kinematic tree of a robot's file: links, joints, limits, masses. A URDF file is read without loading JAX."""

import collections
import dataclasses
import functools
import math
import os
import pathlib

from cnclik import errors, quantities
from cnclik.reading import read_bytes
from cnclik.robot.fixed import IDENTITY, ZERO, matmul, snapped, turn

MOVING = ("revolute", "continuous", "prismatic")
BALL = "rotation"  # kind of each of three joints that form a rotation; their values are its rotation vector
MOST = 1e12  # largest length or angle [m, rad]: products of larger ones overflow
NO_OFFSET = ZERO, IDENTITY


@dataclasses.dataclass(frozen=True)
class Edge:
    """A joint of the tree, as in the file."""

    name: str
    type: str
    parent: str
    child: str
    origin: tuple = NO_OFFSET  # position [m], rows of the rotation
    axis: tuple = (1.0, 0.0, 0.0)
    lower: float = -math.inf  # [rad, m]
    upper: float = math.inf
    velocity: float = math.inf  # [rad/s, m/s]
    mimic: tuple | None = None  # (joint name, multiplier, offset)


@dataclasses.dataclass(frozen=True)
class Tree:
    """The kinematics of a URDF file: one root; every other link is the child of one joint."""

    file: str
    name: str
    root: str
    links: tuple
    edges: tuple  # of Edge, in the file's order
    inertials: dict  # link name -> (mass [kg], its centre in the link's frame [m]), of links with a mass

    @functools.cached_property
    def above(self) -> dict:
        """Link name -> the joint that carries it."""
        return {e.child: e for e in self.edges}

    @functools.cached_property
    def below(self) -> dict:
        """Link name -> the joints on it."""
        joints = {link: [] for link in self.links}
        for e in self.edges:
            joints[e.parent].append(e)
        return joints

    def way(self, tip, base=None) -> tuple:
        """Return the path from base (default: the root) to tip: joints up to the common link, and down from there."""
        up, down = ([*self._upward(link)] for link in (base or self.root, tip))
        while up and down and up[-1] is down[-1]:
            up.pop(), down.pop()
        return tuple(up), tuple(reversed(down))

    def _upward(self, link):
        """Yield the joints from a link to the root."""
        while link in self.above:
            yield self.above[link]
            link = self.above[link].parent

    def tips(self, base=None) -> tuple:
        """Return the leaf links that joints move against the base, those of most joints first: candidates for a tip."""
        links = [(base or self.root, 0)]
        for link, joints in links:
            links += [(e.child, joints + (e.type != "fixed")) for e in self.below[link]]
        leaves = {link: joints for link, joints in links if joints and not self.below[link]}
        return tuple(sorted(leaves, key=leaves.__getitem__, reverse=True))


def text_of(file) -> str | None:
    """Return the text of a file that is given as such, which begins with "<"."""
    text = file.lstrip("\ufeff \t\r\n") if isinstance(file, str) else ""
    return text if text.startswith("<") else None


def read_urdf(path) -> Tree:
    """Return the whole kinematic tree of a URDF file, or of its text, which begins with "<".

    Raises: ArgumentError as `load_urdf`.
    """
    file, data = "the text", text_of(path)
    if data is None:
        data = read_bytes("path", path, "a URDF file")
        file = pathlib.Path(os.fsdecode(path)).name
    root = _root(file, data)
    try:
        links = tuple(element.attrib["name"] for element in root.iterfind("link"))
        edges = tuple(_edge(file, element) for element in root.iterfind("joint"))
    except (KeyError, AttributeError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise errors.fail("path", "name a valid URDF file", f"{file} has a bad or missing entry: {reason}") from None
    top, name = _top(file, links, edges), root.get("name", file)
    return Tree(file=file, name=name, root=top, links=links, edges=edges, inertials=_inertials(file, root))


def _root(file, data):
    """Return the outermost element, <robot>. Prefixes need not be declared, as ROS tools write undeclared ones."""
    from xml.etree import ElementTree
    from xml.parsers import expat

    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(data, True)
        root = builder.close()
    except (expat.ExpatError, ValueError, AssertionError, LookupError) as error:  # a LookupError is an unknown encoding
        raise errors.fail("path", "name a URDF file", f"{file} is not well-formed XML: {error}") from None
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise errors.fail("path", "name a plain URDF file", f"{file} is xacro: run `xacro {file} -o robot.urdf` first")
    if root.tag != "robot":
        raise errors.fail("path", "name a URDF file", f"{file} holds <{root.tag}>, not <robot>")
    return root


def _numbers(text) -> list:
    """Return the numbers of a text; NaN for a word that is none."""
    return [math.nan if (x := quantities.number(word)) is None else x for word in text.split()]


def _edge(file, element) -> Edge:
    """Return a joint, checked."""
    name, kind = element.attrib["name"], element.get("type")
    parent, child = (element.find(end).get("link") for end in ("parent", "child"))

    def bad(what):
        return errors.fail("path", "name a valid URDF file", f"joint {name!r} of {file} {what}")

    def numbers(part, key, default, most=MOST):
        inside = element.find(part)
        text = default if inside is None else inside.get(key, default)
        values = _numbers(text)
        if len(values) != len(default.split()) or not all(abs(x) <= most for x in values):  # refuses NaN, too
            count = {1: "a number", 3: "three numbers"}[len(default.split())]
            raise bad(f"has {part} {key} {text!r}, not {count} within ±{MOST:g}")
        return values

    origin = snapped(numbers("origin", "xyz", "0 0 0")), _rotation(*numbers("origin", "rpy", "0 0 0"))
    if kind in ("fixed", "floating"):
        return Edge(name, kind, parent, child, origin)
    if kind not in (*MOVING, "planar"):
        raise bad(f"has type {kind!r}")
    axis = numbers("axis", "xyz", "1 0 0")
    length = math.hypot(*axis)
    if not length > 0:
        raise bad(f"has axis {' '.join(f'{x:g}' for x in axis)}")
    edge = Edge(name, kind, parent, child, origin, snapped(x / length for x in axis))
    if kind == "planar":
        if edge.axis != (0.0, 0.0, 1.0):
            raise bad("is planar and has an axis that is not 0 0 1")
        return edge
    limit, mimic = element.find("limit"), element.find("mimic")
    if limit is None and kind != "continuous" and mimic is None:
        raise bad(f"is {kind} and has no <limit>")
    bounds: dict = {}
    if kind != "continuous" and limit is not None and {"lower", "upper"} & set(limit.keys()):
        lower, upper = (numbers("limit", key, "0", math.inf)[0] for key in ("lower", "upper"))
        if lower > min(upper, MOST) or upper < -MOST:
            raise bad(f"has limits from {lower:g} to {upper:g}")
        # exporters write 1e16 and the like for none
        bounds = {"lower": lower if lower >= -MOST else -math.inf, "upper": upper if upper <= MOST else math.inf}
    if mimic is not None:
        factor, shift = numbers("mimic", "multiplier", "1")[0], numbers("mimic", "offset", "0")[0]
        bounds["mimic"] = mimic.get("joint"), factor, shift
    velocity = abs(numbers("limit", "velocity", "0", math.inf)[0]) or math.inf  # 0 is an unknown limit
    return dataclasses.replace(edge, velocity=velocity, **bounds)


def _rotation(roll, pitch, yaw):
    """Return the rows of Rz(yaw)·Ry(pitch)·Rx(roll)."""
    x, y, z = IDENTITY
    return tuple(map(snapped, matmul(turn(z, yaw), matmul(turn(y, pitch), turn(x, roll)))))


def _inertials(file, root) -> dict:
    """Return {link: (mass, its centre)}; empty, with a remark, if one is unreadable: kinematics needs none of them."""
    masses = {}
    for link in root.iterfind("link"):
        mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
        if mass is None:
            continue
        text = f"{mass.get('value')} {'0 0 0' if origin is None else origin.get('xyz', '0 0 0')}"
        values = _numbers(text)
        if len(values) != 4 or not all(abs(x) <= MOST for x in values) or values[0] < 0:
            what = f"Link {link.get('name')!r} of {file} has an inertial of {text!r}"
            errors.remark(f"{what}: the robot is taken as one without masses.")
            return {}
        if values[0]:
            masses[link.get("name")] = values[0], tuple(values[1:])
    return masses


def _top(file, links, edges) -> str:
    """Return the root. Raises: ArgumentError for names that occur twice, unknown links, several roots and loops."""

    def bad(what):
        return errors.fail("path", "name a robot that is a tree of links", f"{file} {what}")

    children = [edge.child for edge in edges]
    several = {"more than one link": links, "more than one joint": [edge.name for edge in edges]}
    for what, names in (several | {"a loop: two joints carry link": children}).items():
        if twice := [name for name, count in collections.Counter(names).items() if count > 1]:
            raise bad(f"has {what} {twice[0]!r}")
    below: dict = {link: [] for link in links}
    for edge in edges:
        if unknown := [link for link in (edge.parent, edge.child) if link not in below]:
            raise bad(f"has no link {unknown[0]!r}, which joint {edge.name!r} connects")
        below[edge.parent].append(edge.child)
    roots = sorted(below.keys() - children, key=links.index)
    reached = [*roots]
    for link in reached:
        reached += below[link]
    if apart := sorted(below.keys() - reached, key=links.index):
        raise bad(f"has a loop through link {apart[0]!r}")
    if len(roots) != 1:
        raise bad(f"has {len(roots):,} roots: {', '.join(roots)}" if roots else "has no links")
    return roots[0]
