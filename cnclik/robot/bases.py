"""Moving bases, and joints of several coordinates split into joints of one. It does not load JAX."""

import dataclasses

from cnclik import errors
from cnclik.robot.tree import NO_OFFSET, Edge, Tree

BASES = {"fixed": None, "planar": "planar", "free": "floating"}  # {name of a base: type of its joint}
BALL = "rotation"  # kind of each of three joints that form a rotation; their values are its rotation vector
_X, _Y, _Z = NO_OFFSET[1]
_ALONG, _ABOUT = ([(name, kind, axis) for name, axis in zip(names, (_X, _Y, _Z), strict=True)]
                  for names, kind in (("xyz", "prismatic"), (("rx", "ry", "rz"), BALL)))  # fmt: skip


def grounded(tree: Tree, base=None) -> tuple[Tree, str]:
    """(the tree, its first link), on one of `BASES` or on a link.

    Raises: ArgumentError for a moving base if the file has its own joint for that.
    """
    if base is None or base in tree.links:
        return tree, base or tree.root
    kind = BASES[base]
    if kind is None:
        return tree, tree.root
    if own := next((e.name for e in tree.below[tree.root] if e.type in ("floating", "planar")), None):
        must = f"be left out for {tree.file}, where joint {own!r} already moves what it carries"
        raise errors.fail("base", must, f"is {base!r}")
    ground = next(name for name in ("world", "ground", "_world", "_ground") if name not in tree.links)
    joint = Edge("base", kind, ground, tree.root, NO_OFFSET, _Z)
    return dataclasses.replace(tree, root=ground, links=(*tree.links, ground), edges=(*tree.edges, joint)), ground


def unfolded(tree: Tree, base, tips) -> Tree:
    """The tree with the joints between its first link and the tips split into joints of one coordinate each.

    A planar joint becomes P, P, R: two translations in the plane across its axis, then the rotation about it. A
    floating joint becomes P, P, P along the axes of its frame, then three joints that form one rotation, as a ball
    joint does. The links in between have no shape.
    """
    ways = {edge.name for tip in tips for way in tree.way(tip, base) for edge in way}
    edges = tuple(part for edge in tree.edges for part in (_parts(edge) if edge.name in ways else [edge]))
    known = set(tree.links)
    more = tuple(edge.child for edge in edges if edge.child not in known)
    return dataclasses.replace(tree, links=(*tree.links, *more), edges=edges) if more else tree


def _parts(edge):
    """The joint as joints of one coordinate each, named after it."""
    if edge.type == "planar":
        across, along = _across(edge.axis)
        kinds = [("x", "prismatic", across), ("y", "prismatic", along), ("yaw", "continuous", edge.axis)]
    elif edge.type in ("floating", "ball"):
        kinds = _ALONG * (edge.type == "floating") + _ABOUT
    else:
        return [edge]
    ends = [edge.parent, *(f"{edge.name}_{name}" for name, _, _ in kinds[:-1]), edge.child]
    origins = [edge.origin, *[NO_OFFSET] * 5]
    return [
        Edge(f"{edge.name}_{name}", kind, ends[i], ends[i + 1], origins[i], axis)
        for i, (name, kind, axis) in enumerate(kinds)
    ]


def _across(axis):
    """Two axes across a unit axis, right-handed with it; x and y if the axis is z."""
    x, y, z = axis
    s = 1 if z > -0.5 else -1
    k = 1 / (1 + s * z)  # the shortest rotation from ±z to the axis, applied to x and ±y
    return (1 - k * x * x, -k * x * y, -s * x), (-s * k * x * y, s * (1 - k * y * y), -y)
