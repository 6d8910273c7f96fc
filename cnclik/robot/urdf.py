"""URDF files: a real robot as a Chain. `tree` reads the file."""

import dataclasses
import os
from collections.abc import Sequence

from cnclik import errors
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Chain, Joint, Tip, assemble, offset_of
from cnclik.robot.fixed import Offset, compose, inverse, scale, turn
from cnclik.robot.mounted import lumped
from cnclik.robot.tree import BALL, NO_OFFSET, Edge, Tree, read_urdf

_MOVING = {"revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC, BALL: BALL}
_BASES = {"fixed": "fixed", "planar": "planar", "free": "floating"}  # {name of a base: type of its joint}
_X, _Y, _Z = NO_OFFSET[1]
_ALONG = [("x", "prismatic", _X), ("y", "prismatic", _Y), ("z", "prismatic", _Z)]
_ABOUT = [("rx", BALL, _X), ("ry", BALL, _Y), ("rz", BALL, _Z)]
_PARTS = {"planar": [*_ALONG[:2], ("yaw", "continuous", _Z)], "floating": [*_ALONG, *_ABOUT], "ball": _ABOUT}


def load_urdf(
    path: str | os.PathLike,
    tip: str | None = None,
    base: str | None = None,
    *,
    tips: Sequence[str] | dict | None = None,
    freeze: dict[str, float] | None = None,
) -> Chain:
    """Load a robot from a URDF file, without its meshes: the chain from base to tip, or the tree to several tips.

    Revolute, continuous and prismatic joints become coordinates, in order from the base and tip by tip. A planar joint
    becomes three coordinates, a floating joint six, see `base`. The chain may lead up towards the root and down again;
    joints on the way up act in the opposite direction. A mimic joint shares coordinate and limits of the joint that it
    follows. A missing position limit means no limit, and so does a velocity limit of 0.

    Args:
      path: a URDF file (run xacro first), or its text, which begins with "<".
      tip: name of the last link; default: the only leaf link that the joints move.
      base: how the root moves: "fixed" (default), "planar" or "free"; or the name of the first link, anywhere in the
        tree. A planar base has the joints base_x, base_y [m] and base_yaw [rad]. A free base has base_x, base_y, base_z
        [m] and base_rx, base_ry, base_rz [rad], its rotation vector; q̇ is then the velocity along the world's axes and
        the angular velocity in the base's own axes. These joints have no limits; `replace(robot, velocity_limit=...)`
        sets one for each axis. `with_base` sets the base's place.
      tips: in place of `tip`: names of links, {name: link}, or {name: (link, place)}, where the place is a (3,)
        position [m] or a pose in the link's frame, as for `with_tool`.
      freeze: {name of a joint: its constant value [rad, m]}; such a joint is no coordinate. It may be a base's.

    Raises: ArgumentError, one line, for a file that cannot be read or is not a robot's tree, for unknown links and
      joints, and where the tip is ambiguous.
    """
    return chain(read_urdf(path), tip, base, tips=tips, freeze=freeze)


def chain(tree: Tree, tip: str | None = None, base: str | None = None, *, tips=None, freeze=None) -> Chain:
    """Return the robot of a tree. Args and raises: as `load_urdf`."""
    tree, base = _grounded(tree, base)
    if tips is not None and tip is not None:
        raise errors.fail("tip", "be left out where `tips` are given", f"is {tip!r}")
    ends = _ends(tree, tips) if tips is not None else {(end := _tip_of(tree, tip, base)): (end, Offset())}
    links = [link for link, _ in ends.values()]
    tree = _unfolded(tree, base, links)
    walk = _Walk(tree, base, _frozen(tree, freeze))
    for link in links:
        walk.to(link)
        if walk.at[link][0] < 0:
            raise errors.fail("tips" if tips else "tip", "be moved by a joint", f"is {link!r}, fixed to {base!r}")
    if tree.inertials:
        walk.beside()
    leaders = [walk.by_name[name] for name in walk.coordinates]
    places = ((name, *walk.at[link], where) for name, (link, where) in ends.items())
    return assemble(
        walk.joints,
        tuple(Tip(name=name, joint=joint, offset=compose(at, where)) for name, joint, at, where in places),
        joint_names=list(walk.coordinates),
        lower=[e.lower for e in leaders],
        upper=[e.upper for e in leaders],
        velocity_limit=[e.velocity for e in leaders],
        masses=lumped(tree.inertials, walk.at, len(walk.joints)),
    )


class _Walk:
    """The joints between the base and the links that were walked to, and the places of these links."""

    def __init__(self, tree, base, frozen):
        self.tree, self.base, self.frozen = tree, base, frozen
        self.by_name = {e.name: e for e in tree.edges}
        self.joints: list[Joint] = []
        self.coordinates: dict = {}  # {joint, which mimic joints may follow: index of its coordinate}
        self.at: dict = {base: (-1, Offset())}  # {link: (index of the joint that carries it, its place in that frame)}

    def to(self, link) -> None:
        """Walk to a link: up the tree, then down."""
        up, down = self.tree.way(link, self.base)
        for edge, turned in (*((e, True) for e in up), *((e, False) for e in down)):
            if (edge.parent if turned else edge.child) in self.at:
                continue
            if edge.type == BALL and turned:
                name = edge.name.rpartition("_")[0]
                raise errors.fail("base", "be a link before a floating joint", f"is beyond {name!r}")
            leader, multiplier, offset = _leader(self.by_name, edge)
            if edge.type != "fixed" and leader.name not in self.frozen:
                self.coordinates.setdefault(leader.name, len(self.coordinates))
            self._add(edge, turned, leader, multiplier, offset)

    def beside(self) -> None:
        """Walk to all other links, for their masses; links on a floating or planar joint are another body and left out.

        Joints without a coordinate stay as near to 0 as their limits allow, and ball joints as in the file.
        """
        waiting = [*self.at]
        for link in waiting:
            above = [(self.tree.above[link], True)] if link in self.tree.above else []
            for edge, turned in [*above, *((e, False) for e in self.tree.below[link])]:
                there = edge.parent if turned else edge.child
                if there in self.at or edge.type in ("floating", "planar"):
                    continue
                waiting.append(there)
                try:
                    self._add(edge, turned, *_leader(self.by_name, edge))
                except errors.ArgumentError:  # it follows itself, or a joint that is missing
                    self._add(edge, turned, edge, 1.0, 0.0)

    def _add(self, edge, turned, leader, multiplier, offset) -> None:
        """Add a joint, of which value = multiplier · its leader's + offset, and the link after it."""
        here, there = (edge.child, edge.parent) if turned else (edge.parent, edge.child)
        (parent, before), origin = self.at[here], Offset(position=edge.origin[0], rotation=edge.origin[1])
        # Traversed from its child, a joint acts in the opposite direction.
        axis, after = (scale(-1.0, edge.axis), inverse(origin)) if turned else (edge.axis, Offset())
        before = before if turned else compose(before, origin)
        if leader.name in self.coordinates:
            joint = Joint(
                kind=_MOVING[edge.type],
                axis=axis,
                origin=before,
                coordinate=self.coordinates[leader.name],
                multiplier=multiplier,
                offset=offset,
                parent=parent,
                follower="" if leader is edge else edge.name,
            )
            self.joints.append(joint)
            parent, before = len(self.joints) - 1, Offset()
        elif edge.type in _MOVING:
            value = self.frozen.get(leader.name, min(max(0.0, leader.lower), leader.upper))
            before = compose(before, moved(edge.type, axis, multiplier * value + offset))
        self.at[there] = parent, compose(before, after)


def moved(kind: str, axis, value) -> Offset:
    """Return the transform of a joint with a fixed value."""
    if _MOVING[kind] == PRISMATIC:
        return Offset(position=scale(value, axis))
    return Offset(rotation=turn(axis, value))


def _leader(by_name, edge) -> tuple:
    """Return the joint that an edge follows (itself, if it is no mimic) and how: value = multiplier·q + offset."""
    multiplier, offset, way = 1.0, 0.0, {edge.name}
    while edge.mimic is not None and edge.type in _MOVING:
        name, factor, shift = edge.mimic
        multiplier, offset = multiplier * factor, multiplier * shift + offset
        follower, edge = edge, by_name.get(name)
        if edge is None or edge.type not in _MOVING or name in way:
            what = "is not in the file" if edge is None else "follows it" if name in way else f"is {edge.type}"
            must = "have mimic joints that follow a moving joint"
            raise errors.fail("path", must, f"{follower.name!r} follows {name!r}, which {what}")
        way.add(name)
    return edge, multiplier, offset


def _ends(tree, tips) -> dict:
    """Return {name of a tip: (its link, its place in the link's frame)}."""
    named = tips if isinstance(tips, dict) else {}
    if isinstance(tips, (list, tuple)) and all(isinstance(link, str) for link in tips):
        named = {link: link for link in tips}
    if not named or len(named) < len(tips):
        raise errors.fail("tips", "hold different links, or be {name: link} or {name: (link, where)}", f"is {tips!r}")
    ends = {}
    for name, end in named.items():
        link, where = end if isinstance(end, tuple) and len(end) == 2 else (end, None)
        ends[name] = _link_of(tree, "tips", link), offset_of(f"tips[{name!r}]", where)
    return ends


def _frozen(tree, freeze) -> dict:
    """Return {name of a fixed joint: its value}, checked."""
    moving = {e.name: e for e in tree.edges if e.type in _MOVING and e.type != BALL and e.mimic is None}
    freeze = errors.kind("freeze", {} if freeze is None else freeze, dict, "be {name of a joint: its value}")
    for name, value in freeze.items():
        edge = moving[errors.one_of("freeze", name, moving)]
        if not edge.lower <= errors.number(f"freeze[{name!r}]", value) <= edge.upper:
            raise errors.fail(f"freeze[{name!r}]", f"be within {edge.lower:g} and {edge.upper:g}", f"is {value:g}")
    return {name: float(value) for name, value in freeze.items()}


def _tip_of(tree: Tree, tip, base) -> str:
    """Return the last link: the named one, or the only possible one."""
    if tip is not None:
        return _link_of(tree, "tip", tip)
    candidates = tree.tips(base)
    if not candidates:
        raise errors.fail("path", f"have a joint that moves after {base!r}", f"{tree.file} has none")
    if len(candidates) != 1:
        raise errors.fail("tip", f"be given for {tree.file}, such as {', '.join(candidates[:8])}", "is not")
    return candidates[0]


def _link_of(tree, name, link) -> str:
    """Return a link. Raises: ArgumentError of an argument `name` for an unknown one."""
    if isinstance(link, str) and link in tree.links:
        return link
    moving = f"{', '.join(_BASES)} or " * (name == "base")
    must = f"be {moving}one of the {len(tree.links)} links of {tree.file}"
    raise errors.fail(name, must, f"is {link!r}{errors.nearest(link, tree.links)}")


# --- moving bases, and joints of several coordinates split into joints of one -----------------------------


def _grounded(tree: Tree, base) -> tuple[Tree, str]:
    """Return (the tree, its first link), on one of `_BASES` or on a link.

    Raises: ArgumentError for a moving base if the file has its own joint for that.
    """
    if base is None or (isinstance(base, str) and base == "fixed"):
        return tree, tree.root
    if not isinstance(base, str) or base not in _BASES or base in tree.links:
        return tree, _link_of(tree, "base", base)
    if name := next((e.name for e in tree.below[tree.root] if e.type in ("floating", "planar")), None):
        must = f"be left out for {tree.file}, where joint {name!r} already moves what it carries"
        raise errors.fail("base", must, f"is {base!r}")
    ground = next(name for name in ("world", "ground", "_world", "_ground") if name not in tree.links)
    joint = Edge("base", _BASES[base], ground, tree.root, NO_OFFSET, _Z)
    return dataclasses.replace(tree, root=ground, links=(*tree.links, ground), edges=(*tree.edges, joint)), ground


def _unfolded(tree: Tree, base, tips) -> Tree:
    """Return the tree with the joints between its first link and the tips split into joints of one coordinate each.

    A planar joint becomes P, P, R along x and y and about z; a floating joint P, P, P and three joints that form one
    rotation, as a ball joint does. The links in between have no shape.
    """
    ways = {edge.name for tip in tips for way in tree.way(tip, base) for edge in way}
    edges = tuple(part for edge in tree.edges for part in (_parts(edge) if edge.name in ways else [edge]))
    known = set(tree.links)
    between = (edge.child for edge in edges if edge.child not in known)
    return dataclasses.replace(tree, links=(*tree.links, *between), edges=edges)


def _parts(edge):
    """Return the joint as joints of one coordinate each, named after it."""
    if edge.type not in _PARTS:
        return [edge]
    parts = _PARTS[edge.type]
    links = [edge.parent, *(f"{edge.name}_{name}" for name, _, _ in parts[:-1]), edge.child]
    origins = [edge.origin, *[NO_OFFSET] * 5]
    return [
        Edge(f"{edge.name}_{name}", kind, links[i], links[i + 1], origins[i], axis)
        for i, (name, kind, axis) in enumerate(parts)
    ]
