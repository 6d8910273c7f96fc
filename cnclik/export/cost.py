"""Cost: how many operations a call takes at most, and whether there is such a number."""

from collections import Counter

from cnclik.engine.graph import Cond, Node, Scan, UnsupportedError, live
from cnclik.engine.operations import COST, is_operation
from cnclik.engine.to_c import cells_of

_KINDS = ("arithmetic", "division and root", "library")


def operations(program) -> dict:
    """{kind: how many} of the dearest way through; comparisons are not counted. Raises: `UnsupportedError`."""
    total = _block(program.graph.root, live([node for out in program.outs for node in cells_of(out)]))
    return {name: total[name] for name in _KINDS}


def _block(block, needed) -> Counter:
    total = Counter()
    for item in block.items:
        if isinstance(item, Node):
            counts = item.number in needed and item.dtype.kind == "f" and is_operation(item) and item.op != "select_n"
            total[_kind(item.op)] += counts * (item.shape[0] if item.shape else 1)
        elif id(item) in needed:
            total += _region(item, needed)
    return total


def _region(item, needed) -> Counter:
    if isinstance(item, Cond):
        return max((_block(b, needed) for b in item.blocks), key=Counter.total)
    if isinstance(item, Scan):
        return Counter({kind: count * item.length for kind, count in _block(item.block, needed).items()})
    again = item.then[item.carries.index(item.begins)] if item.begins in item.carries else None
    if again is None or not again.known or again.value:  # else it ends after its first round
        raise UnsupportedError("a `while` loop without a bound that is known has no C form")
    return _block(item.block, needed)


def _kind(op) -> str:
    cost = COST.get(op, 1)
    return _KINDS[0] if cost == 1 else _KINDS[1] if cost < 30 else _KINDS[2]
