"""`cnclik robots`: what a URDF file holds: its tree, joints, limits and the links that can be a tip."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import tyro

from cnclik.cli.common import CacheOption

DEEPEST = 120  # columns that the lines of the tree take; what is deeper stands below one another


@dataclasses.dataclass(kw_only=True)
class Args(CacheOption):
    """Show a robot's tree, joints and limits."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """A URDF file."""


def run(args: Args) -> None:
    from cnclik.robot.tree import read_urdf

    tree = read_urdf(args.file)
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    shown = Table(title=escape(f"{tree.name}, base {tree.root}"), title_justify="left", box=None, padding=(0, 2, 0, 0))
    for name in ("link", "joint", "type", "lower", "upper", "velocity"):
        right = name in ("lower", "upper", "velocity")
        shown.add_column(name, justify="right" if right else "left", overflow="fold", no_wrap=name == "link")
    tips = set(tree.tips())
    shown.add_row(escape(tree.root), *[""] * 5)
    for edge, lead in _branches(tree):
        name = escape(f"{lead}{edge.child}")
        style = "bold" if edge.child in tips else None
        shown.add_row(f"[{style}]{name}[/]" if style else name, *map(escape, _joint(edge)))
    console = Console()
    if not console.is_terminal:
        console.width = 400  # a pipe or file shall not cut names
    console.print(shown)
    moving = sum(edge.type != "fixed" for edge in tree.edges)
    mimic = sum(edge.mimic is not None for edge in tree.edges)
    links = "1 link" if len(tree.links) == 1 else f"{len(tree.links)} links"
    print(f"{links}, {moving} moving joints, {mimic} of them mimic.")
    print(f"Tips (leaf links that a joint moves): {', '.join(tree.tips()) or 'none'}.")


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
