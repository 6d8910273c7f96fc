"""Moving bases, and joints of several coordinates split into joints of one. It does not load JAX."""

import dataclasses

from cnclik import errors
from cnclik.robot.tree import NO_OFFSET, Edge, Tree

BASES = {"fixed": None, "planar": "planar", "free": "floating"}  # {name of a base: type of its joint}
BALL = "rotation"  # kind of each of three joints that form a rotation; their values are its rotation vector
_X, _Y, _Z = NO_OFFSET[1]
_ALONG = [("x", "prismatic", _X), ("y", "prismatic", _Y), ("z", "prismatic", _Z)]
_ABOUT = [("rx", BALL, _X), ("ry", BALL, _Y), ("rz", BALL, _Z)]


def grounded(tree: Tree, base=None) -> tuple[Tree, str]:
    """Return (the tree, its first link), on one of `BASES` or on a link.

    Raises: ArgumentError for a moving base if the file has its own joint for that.
    """
    if base is None or base in tree.links:
        return tree, base or tree.root
    kind = BASES[base]
    if kind is None:
        return tree, tree.root
    if name := next((e.name for e in tree.below[tree.root] if e.type in ("floating", "planar")), None):
        must = f"be left out for {tree.file}, where joint {name!r} already moves what it carries"
        raise errors.fail("base", must, f"is {base!r}")
    ground = next(name for name in ("world", "ground", "_world", "_ground") if name not in tree.links)
    joint = Edge("base", kind, ground, tree.root, NO_OFFSET, _Z)
    return dataclasses.replace(tree, root=ground, links=(*tree.links, ground), edges=(*tree.edges, joint)), ground


def unfolded(tree: Tree, base, tips) -> Tree:
    """Return the tree with the joints between its first link and the tips split into joints of one coordinate each.

    A planar joint becomes P, P, R: two translations in the plane across its axis, then the rotation about it. A
    floating joint becomes P, P, P along the axes of its frame, then three joints that form one rotation, as a ball
    joint does. The links in between have no shape.
    """
    ways = {edge.name for tip in tips for way in tree.way(tip, base) for edge in way}
    edges = tuple(part for edge in tree.edges for part in (_parts(edge) if edge.name in ways else [edge]))
    known = set(tree.links)
    between = (edge.child for edge in edges if edge.child not in known)
    return dataclasses.replace(tree, links=(*tree.links, *between), edges=edges)


def _parts(edge):
    """Return the joint as joints of one coordinate each, named after it."""
    if edge.type == "planar":
        across, along = _across(edge.axis)
        parts = [("x", "prismatic", across), ("y", "prismatic", along), ("yaw", "continuous", edge.axis)]
    elif edge.type in ("floating", "ball"):
        parts = _ALONG * (edge.type == "floating") + _ABOUT
    else:
        return [edge]
    links = [edge.parent, *(f"{edge.name}_{name}" for name, _, _ in parts[:-1]), edge.child]
    origins = [edge.origin, *[NO_OFFSET] * 5]
    return [
        Edge(f"{edge.name}_{name}", kind, links[i], links[i + 1], origins[i], axis)
        for i, (name, kind, axis) in enumerate(parts)
    ]


def _across(axis):
    """Return two axes across a unit axis, right-handed with it; x and y if the axis is z."""
    x, y, z = axis
    s = 1 if z > -0.5 else -1
    k = 1 / (1 + s * z)  # the shortest rotation from ±z to the axis, applied to x and ±y
    return (1 - k * x * x, -k * x * y, -s * x), (-s * k * x * y, s * (1 - k * y * y), -y)
