"""URDF files: a real robot as a Chain.

Only the kinematics is read: links, joints, limits. Meshes, inertias and plugin sections are dropped before
`yourdfpy` sees the file, so nothing has to be found next to it.
"""

import dataclasses
import difflib
import functools
import math
import os
import pathlib

from cnclik import errors
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Chain, Joint, Offset, assemble, compose

_MOVING = {"revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}
_KINEMATIC = {"link", "joint", "parent", "child", "origin", "axis", "limit", "mimic"}


@dataclasses.dataclass(frozen=True)
class Edge:
    """A joint of the tree, as the file has it."""

    name: str
    type: str
    parent: str
    child: str
    origin: Offset
    axis: tuple
    lower: float  # [rad, m], −inf where the file gives none
    upper: float
    velocity: float  # [rad/s, m/s], inf where the file gives none
    mimic: tuple | None  # (joint name, multiplier, offset)


@dataclasses.dataclass(frozen=True)
class Tree:
    """What a URDF file says of its kinematics: one root, every other link the child of one joint."""

    file: str
    name: str
    root: str
    links: tuple
    edges: tuple  # of Edge, in the file's order

    @functools.cached_property
    def above(self) -> dict:
        """Link name -> the joint it hangs on."""
        return {e.child: e for e in self.edges}

    @functools.cached_property
    def below(self) -> dict:
        """Link name -> the joints that hang on it."""
        found = {link: [] for link in self.links}
        for e in self.edges:
            found[e.parent].append(e)
        return found

    @property
    def leaves(self) -> tuple:
        return tuple(link for link in self.links if not self.below[link])

    def way(self, tip, base=None) -> tuple | None:
        """The joints from base (by default the root) to tip, or None where tip does not hang on base."""
        found, link = [], tip
        while link != (base or self.root):
            if link not in self.above:
                return None
            found.append(self.above[link])
            link = found[-1].parent
        return tuple(reversed(found))

    def tips(self, base=None) -> tuple:
        """Leaf links that some joint moves against the base: the candidates for a tip."""
        ways = {leaf: self.way(leaf, base) for leaf in self.leaves}
        return tuple(leaf for leaf, way in ways.items() if way and any(e.type != "fixed" for e in way))


def load_urdf(path, tip=None, base=None) -> Chain:
    """Chain from base to tip of a robot in a URDF file, read without its meshes.

    Revolute, continuous and prismatic joints become coordinates in order from the base; fixed joints are
    folded in; side branches are left out. A mimic joint shares the coordinate of the joint it follows, with
    its multiplier and offset, also where that joint is on a side branch; the limits are those of the joint that
    is followed (the mimics' own contradict it in files such as PR2's). Omitted position limits mean none, as
    does a velocity limit of 0, which exporters write where they know none.

    Args:
      path: the file, plain URDF (run xacro first).
      tip: name of the last link; by default the only leaf link that the joints move.
      base: name of the first link, by default the root.

    Raises: ArgumentError, one line, for a file that cannot be read or is not a robot's tree, for unknown
      links, and where no single tip can be meant.
    """
    return chain(read_urdf(path), tip, base)


def chain(tree: Tree, tip=None, base=None) -> Chain:
    """The chain from base to tip of a tree that was read before. Args and raises: as `load_urdf`."""
    base = tree.root if base is None else _link(tree, "base", base)
    if tip is None:
        candidates = tree.tips(base)
        if not candidates:
            raise errors.fail("base", "have a moving joint after it", f"is {base!r} of {tree.file}, which has none")
        if len(candidates) > 1:
            named = ", ".join(candidates)
            raise errors.fail("tip", f"be given for {tree.file}", f"is not, and the candidates are {named}")
        tip = candidates[0]
    way = tree.way(_link(tree, "tip", tip), base)
    if way is None:
        raise errors.fail("base", f"be a link between the root and {tip!r}", f"is {base!r}")

    by_name = {e.name: e for e in tree.edges}
    joints, before, names, lower, upper, velocity = [], Offset(), [], [], [], []
    for edge in way:
        before = compose(before, edge.origin)
        if edge.type == "fixed":
            continue
        if edge.type not in _MOVING:
            raise errors.fail("tip", "be reached by revolute, prismatic and fixed joints", _odd(edge))
        leader, multiplier, offset = _leader(tree, by_name, edge)
        if leader.name not in names:
            names.append(leader.name)
            lower.append(leader.lower)
            upper.append(leader.upper)
            velocity.append(leader.velocity)
        joint = Joint(
            kind=_MOVING[edge.type],
            axis=edge.axis,
            origin=before,
            coordinate=names.index(leader.name),
            multiplier=multiplier,
            offset=offset,
        )
        joints.append(joint)
        before = Offset()
    if not joints:
        raise errors.fail("tip", "be moved by a joint", f"is {tip!r}, fixed to {base!r}")
    return assemble(joints, before, joint_names=names, lower=lower, upper=upper, velocity_limit=velocity)


def _leader(tree, by_name, edge):
    """The joint that an edge follows (itself, if it is no mimic) and how: value = multiplier·q + offset."""
    multiplier, offset, seen = 1.0, 0.0, [edge.name]
    while edge.mimic is not None:
        name, factor, shift = edge.mimic
        multiplier, offset = multiplier * factor, multiplier * shift + offset
        if name in seen:
            raise errors.fail("path", "have mimic joints that end at a joint", f"{' -> '.join((*seen, name))} do not")
        seen.append(name)
        edge = by_name.get(name)
        if edge is None or edge.type not in _MOVING:
            what = "is not in the file" if edge is None else f"is {edge.type}"
            raise errors.fail(
                "path", "have mimic joints that follow a moving joint", f"{seen[-2]!r} follows {name!r}, which {what}"
            )
    return edge, multiplier, offset


def _odd(edge):
    return f"joint {edge.name!r} on the way is {edge.type!r}"


def _link(tree, name, link):
    if link not in tree.links:
        near = difflib.get_close_matches(str(link), tree.links, n=1, cutoff=0.5)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise errors.fail(name, f"be one of the {len(tree.links)} links of {tree.file}", f"is {link!r}{hint}")
    return link


# --- reading the file ---------------------------------------------------------------------------------


def read_urdf(path) -> Tree:
    """The whole kinematic tree of a URDF file. Raises ArgumentError as `load_urdf`."""
    try:
        path = pathlib.Path(path)
    except TypeError:
        raise errors.fail("path", "be a file name", f"is {path!r}") from None
    if path.is_dir() or not path.exists():
        raise errors.fail("path", "name a URDF file", f"{os.fspath(path)!r} is {_absent(path)}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise errors.fail("path", "name a file that can be read", f"{path.name}: {error.strerror}") from None
    xml = _kinematic_part(path.name, data)
    from yourdfpy import URDF

    quiet = dict.fromkeys(
        ("build_scene_graph", "load_meshes", "build_collision_scene_graph", "load_collision_meshes"), False
    )
    import io

    try:
        robot = URDF.load(io.BytesIO(xml), **quiet).robot
    except (KeyError, AttributeError, ValueError, TypeError, IndexError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise errors.fail(
            "path", "name a valid URDF file", f"{path.name} has a bad or missing entry: {reason}"
        ) from None
    return _tree(path.name, robot)


def _absent(path):
    return "a folder" if path.is_dir() else "not there"


def _kinematic_part(file, data) -> bytes:
    """The file's links and joints alone, as XML that no parser has to forgive.

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
    except (expat.ExpatError, ValueError, AssertionError) as error:
        empty = not data.strip()
        what = "is empty" if empty else f"is not well-formed XML: {error}"
        raise errors.fail("path", "name a URDF file", f"{file} {what}") from None
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise errors.fail("path", "name a plain URDF file", f"{file} is xacro: run `xacro {file} -o robot.urdf` first")
    if root.tag != "robot":
        raise errors.fail("path", "name a URDF file", f"{file} holds <{root.tag}>, not <robot>")
    kept = ElementTree.Element("robot", name=root.get("name", file))
    for element in root:
        if element.tag in ("link", "joint"):
            copy = ElementTree.SubElement(kept, element.tag, _plain(element))
            if element.tag == "joint":
                for part in element:
                    if part.tag in _KINEMATIC:
                        ElementTree.SubElement(copy, part.tag, _plain(part))
    return ElementTree.tostring(kept)


def _plain(element):
    return {name: value for name, value in element.attrib.items() if ":" not in name}


def _tree(file, robot) -> Tree:
    """The robot as a checked tree: names unique, links known, one root, no loop."""

    def bad(what):
        return errors.fail("path", "name a robot that is a tree of links", f"{file} {what}")

    links = tuple(link.name for link in robot.links)
    if not links:
        raise bad("has no links")
    for kind, names in (("link", links), ("joint", [j.name for j in robot.joints])):
        twice = sorted({n for n in names if list(names).count(n) > 1})
        if twice:
            raise bad(f"has more than one {kind} {twice[0]!r}")
    parent = {}
    for joint in robot.joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise bad(f"has no link {link!r}, which joint {joint.name!r} connects")
        if joint.child in parent:
            raise bad(f"has a loop: link {joint.child!r} hangs on {parent[joint.child].name!r} and {joint.name!r}")
        parent[joint.child] = joint
    for link in links:  # up from every link: more steps than links is a circle
        seen = [link]
        while seen[-1] in parent:
            seen.append(parent[seen[-1]].parent)
            if len(seen) > len(links):
                raise bad(f"has a loop through link {seen[-1]!r}")
    roots = [link for link in links if link not in parent]
    if len(roots) > 1:
        raise bad(f"has {len(roots)} roots: {', '.join(roots)}")
    edges = tuple(_edge(file, joint) for joint in robot.joints)
    return Tree(file=file, name=robot.name, root=roots[0], links=links, edges=edges)


def _edge(file, joint) -> Edge:
    def bad(what):
        return errors.fail("path", "name a valid URDF file", f"joint {joint.name!r} of {file} {what}")

    origin, axis = Offset(), (1.0, 0.0, 0.0)
    if joint.origin is not None:
        rows = [[_snap(float(x)) for x in row] for row in joint.origin[:3]]
        if not all(math.isfinite(x) for row in rows for x in row):
            raise bad("has an origin that is not finite")
        origin = Offset(position=tuple(row[3] for row in rows), rotation=tuple(tuple(row[:3]) for row in rows))
    lower, upper, velocity, mimic = -math.inf, math.inf, math.inf, None
    if joint.type not in (*_MOVING, "fixed", "floating", "planar"):
        raise bad(f"has type {joint.type!r}")
    if joint.type in _MOVING:
        vector = [float(x) for x in joint.axis]
        length = math.hypot(*vector)
        if len(vector) != 3 or not math.isfinite(length) or length == 0:
            raise bad(f"has axis {' '.join(f'{x:g}' for x in vector)}")
        axis = tuple(_snap(x / length) for x in vector)
        if joint.limit is None and joint.type != "continuous" and joint.mimic is None:
            raise bad(f"is {joint.type} and has no <limit>")
        if joint.limit is not None:
            low, high, velocity = joint.limit.lower, joint.limit.upper, joint.limit.velocity
            if joint.type != "continuous" and (low, high) != (None, None):
                lower, upper = low or 0.0, high or 0.0  # one of the two omitted is 0, says the format
            velocity = velocity if velocity is None or math.isnan(velocity) else abs(velocity) or math.inf
            velocity = math.inf if velocity is None else velocity
        if math.isnan(lower) or math.isnan(upper) or math.isnan(velocity):
            raise bad("has a limit that is not a number")
        if lower > upper:
            raise bad(f"has lower limit {lower:g} above upper limit {upper:g}")
        if joint.mimic is not None:
            mimic = (joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)
            if not all(math.isfinite(x) for x in mimic[1:]):
                raise bad("has a mimic multiplier or offset that is not finite")
    return Edge(
        name=joint.name,
        type=joint.type,
        parent=joint.parent,
        child=joint.child,
        origin=origin,
        axis=axis,
        lower=lower,
        upper=upper,
        velocity=velocity,
        mimic=mimic,
    )


def _snap(x):
    """Rounding dust of sines and cosines made exact, so that literal zeros and ones fold away."""
    return float(round(x)) if abs(x - round(x)) < 1e-15 else x
