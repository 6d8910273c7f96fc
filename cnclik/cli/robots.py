"""`cnclik robots`: the tree of a robot file, its joints, limits and the links that can be a tip."""

import math
import sys

from cnclik.problem.words import PLANAR, ROBOTS

DEEPEST = 120  # columns of the tree's lines; deeper links are not indented further


def run(robot: str) -> None:
    """Print the tree of links with joints and limits; possible tips are in bold.

    Args:
      robot: a URDF or MJCF file, a name of robot_descriptions, or a built-in robot such as panda.
    """
    from cnclik.robot.files import file_of, read_robot

    if robot.partition(":")[0] in (*ROBOTS, *PLANAR):
        from cnclik.problem.names import robot_and_tip

        chain, tip = robot_and_tip(robot)
        print(f"{robot}, built in, tip {tip}\n{chain}")
        return
    tree = read_robot(file_of(robot) or robot)
    tips = dict.fromkeys(tree.tips())
    rows = [(tree.root in tips, tree.root, *[""] * 5)]
    rows += [(edge.child in tips, f"{lead}{edge.child}", *_joint(edge)) for edge, lead in _branches(tree)]
    print(_plain(f"{tree.name}, base {tree.root}"))
    _show([(False, "link", "joint", "type", "lower", "upper", "velocity"), *rows])
    moving = sum(edge.type != "fixed" for edge in tree.edges)
    mimic = sum(edge.mimic is not None for edge in tree.edges)
    links = "1 link" if len(tree.links) == 1 else f"{len(tree.links)} links"
    print(f"{links}, {moving} moving joints, {mimic} of them mimic.")
    for name, straight, beyond in _past_straight(tree):
        print(
            f"Joint {_plain(name)} is straight at {round(math.degrees(straight), 1) + 0.0:.1f}° and bends "
            f"{math.degrees(beyond):.0f}° beyond: start it bent the usual way, and give `near` to reach."
        )
    print(f"Tips (leaf links that a joint moves; any link may be one): {_plain(', '.join(tips)) or 'none'}.")


def _past_straight(tree):
    """Elbows and knees whose range passes the straight posture by a few degrees, of all tips."""
    from cnclik import errors
    from cnclik.robot.posture import past_straight
    from cnclik.robot.urdf import chain

    try:
        return past_straight(chain(tree, tips=list(tree.tips())))
    except errors.ArgumentError:  # a tree that is no robot yet, such as one with two movable bases
        return []


def _show(rows) -> None:
    """Print rows of (bold, texts) in columns. For thousands of rows a table of rich takes half a minute."""
    from rich.cells import cell_len

    rows = [(bold, *map(_plain, texts)) for bold, *texts in rows]
    widths = [[cell_len(text) for text in texts] for _, *texts in rows]
    most = [max(column) for column in zip(*widths, strict=True)]
    for (bold, *texts), width in zip(rows, widths, strict=True):
        gaps = [" " * (m - w) for m, w in zip(most, width, strict=True)]
        cells = [t + g if k < 3 else g + t for k, (t, g) in enumerate(zip(texts, gaps, strict=True))]  # numbers right
        line = "  ".join(cells).rstrip()
        print(f"\x1b[1m{line}\x1b[0m" if bold and sys.stdout.isatty() else line)


def _plain(text) -> str:
    """The text without characters that move a terminal's cursor or end a line."""
    return text if text.isprintable() else ascii(text)[1:-1]


def _branches(tree):
    """Every joint in depth-first order, with the lines that draw its place in the tree."""
    waiting = [(edge, "", k == 0) for k, edge in enumerate(reversed(tree.below[tree.root]))]
    while waiting:
        edge, before, last = waiting.pop()
        yield edge, f"{before}{'└ ' if last else '├ '}"
        inner = before + ("  " if last else "│ ") if len(before) < DEEPEST else before
        waiting += [(e, inner, k == 0) for k, e in enumerate(reversed(tree.below[edge.child]))]


def _joint(edge):
    unit = "m" if edge.type == "prismatic" else "rad"
    if edge.type == "fixed":
        return edge.name, "fixed", "", "", ""
    kind = edge.type
    if edge.mimic:
        leader, multiplier, offset = edge.mimic
        kind += f", {multiplier:g} × {leader}" + (f" {offset:+g}" if offset else "")
    return edge.name, kind, _bound(edge.lower, unit), _bound(edge.upper, unit), _bound(edge.velocity, f"{unit}/s")


def _bound(value, unit):
    return "—" if math.isinf(value) else f"{value:.4g} {unit}"
