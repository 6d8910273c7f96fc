"""The kinematic tree of a URDF file: links, joints, limits, masses. Read without loading JAX.

Meshes and plugin sections are skipped, so no other files are needed.
"""

import collections
import dataclasses
import functools
import math
import pathlib

from cnclik import errors, quantities
from cnclik.reading import read_bytes

MOVING = ("revolute", "continuous", "prismatic")
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
        joints = {link: [] for link in self.links}
        for e in self.edges:
            joints[e.parent].append(e)
        return joints

    @property
    def leaves(self) -> tuple:
        return tuple(link for link in self.links if not self.below[link])

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
        """Return the leaf links that some joint moves against the base: the candidates for a tip."""
        moved, waiting = {}, [(base or self.root, False)]
        while waiting:
            link, moves = waiting.pop()
            moved[link] = moves
            waiting += [(e.child, moves or e.type != "fixed") for e in self.below[link]]
        return tuple(leaf for leaf in self.leaves if moved.get(leaf))


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
        try:
            path = pathlib.Path(path)
        except TypeError:
            raise errors.fail("path", "be a file name", f"is {path!r}") from None
        file, data = path.name, read_bytes("path", path, "a URDF file")
    root = _root(file, data)
    try:
        links = tuple(element.attrib["name"] for element in root.findall("link"))
        edges = tuple(_edge(file, element) for element in root.findall("joint"))
    except (KeyError, AttributeError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise errors.fail("path", "name a valid URDF file", f"{file} has a bad or missing entry: {reason}") from None
    top = _top(file, links, edges)
    return Tree(
        file=file, name=root.get("name", file), root=top, links=links, edges=edges, inertials=_inertials(file, root)
    )


def _root(file, data):
    """Return the file's outermost element, <robot>.

    Well-formedness is checked strictly; prefixes need not be declared, as ROS tools write undeclared ones.
    """
    from xml.etree import ElementTree
    from xml.parsers import expat

    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: builder.start(tag, attributes)
    parser.EndElementHandler = builder.end
    try:
        parser.Parse(data, True)
        root = builder.close()
    except (expat.ExpatError, ValueError, AssertionError, LookupError) as error:  # a LookupError is an unknown encoding
        what = f"is not well-formed XML: {error}" if data.strip() else "is empty"
        raise errors.fail("path", "name a URDF file", f"{file} {what}") from None
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise errors.fail("path", "name a plain URDF file", f"{file} is xacro: run `xacro {file} -o robot.urdf` first")
    if root.tag != "robot":
        raise errors.fail("path", "name a URDF file", f"{file} holds <{root.tag}>, not <robot>")
    return root


def _edge(file, element) -> Edge:
    """Return a joint, checked."""
    name, kind = element.attrib["name"], element.get("type")
    parent, child = (element.find(end).get("link") for end in ("parent", "child"))
    limit, follows = element.find("limit"), element.find("mimic")

    def bad(what):
        return errors.fail("path", "name a valid URDF file", f"joint {name!r} of {file} {what}")

    def number(part, key, text, most=MOST):
        value = quantities.number(text)
        if value is None:
            raise bad(f"has {part} {key} {text!r}{quantities.hint(text)}")
        if not abs(value) <= most:  # refuses NaN, too
            raise bad(f"has {part} {key} {text!r}, not within ±{most:g}")
        return value

    def three(part, key, default="0 0 0"):
        inside = element.find(part)
        text = default if inside is None else inside.get(key, default)
        values = tuple(number(part, key, word) for word in (text.split() if "$" not in text else [text]))
        if len(values) != 3:
            raise bad(f"has {part} {key} {text!r}, not three numbers")
        return values

    position, angles, axis = three("origin", "xyz"), three("origin", "rpy"), three("axis", "xyz", "1 0 0")
    edge = Edge(name, kind, parent, child, (snapped(position), tuple(map(snapped, _rotation(*angles)))))
    if kind in ("fixed", "floating"):
        return edge
    if kind not in (*MOVING, "planar"):
        raise bad(f"has type {kind!r}")
    length = math.hypot(*axis)
    if not length > 0:
        raise bad(f"has axis {' '.join(f'{x:g}' for x in axis)}")
    edge = dataclasses.replace(edge, axis=snapped(x / length for x in axis))
    if kind == "planar":
        return edge
    if limit is None and kind != "continuous" and follows is None:
        raise bad(f"is {kind} and has no <limit>")
    given = {} if limit is None else dict(limit.items())
    lower, upper, velocity = (
        number("limit", key, given[key], math.inf) if key in given else None for key in ("lower", "upper", "velocity")
    )
    if kind == "continuous" or (lower is None and upper is None):
        lower, upper = -math.inf, math.inf
    lower, upper = lower or 0.0, upper or 0.0  # by the format, one omitted limit is 0
    if lower > min(upper, MOST) or upper < -MOST:
        raise bad(f"has limits from {lower:g} to {upper:g}")
    edge = dataclasses.replace(
        edge,
        lower=lower if lower >= -MOST else -math.inf,  # exporters write 1e16 and the like for none
        upper=upper if upper <= MOST else math.inf,
        velocity=abs(velocity or math.inf),  # and 0 for an unknown limit
    )
    if follows is None:
        return edge
    factor, shift = (number("mimic", key, follows.get(key, n)) for key, n in (("multiplier", "1"), ("offset", "0")))
    return dataclasses.replace(edge, mimic=(follows.get("joint"), factor, shift))


def _rotation(roll, pitch, yaw):
    """Return the rows of Rz(yaw)·Ry(pitch)·Rx(roll)."""
    (a, b, c), (d, e, f) = (list(map(part, (roll, pitch, yaw))) for part in (math.sin, math.cos))
    return (
        (f * e, f * b * a - c * d, f * b * d + c * a),
        (c * e, c * b * a + f * d, c * b * d - f * a),
        (-b, e * a, e * d),
    )


def snapped(values):
    """Return sines and cosines with those within rounding of 0 and ±1 made exact, so that literals fold."""
    return tuple(float(round(x)) if abs(x - round(x)) < 1e-15 else x for x in values)


def _inertials(file, root) -> dict:
    """Return {link: (mass, its centre)}; empty, with a remark, if one is unreadable: kinematics needs none of them."""
    masses = {}
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
            masses[link.get("name")] = of, tuple(center)
    return masses


def _top(file, links, edges) -> str:
    """Return the root. Raises: ArgumentError for names that occur twice, unknown links, several roots and loops."""

    def bad(what):
        return errors.fail("path", "name a robot that is a tree of links", f"{file} {what}")

    if not links:
        raise bad("has no links")
    for kind, names in (("link", links), ("joint", [e.name for e in edges])):
        twice = sorted(n for n, count in collections.Counter(names).items() if count > 1)
        if twice:
            raise bad(f"has more than one {kind} {twice[0]!r}")
    known, above = set(links), {}
    for edge in edges:
        for link in (edge.parent, edge.child):
            if link not in known:
                raise bad(f"has no link {link!r}, which joint {edge.name!r} connects")
        if edge.child in above:
            raise bad(f"has a loop: link {edge.child!r} hangs on {above[edge.child].name!r} and {edge.name!r}")
        above[edge.child] = edge
    roots = [link for link in links if link not in above]
    rooted = set(roots)
    for link in links:  # go up from every link until a known one: who meets itself is in a loop
        way = {}
        while link not in rooted:
            if link in way:
                raise bad(f"has a loop through link {link!r}")
            way[link] = None
            link = above[link].parent
        rooted |= set(way)
    if len(roots) > 1:
        more = f" and {len(roots) - 5:,} more" if len(roots) > 6 else ""
        raise bad(f"has {len(roots):,} roots: {', '.join(roots[: 5 if more else 6])}{more}")
    return roots[0]
