"""Bases: one that moves, and joints of several coordinates, as joints of one each. Read without loading JAX."""

import dataclasses
import math

from cnclik.robot.tree import NO_OFFSET, Edge, Tree

BASES = {"fixed": None, "planar": "planar", "free": "floating"}  # words for a base, and the joint that carries it
BALL = "ball"  # one of the three joints that together are a rotation, with the rotation vector as their values
_X, _Y, _Z = NO_OFFSET[1]


def grounded(tree: Tree, base=None) -> tuple[Tree, str]:
    """(the tree with joints of one coordinate each, its first link), on a base that is one of `BASES` or a link.

    A planar joint is P, P, R: two ways in the plane across its axis, then the turn about it. A floating one is P, P, P
    along the axes of its place, then three that are one rotation. In between stand links without a shape.
    """
    edges, links, root = list(tree.edges), list(tree.links), tree.root
    if BASES.get(base) is not None and base not in links:
        root = next(name for name in ("world", "ground", "_world", "_ground") if name not in links)
        links.append(root)
        edges.append(_joint("base", BASES[base], root, tree.root, NO_OFFSET, _Z))
    whole = [part for edge in edges for part in _parts(edge)]
    if len(whole) > len(tree.edges):
        links += [part.child for part in whole if part.child not in links]
        tree = dataclasses.replace(tree, root=root, links=tuple(links), edges=tuple(whole))
    return tree, base if base in tree.links else root


def _joint(name, kind, parent, child, origin, axis):
    """A joint without limits."""
    ends = {"name": name, "type": kind, "parent": parent, "child": child, "origin": origin, "axis": axis}
    return Edge(**ends, lower=-math.inf, upper=math.inf, velocity=math.inf, mimic=None)


def _parts(edge):
    """The joint as joints of one coordinate each, named after it."""
    if edge.type == "planar":
        across, along = _across(edge.axis)
        kinds = [("x", "prismatic", across), ("y", "prismatic", along), ("yaw", "continuous", edge.axis)]
    elif edge.type == "floating":
        kinds = [(name, "prismatic", axis) for name, axis in zip("xyz", (_X, _Y, _Z), strict=True)]
        kinds += [("r" + name, BALL, axis) for name, axis in zip("xyz", (_X, _Y, _Z), strict=True)]
    else:
        return [edge]
    ends = [edge.parent, *(f"{edge.name}_{name}" for name, _, _ in kinds[:-1]), edge.child]
    origins = [edge.origin, *[NO_OFFSET] * 5]
    return [
        _joint(f"{edge.name}_{name}", kind, ends[i], ends[i + 1], origins[i], axis)
        for i, (name, kind, axis) in enumerate(kinds)
    ]


def _across(axis):
    """Two axes of the plane across a unit axis, right-handed with it; x and y where that is z."""
    x, y, z = axis
    if z > -0.5:  # the shortest turn that takes z there takes x and y along
        k = 1 / (1 + z)
        return (1 - k * x * x, -k * x * y, -x), (-k * x * y, 1 - k * y * y, -y)
    k = 1 / (1 - z)
    return (1 - k * x * x, -k * x * y, x), (k * x * y, k * y * y - 1, -y)
