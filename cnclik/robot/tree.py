"""The kinematic tree of a URDF file: links, joints, limits, masses. Read without loading JAX.

Meshes and plugin sections are skipped, so no other files are needed.
"""

import codecs
import collections
import dataclasses
import functools
import math
import pathlib
import re
from typing import NamedTuple

from cnclik import errors, quantities
from cnclik.reading import read_bytes
from cnclik.robot.plausible import remark_on_angles

MOVING = ("revolute", "continuous", "prismatic")
_OWN = ("utf-8", "utf8", "utf-16", "us-ascii", "ascii", "iso-8859-1")  # encodings that the parser knows
MOST = 1e12  # largest length or angle [m, rad]: products of larger ones overflow
NO_OFFSET = (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


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
        found = {link: [] for link in self.links}
        for e in self.edges:
            found[e.parent].append(e)
        return found

    @property
    def leaves(self) -> tuple:
        return tuple(link for link in self.links if not self.below[link])

    def way(self, tip, base=None) -> tuple:
        """The path from base (default: the root) to tip: joints up to the common link, and down from there."""
        up, down = ([*self._upward(link)] for link in (base or self.root, tip))
        while up and down and up[-1] is down[-1]:
            up.pop(), down.pop()
        return tuple(up), tuple(reversed(down))

    def _upward(self, link):
        """The joints from a link to the root."""
        while link in self.above:
            yield self.above[link]
            link = self.above[link].parent

    def tips(self, base=None) -> tuple:
        """Leaf links that some joint moves against the base: the candidates for a tip."""
        moved, waiting = {}, [(base or self.root, False)]
        while waiting:
            link, moves = waiting.pop()
            moved[link] = moves
            waiting += [(e.child, moves or e.type != "fixed") for e in self.below[link]]
        return tuple(leaf for leaf in self.leaves if moved.get(leaf))


def text_of(file) -> str | None:
    """The text of a file that is given as such, which begins with "<"."""
    text = file.lstrip("\ufeff \t\r\n") if isinstance(file, str) else ""
    return text if text.startswith("<") else None


def read_urdf(path) -> Tree:
    """The whole kinematic tree of a URDF file, or of its text, which begins with "<". Raises ArgumentError as
    `load_urdf`.
    """
    file, data = "the text", text_of(path)
    if data is None:
        try:
            path = pathlib.Path(path)
        except TypeError:
            raise errors.fail("path", "be a file name", f"is {path!r}") from None
        file, data = path.name, read_bytes("path", path, "a URDF file")
    root = _root(file, data)
    try:
        links = tuple(element.attrib["name"] for element in root.findall("link"))
        joints = [_written(file, element) for element in root.findall("joint")]
    except (KeyError, AttributeError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise errors.fail("path", "name a valid URDF file", f"{file} has a bad or missing entry: {reason}") from None
    for joint in joints:
        what = f"The rpy of joint {joint.name!r} in {file}"
        if joint.origin is not None and remark_on_angles(what, joint.origin[1]):
            break
    return _tree(file, root.get("name", file), links, joints, _inertials(file, root))


def _root(file, data):
    """The file's outermost element, <robot>.

    Well-formedness is checked strictly; prefixes need not be declared, as ROS tools write undeclared ones.
    """
    from xml.etree import ElementTree
    from xml.parsers import expat

    data = data if isinstance(data, str) else _decoded(file, data)
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: builder.start(tag, attributes)
    parser.EndElementHandler = builder.end
    try:
        parser.Parse(data, True)
        root = builder.close()
    except (expat.ExpatError, ValueError, AssertionError, LookupError) as error:  # a LookupError is an unknown encoding
        empty = not data.strip()
        what = "is empty" if empty else f"is not well-formed XML: {error}"
        raise errors.fail("path", "name a URDF file", f"{file} {what}") from None
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise errors.fail("path", "name a plain URDF file", f"{file} is xacro: run `xacro {file} -o robot.urdf` first")
    if root.tag != "robot":
        raise errors.fail("path", "name a URDF file", f"{file} holds <{root.tag}>, not <robot>")
    return root


class _Written(NamedTuple):
    """A joint as in the file, unchecked."""

    name: str
    type: str
    parent: str
    child: str
    origin: tuple | None  # position, and the angles roll, pitch, yaw about the fixed axes
    axis: tuple
    limit: tuple | None  # lower, upper, velocity; None if not given
    mimic: tuple | None


def _decoded(file, data: bytes):
    """Bytes unchanged if the parser knows their encoding, otherwise the decoded text."""
    named = re.match(rb"""\s*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._-]+)["']""", data)
    encoding = named[1].decode() if named else "utf-8"
    try:
        text = data.decode(encoding)
        return data if encoding.lower() in _OWN else text
    except (LookupError, UnicodeDecodeError) as error:
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or encoding.lower() == "utf-16":
            return data
        wrong = "an unknown encoding" if isinstance(error, LookupError) else "and is not"
        what = f"is {'said to be ' if named else 'taken for '}{encoding}, {wrong}: save it as UTF-8"
        raise errors.fail("path", "name a URDF file", f"{file} {what}") from None


def _written(file, element) -> _Written:
    origin, axis, limit, mimic = (element.find(part) for part in ("origin", "axis", "limit", "mimic"))

    def bad(what):
        return errors.fail("path", "name a valid URDF file", f"joint {element.get('name')!r} of {file} has {what}")

    def one(part, name, text):
        value = quantities.number(text)
        if value is None:
            raise bad(f"{part} {name} {text!r}{quantities.hint(text)}")
        return value

    def number(part, name, default=None):
        text = part.get(name)
        return default if text is None else one(part.tag, name, text)

    def three(part, name, default="0 0 0"):
        text = part.get(name, default)
        values = tuple(one(part.tag, name, word) for word in (text.split() if "$" not in text else [text]))
        if len(values) != 3:
            raise bad(f"{part.tag} {name} {text!r}, not three numbers")
        return values

    return _Written(
        name=element.attrib["name"],
        type=element.get("type"),
        parent=element.find("parent").get("link"),
        child=element.find("child").get("link"),
        origin=None if origin is None else (three(origin, "xyz"), three(origin, "rpy")),
        axis=(1.0, 0.0, 0.0) if axis is None else three(axis, "xyz", "1 0 0"),
        limit=None if limit is None else tuple(number(limit, name) for name in ("lower", "upper", "velocity")),
        mimic=None
        if mimic is None
        else (mimic.get("joint"), number(mimic, "multiplier", 1.0), number(mimic, "offset", 0.0)),
    )


def _inertials(file, root) -> dict:
    """{link: (mass, its centre)}; empty, with a remark, if one is unreadable, as kinematics needs none of them."""
    found = {}
    for link in root.iterfind("link"):
        mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
        if mass is None:
            continue
        words = [mass.get("value", ""), *("0 0 0" if origin is None else origin.get("xyz", "0 0 0")).split()]
        of, *center = [math.nan if (x := quantities.number(word)) is None else x for word in words]
        if len(center) != 3 or not (0 <= of <= MOST and all(abs(x) <= MOST for x in center)):
            what = f"Link {link.get('name')!r} of {file} has an inertial of {' '.join(words)!r}"
            errors.remark(f"{what}: the robot is taken as one without masses.")
            return {}
        if of:
            found[link.get("name")] = of, tuple(center)
    return found


def _rotation(roll, pitch, yaw):
    """Rows of Rz(yaw)·Ry(pitch)·Rx(roll)."""
    (a, b, c), (d, e, f) = ([turn(angle) for angle in (roll, pitch, yaw)] for turn in (math.sin, math.cos))
    return (
        (f * e, f * b * a - c * d, f * b * d + c * a),
        (c * e, c * b * a + f * d, c * b * d - f * a),
        (-b, e * a, e * d),
    )


def _tree(file, name, links, joints, inertials) -> Tree:
    """The robot as a checked tree: names unique, links known, one root, no loop."""

    def bad(what):
        return errors.fail("path", "name a robot that is a tree of links", f"{file} {what}")

    if not links:
        raise bad("has no links")
    known = set(links)
    for kind, names in (("link", links), ("joint", [j.name for j in joints])):
        twice = sorted(n for n, count in collections.Counter(names).items() if count > 1)
        if twice:
            raise bad(f"has more than one {kind} {twice[0]!r}")
    parent = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in known:
                raise bad(f"has no link {link!r}, which joint {joint.name!r} connects")
        if joint.child in parent:
            raise bad(f"has a loop: link {joint.child!r} hangs on {parent[joint.child].name!r} and {joint.name!r}")
        parent[joint.child] = joint
    rooted = known - set(parent)
    for link in links:  # go up from every link until a known one: who meets itself is in a loop
        way = {}
        while link not in rooted:
            if link in way:
                raise bad(f"has a loop through link {link!r}")
            way[link] = None
            link = parent[link].parent
        rooted |= set(way)
    roots = [link for link in links if link not in parent]
    if len(roots) > 1:
        more = f" and {len(roots) - 5:,} more" if len(roots) > 6 else ""
        raise bad(f"has {len(roots):,} roots: {', '.join(roots[: 5 if more else 6])}{more}")
    edges = tuple(_edge(file, joint) for joint in joints)
    return Tree(file=file, name=name, root=roots[0], links=links, edges=edges, inertials=inertials)


def _edge(file, joint) -> Edge:
    def bad(what):
        return errors.fail("path", "name a valid URDF file", f"joint {joint.name!r} of {file} {what}")

    origin, axis = NO_OFFSET, (1.0, 0.0, 0.0)
    if joint.origin is not None:
        position, angles = joint.origin
        if not all(abs(x) <= MOST for x in (*position, *angles)):  # refuses NaN, too
            raise bad(f"has an origin that is not finite, or not within ±{MOST:g}")
        origin = snapped(position), tuple(map(snapped, _rotation(*angles)))
    lower, upper, velocity, mimic = -math.inf, math.inf, math.inf, None
    if joint.type not in (*MOVING, "fixed", "floating", "planar"):
        raise bad(f"has type {joint.type!r}")
    if joint.type in (*MOVING, "planar"):
        vector = joint.axis
        length = math.hypot(*vector)
        if not math.isfinite(length) or length == 0:
            raise bad(f"has axis {' '.join(f'{x:g}' for x in vector)}")
        axis = snapped(x / length for x in vector)
    if joint.type in MOVING:
        if joint.limit is None and joint.type != "continuous" and joint.mimic is None:
            raise bad(f"is {joint.type} and has no <limit>")
        if joint.limit is not None:
            low, high, velocity = joint.limit
            if joint.type != "continuous" and (low, high) != (None, None):
                lower, upper = low or 0.0, high or 0.0  # by the format, one omitted limit is 0
            velocity = abs(velocity or math.inf)  # exporters write 0 for an unknown limit
        if math.isnan(lower) or math.isnan(upper) or math.isnan(velocity):
            raise bad("has a limit that is not a number")
        if lower > upper:
            raise bad(f"has lower limit {lower:g} above upper limit {upper:g}")
        if lower > MOST or upper < -MOST:
            raise bad(f"has limits from {lower:g} to {upper:g}, neither of them within ±{MOST:g}")
        lower = lower if lower >= -MOST else -math.inf  # exporters write 1e16 and the like for none
        upper = upper if upper <= MOST else math.inf
        if joint.mimic is not None:
            mimic = joint.mimic
            if not all(abs(x) <= MOST for x in mimic[1:]):
                raise bad(f"has a mimic multiplier or offset that is not finite, or not within ±{MOST:g}")
    about = {name: getattr(joint, name) for name in ("name", "type", "parent", "child")}
    return Edge(**about, origin=origin, axis=axis, lower=lower, upper=upper, velocity=velocity, mimic=mimic)


def snapped(values):
    """Sines and cosines within rounding of 0 and ±1 made exact, so that literal zeros and ones fold."""
    return tuple(float(round(x)) if abs(x - round(x)) < 1e-15 else x for x in values)
