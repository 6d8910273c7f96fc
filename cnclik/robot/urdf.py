"""URDF files: a real robot as a Chain. `tree` reads the file."""

import itertools
import os
import re
from collections.abc import Sequence

from cnclik import errors
from cnclik.robot.bases import BALL, BASES, grounded, unfolded
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Chain, Joint, Tip, assemble, offset_of
from cnclik.robot.fixed import Offset, compose, inverse, scale, turn
from cnclik.robot.masses import lumped
from cnclik.robot.tree import MOST, Tree, read_urdf

# A link named gripper may be the body that a wrist turns; a joint of that name moves a jaw. Searched: "JOINT CHILD".
_JAW = re.compile(r"finger|jaw|claw|knuckle|thumb|gripper.* ", re.IGNORECASE)
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
    """The robot of a tree. Args and raises: as `load_urdf`."""
    tree, base = grounded(tree, base if base is None or base in BASES else link_of(tree, "base", base))
    if tips is None:
        end = tip_of(tree, tip, base)
        ends = {end: (end, Offset())}
        if tip is None:
            _remark_on_a_jaw(end, *tree.way(end, base))
    elif tip is not None:
        raise errors.fail("tip", "be left out where `tips` are given", f"is {tip!r}")
    else:
        ends = _ends(tree, tips)
    tree = unfolded(tree, base, [link for link, _ in ends.values()])
    frozen = _frozen(tree, freeze)
    joints, at, followed = _walked(tree, base, [link for link, _ in ends.values()], frozen)
    for link, _ in ends.values():
        if at[link][0] < 0:
            raise errors.fail("tips" if tips else "tip", "be moved by a joint", f"is {link!r}, fixed to {base!r}")
    if tree.inertials:
        _rest(tree, at, frozen, joints, followed)
    return assemble(
        joints,
        tuple(Tip(name=n, joint=at[link][0], offset=compose(at[link][1], off)) for n, (link, off) in ends.items()),
        joint_names=[e.name for e in followed],
        lower=[e.lower for e in followed],
        upper=[e.upper for e in followed],
        velocity_limit=[e.velocity for e in followed],
        masses=lumped(tree.inertials, at, len(joints)),
    )


def _walked(tree, base, links, frozen) -> tuple:
    """(joints between base and links, {link: (index of the joint that carries it, its place in that frame)}, the
    followed joint of each coordinate)
    """
    by_name = {e.name: e for e in tree.edges}
    joints, at, followed, leaders = [], {base: (-1, Offset())}, [], {}
    for link in links:
        up, down = tree.way(link, base)
        for edge, turned in (*((e, True) for e in up), *((e, False) for e in down)):
            here, there = (edge.child, edge.parent) if turned else (edge.parent, edge.child)
            if there in at:
                continue
            parent, before = at[here]
            if edge.type == "fixed":
                at[there] = parent, _after(before, edge, turned)
                continue
            if edge.type == BALL and turned:
                name = edge.name.rpartition("_")[0]
                raise errors.fail("base", "be a link before a floating joint", f"is beyond {name!r}")
            kind, (leader, multiplier, offset) = _MOVING[edge.type], _leader(by_name, edge, leaders)
            if leader.name in frozen:
                at[there] = parent, _after(before, edge, turned, multiplier * frozen[leader.name] + offset)
                continue
            before, axis, after = _around(before, edge, turned)
            if leader not in followed:
                followed.append(leader)
            about = dict(coordinate=followed.index(leader), multiplier=multiplier, offset=offset, parent=parent)
            name = "" if leader is edge else edge.name
            joints.append(Joint(kind=kind, axis=axis, origin=before, follower=name, **about))
            at[there] = len(joints) - 1, after
    return joints, at, followed


def _around(before: Offset, edge, turned) -> tuple:
    """The pose of a joint, its axis, and the offset after its motion."""
    origin = Offset(position=edge.origin[0], rotation=edge.origin[1])
    if turned:  # traversed from its child, a joint acts in the opposite direction
        return before, scale(-1.0, edge.axis), inverse(origin)
    return compose(before, origin), edge.axis, Offset()


def _after(before: Offset, edge, turned, value=0.0) -> Offset:
    """The pose of the link after a joint with a fixed value."""
    before, axis, after = _around(before, edge, turned)
    before = compose(before, moved(edge.type, axis, value)) if edge.type in _MOVING else before
    return compose(before, after) if turned else before


def moved(kind: str, axis, value) -> Offset:
    """The transform of a joint with a fixed value."""
    if _MOVING[kind] == PRISMATIC:
        return Offset(position=scale(value, axis))
    return Offset(rotation=turn(axis, value))


def _rest(tree, at, frozen, joints, followed) -> None:
    """Add to `at` the links beside the ways to the tips, for their masses: joints without a coordinate stay as near to
    0 as their limits allow, and a mimic joint follows its leader, as one more of the joints.

    Links on a floating or planar joint are another body and left out. Ball joints keep the file's orientation.
    """
    waiting, by_name = [*at], {e.name: e for e in tree.edges}
    for link in waiting:
        above = [(tree.above[link], True)] if link in tree.above else []
        for edge, turned in [*above, *((e, False) for e in tree.below[link])]:
            there = edge.parent if turned else edge.child
            if there not in at and edge.type not in ("floating", "planar"):
                waiting.append(there)
                leader = None if edge.mimic is None or edge.type not in _MOVING else _followed(by_name, edge, followed)
                if leader is None:
                    value = _at_rest(edge, by_name, frozen)
                    at[there] = at[link][0], _after(at[link][1], edge, turned, value)
                    continue
                before, axis, after = _around(at[link][1], edge, turned)
                about = dict(coordinate=leader[0], multiplier=leader[1], offset=leader[2], parent=at[link][0])
                joints.append(Joint(kind=_MOVING[edge.type], axis=axis, origin=before, follower=edge.name, **about))
                at[there] = len(joints) - 1, after


def _followed(by_name, edge, followed):
    """(coordinate, multiplier, offset) of a mimic joint whose leader has a coordinate; None of others."""
    try:
        leader, multiplier, offset = _leader(by_name, edge, {})
    except errors.ArgumentError:  # it follows itself, or a joint that is missing
        return None
    return (followed.index(leader), multiplier, offset) if leader in followed else None


def _at_rest(edge, by_name, frozen) -> float:
    """Value of a joint at rest; of a mimic from its leader's, which may be a mimic, too. A missing leader is at 0."""
    row: dict = {}
    while edge is not None and edge.mimic is not None and edge.name not in row:
        row[edge.name] = edge.mimic
        edge = by_name.get(edge.mimic[0])
    known = edge is not None and edge.mimic is None
    value = frozen.get(edge.name, min(max(0.0, edge.lower), edge.upper)) if known else 0.0
    for _, multiplier, offset in reversed(row.values()):
        value = multiplier * value + offset
    return value


def _ends(tree, tips) -> dict:
    """{name of a tip: (its link, its place in the link's frame)}"""
    named = tips if isinstance(tips, dict) else {}
    if not named and isinstance(tips, (list, tuple)) and all(isinstance(link, str) for link in tips):
        named = {link: link for link in tips}
    if not named or len(named) < len(tips):
        raise errors.fail("tips", "hold different links, or be {name: link} or {name: (link, where)}", f"is {tips!r}")
    found = {}
    for name, end in named.items():
        link, where = end if isinstance(end, tuple) and len(end) == 2 else (end, None)
        found[name] = link_of(tree, "tips", link), offset_of(f"tips[{name!r}]", where, places=True)
    return found


def _frozen(tree, freeze) -> dict:
    """{name of a fixed joint: its value}, checked."""
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
    """The name of the last link: the given one, or the only possible one. Args and raises: as `load_urdf`."""
    base = tree.root if base is None or base in BASES else link_of(tree, "base", base)
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
        raise errors.fail("tip", f"be given for {tree.file}", f"is not, and the candidates are {named}")
    return candidates[0]


def tips_of(tree: Tree, base: str | None, named: dict) -> list[str]:
    """The links of several tips, {name: the argument that names it}; all candidates if none is named."""
    root = tree.root if base is None or base in BASES else link_of(tree, "base", base)
    links = [link_of(tree, argument, link) for link, argument in named.items()]
    for link, argument in zip(links, named.values(), strict=True):
        if base not in ("planar", "free") and all(edge.type == "fixed" for way in tree.way(link, root) for edge in way):
            left_out = " (leave it out for the frame of the base)" if argument.endswith("relative_to") else ""
            raise errors.fail(argument, f"be moved by a joint{left_out}", f"is {link!r}, fixed to {root!r}")
    return links or list(tree.tips(root)) or [tip_of(tree, None, base)]


def _remark_on_a_jaw(tip, up, down):
    """Remark on a default tip that the last joint moves like a gripper's jaw: it is probably not the intended one."""
    moving = [edge for edge in (*up, *down) if edge.type not in ("fixed", "floating", "planar")]  # a base is no arm
    jaws = list(itertools.takewhile(lambda edge: _JAW.search(f"{edge.name} {edge.child}"), reversed(moving)))
    if 0 < len(jaws) < len(moving):
        jaw = jaws[-1]
        errors.remark(
            f"The tip is {tip!r}, a gripper's jaw that joint {jaw.name!r} moves. The tip {jaw.parent!r} is the arm "
            "without the jaw."
        )


def _leader(by_name, edge, known):
    """The joint that an edge follows (itself, if it is no mimic) and how: value = multiplier·q + offset.

    Args:
      known: {name: the results so far}, which is extended.
    """
    way = {}  # names of mimics, in the order in which they follow each other
    while edge.mimic is not None and edge.name not in known:
        way[edge.name] = edge
        name = edge.mimic[0]
        if name in way:
            raise errors.fail("path", "have mimic joints that end at a joint", f"{' -> '.join((*way, name))} do not")
        follower, edge = edge.name, by_name.get(name)
        if edge is None or edge.type not in _MOVING:
            what = "is not in the file" if edge is None else f"is {edge.type}"
            raise errors.fail(
                "path", "have mimic joints that follow a moving joint", f"{follower!r} follows {name!r}, which {what}"
            )
    leader, multiplier, offset = known.get(edge.name, (edge, 1.0, 0.0))
    for name, follower in reversed(way.items()):
        _, factor, shift = follower.mimic
        multiplier, offset = multiplier * factor, offset * factor + shift
        if max(abs(multiplier), abs(offset)) > MOST:
            raise errors.fail(
                "path", f"have mimic joints within ±{MOST:g}", f"{name!r} is {multiplier:g}·q + {offset:g}"
            )
        known[name] = leader, multiplier, offset
    return leader, multiplier, offset


def link_of(tree, name, link):
    if isinstance(link, str) and link in tree.links:
        return link
    padded = [known for known in tree.links if isinstance(link, str) and known.strip() == link.strip()]
    if len(padded) == 1:  # some files have invisible spaces around a name
        return padded[0]
    hint = errors.nearest(link, tree.links)
    moving = f"{', '.join(BASES)} or " if name == "base" else ""
    raise errors.fail(name, f"be {moving}one of the {len(tree.links)} links of {tree.file}", f"is {link!r}{hint}")
