"""Cost: how many operations a call takes at most."""

from collections import Counter

from cnclik.native.graph import REAL, Call, Loop, Node, live
from cnclik.native.operations import OPERATIONS

_CALLS = frozenset(name for name, op in OPERATIONS.items() if op.cost >= 5)


def operations(program) -> dict:
    """{"arithmetic", "division and root", "library"}: of the dearest way through; comparisons are not counted."""
    needed = live(program.graph, program.ends)
    total = _block(program.graph.root, needed)
    return {name: total[name] for name in ("arithmetic", "division and root", "library")}


def _block(block, needed) -> Counter:
    total = Counter()
    for item in block.items:
        if isinstance(item, Node):
            if item.number in needed and item.kind == REAL:
                total[_class(item.op)] += item.op not in ("select", "pick")
        elif id(item) in needed:
            if isinstance(item, Call):
                graph = item.function.graph
                total += _block(graph.root, live(graph, item.function.results))
            elif isinstance(item, Loop):
                rounds = item.length if isinstance(item.length, int) else 1
                total += Counter({k: v * rounds for k, v in _block(item.block, needed).items()})
            else:
                total += max((_block(b, needed) for b in item.blocks), key=lambda c: sum(c.values()))
    return total


def _class(op) -> str:
    return "library" if op in _CALLS else "division and root" if op in ("div", "sqrt") else "arithmetic"
