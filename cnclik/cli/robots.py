"""`cnclik robots`: the tree of a robot file, its joints, limits and the links that can be a tip."""

import math

from cnclik.cli.common import print_table
from cnclik.problem.options import PLANAR, ROBOTS


def run(robot: str) -> None:
    """Print the tree of links with joints and limits, and possible tips.

    Args:
      robot: a URDF or MJCF file, a name of robot_descriptions, or a built-in robot such as panda.
    """
    from cnclik.robot.files import file_of, read_robot

    kind = robot.partition(":")[0]
    if kind in (*ROBOTS, *PLANAR):
        from cnclik.problem.names import load

        chain = load(robot)
        print(f"{robot}, built in, tip {(ROBOTS | PLANAR)[kind]}")
        each = zip(chain.joint_names, chain.lower, chain.upper, chain.units, chain.velocity_limit, strict=True)
        print(*("  {0}: {1:.4g} to {2:.4g} {3}, up to {4:.4g} {3}/s".format(*joint) for joint in each), sep="\n")
        return
    tree = read_robot(file_of(robot) or robot)
    print(f"{tree.name}, base {tree.root}")
    head = ("link", "joint", "type", "lower", "upper", "velocity")
    print_table(head, (tree.root, *[""] * 5), *_branches(tree), left=3)
    moving = sum(edge.type != "fixed" for edge in tree.edges)
    mimic = sum(edge.mimic is not None for edge in tree.edges)
    print(f"{len(tree.links)} link{'s' * (len(tree.links) != 1)}, {moving} moving joints, {mimic} of them mimic.")
    print(f"Tips (leaf links that a joint moves; any link may be one): {', '.join(tree.tips()) or 'none'}.")


def _branches(tree):
    """A row for every joint in depth-first order, indented by its depth."""
    waiting = [(edge, 1) for edge in reversed(tree.below[tree.root])]
    while waiting:
        edge, depth = waiting.pop()
        waiting += [(below, depth + 1) for below in reversed(tree.below[edge.child])]
        unit, kind, bounds = "m" if edge.type == "prismatic" else "rad", edge.type, ("", "", "")
        if edge.mimic:
            leader, multiplier, offset = edge.mimic
            kind += f", {multiplier:g} × {leader}" + (f" {offset:+g}" if offset else "")
        if edge.type != "fixed":
            each = (edge.lower, unit), (edge.upper, unit), (edge.velocity, f"{unit}/s")
            bounds = ("—" if math.isinf(value) else f"{value:.4g} {of}" for value, of in each)
        yield f"{'  ' * min(depth, 60)}{edge.child}", edge.name, kind, *bounds
