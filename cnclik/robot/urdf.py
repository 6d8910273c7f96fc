"""URDF files: a real robot as a Chain. `tree` reads the file."""

import os
from collections.abc import Sequence

from cnclik import errors
from cnclik.robot.bases import BALL, BASES, grounded, unfolded
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Chain, Joint, Tip, assemble, offset_of
from cnclik.robot.fixed import Offset, compose, inverse, scale, turn
from cnclik.robot.masses import lumped
from cnclik.robot.tree import Tree, read_urdf

_NAMED = 4  # candidates for a tip that a message names
_MOVING = {"revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC, BALL: BALL}


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
    becomes three coordinates, two translations and a rotation; a floating joint six, see `base`. Fixed joints are
    merged; side branches are left out. The chain may lead up towards the root and down again, such as from a humanoid's
    foot to its hand; joints on the way up keep their values and limits but act in the opposite direction. A mimic joint
    shares the coordinate of the joint that it follows, with its multiplier and offset, even if that joint is on a side
    branch. Its limits are those of the followed joint, as the mimic's own contradict them in files such as PR2's. A
    missing position limit means no limit, and so does a velocity limit of 0, which exporters write for unknown limits.

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
    tree, base = grounded(tree, base if base is None or base in BASES else link_of(tree, "base", base))
    if tips is None:
        end = tip_of(tree, tip, base)
        ends = {end: (end, Offset())}
    elif tip is not None:
        raise errors.fail("tip", "be left out where `tips` are given", f"is {tip!r}")
    else:
        ends = _ends(tree, tips)
    links = [link for link, _ in ends.values()]
    tree = unfolded(tree, base, links)
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
            if edge.type == "fixed":
                self._still(edge, turned)
                continue
            leader, multiplier, offset = _leader(self.by_name, edge)
            if leader.name in self.frozen:
                self._still(edge, turned, multiplier * self.frozen[leader.name] + offset)
                continue
            self.coordinates.setdefault(leader.name, len(self.coordinates))
            self._moving(edge, turned, leader, multiplier, offset)

    def beside(self) -> None:
        """Walk to all other links, for their masses.

        Joints without a coordinate stay as near to 0 as their limits allow; a mimic joint follows its leader, or stays
        where that does. Links on a floating or planar joint are another body and left out. Ball joints keep the file's
        orientation.
        """
        tree, waiting = self.tree, [*self.at]
        for link in waiting:
            above = [(tree.above[link], True)] if link in tree.above else []
            for edge, turned in [*above, *((e, False) for e in tree.below[link])]:
                there = edge.parent if turned else edge.child
                if there in self.at or edge.type in ("floating", "planar"):
                    continue
                waiting.append(there)
                try:
                    leader, multiplier, offset = _leader(self.by_name, edge) if edge.mimic else (edge, 1.0, 0.0)
                except errors.ArgumentError:  # it follows itself, or a joint that is missing
                    leader, multiplier, offset = edge, 1.0, 0.0
                if leader.name in self.coordinates:
                    self._moving(edge, turned, leader, multiplier, offset)
                else:
                    value = self.frozen.get(leader.name, min(max(0.0, leader.lower), leader.upper))
                    self._still(edge, turned, multiplier * value + offset)

    def _moving(self, edge, turned, leader, multiplier, offset) -> None:
        """Add a joint and the link after it."""
        here, there = (edge.child, edge.parent) if turned else (edge.parent, edge.child)
        parent, before = self.at[here]
        origin, axis, after = _around(before, edge, turned)
        joint = Joint(
            kind=_MOVING[edge.type],
            axis=axis,
            origin=origin,
            coordinate=self.coordinates[leader.name],
            multiplier=multiplier,
            offset=offset,
            parent=parent,
            follower="" if leader is edge else edge.name,
        )
        self.joints.append(joint)
        self.at[there] = len(self.joints) - 1, after

    def _still(self, edge, turned, value=0.0) -> None:
        """Add the link after a joint that does not move, or stays at a value."""
        here, there = (edge.child, edge.parent) if turned else (edge.parent, edge.child)
        parent, before = self.at[here]
        before, axis, after = _around(before, edge, turned)
        if edge.type in _MOVING:
            before = compose(before, moved(edge.type, axis, value))
        self.at[there] = parent, compose(before, after) if turned else before


def _around(before: Offset, edge, turned) -> tuple:
    """Return the pose of a joint, its axis, and the offset after its motion."""
    origin = Offset(position=edge.origin[0], rotation=edge.origin[1])
    if turned:  # traversed from its child, a joint acts in the opposite direction
        return before, scale(-1.0, edge.axis), inverse(origin)
    return compose(before, origin), edge.axis, Offset()


def moved(kind: str, axis, value) -> Offset:
    """Return the transform of a joint with a fixed value."""
    if _MOVING[kind] == PRISMATIC:
        return Offset(position=scale(value, axis))
    return Offset(rotation=turn(axis, value))


def _leader(by_name, edge) -> tuple:
    """Return the joint that an edge follows (itself, if it is no mimic) and how: value = multiplier·q + offset."""
    multiplier, offset, way = 1.0, 0.0, {edge.name: None}
    while edge.mimic is not None:
        name, factor, shift = edge.mimic
        multiplier, offset = multiplier * factor, multiplier * shift + offset
        if name in way:
            raise errors.fail("path", "have mimic joints that end at a joint", f"{' -> '.join((*way, name))} do not")
        follower, edge = edge, by_name.get(name)
        if edge is None or edge.type not in _MOVING:
            what = "is not in the file" if edge is None else f"is {edge.type}"
            must = "have mimic joints that follow a moving joint"
            raise errors.fail("path", must, f"{follower.name!r} follows {name!r}, which {what}")
        way[name] = None
    return edge, multiplier, offset


def _ends(tree, tips) -> dict:
    """Return {name of a tip: (its link, its place in the link's frame)}."""
    named = tips if isinstance(tips, dict) else {}
    if not named and isinstance(tips, (list, tuple)) and all(isinstance(link, str) for link in tips):
        named = {link: link for link in tips}
    if not named or len(named) < len(tips):
        raise errors.fail("tips", "hold different links, or be {name: link} or {name: (link, where)}", f"is {tips!r}")
    ends = {}
    for name, end in named.items():
        link, where = end if isinstance(end, tuple) and len(end) == 2 else (end, None)
        ends[name] = link_of(tree, "tips", link), offset_of(f"tips[{name!r}]", where)
    return ends


def _frozen(tree, freeze) -> dict:
    """Return {name of a fixed joint: its value}, checked."""
    moving = {e.name: e for e in tree.edges if e.type in _MOVING and e.type != BALL}
    if not isinstance(freeze, (dict, type(None))):
        raise errors.fail("freeze", "be {name of a joint: its value}", f"is {freeze!r}")
    for name, value in (freeze or {}).items():
        edge = moving.get(name)
        if edge is None:
            kind = next((e.type for e in tree.edges if e.name == name and e.type != "fixed"), None)
            hint = f", which is {kind} (`with_base` turns a base)" if kind else errors.nearest(name, moving)
            raise errors.fail("freeze", f"name joints of {tree.file} with one coordinate", f"names {name!r}{hint}")
        if edge.mimic is not None:
            raise errors.fail("freeze", f"name {edge.mimic[0]!r}, which {name!r} follows", f"names {name!r}")
        value = errors.number(f"freeze[{name!r}]", value)
        if not edge.lower <= value <= edge.upper:
            raise errors.fail(f"freeze[{name!r}]", f"be within {edge.lower:g} and {edge.upper:g}", f"is {value:g}")
    return {name: float(value) for name, value in (freeze or {}).items()}


def tip_of(tree: Tree, tip: str | None = None, base: str | None = None) -> str:
    """Return the name of the last link: the given one, or the only possible one. Args and raises: as `load_urdf`."""
    base = _first(tree, base)
    if tip is not None:
        return link_of(tree, "tip", tip)
    candidates = tree.tips(base)
    if not candidates and base != tree.root:
        raise errors.fail("tip", f"be given, as no moving joint hangs on {base!r} of {tree.file}", "is not")
    if not candidates:
        raise errors.fail("base", "have a moving joint after it", f"is {base!r} of {tree.file}, which has none")
    if len(candidates) > 1:
        far = sorted(candidates, key=lambda link: -sum(e.type != "fixed" for way in tree.way(link, base) for e in way))
        named = ", ".join(far[:_NAMED]) + f" and {len(far) - _NAMED} more" * (len(far) > _NAMED)
        raise errors.fail("tip", f"be given for {tree.file}, such as {named}", "is not")
    return candidates[0]


def _first(tree, base) -> str:
    return tree.root if base is None or base in BASES else link_of(tree, "base", base)


def link_of(tree, name, link) -> str:
    """Return a link. Raises: ArgumentError of an argument `name` for an unknown one."""
    if isinstance(link, str) and link in tree.links:
        return link
    moving = f"{', '.join(BASES)} or " if name == "base" else ""
    must = f"be {moving}one of the {len(tree.links)} links of {tree.file}"
    raise errors.fail(name, must, f"is {link!r}{errors.nearest(link, tree.links)}")
