"""Cost: the largest number of operations of a call, if it is bounded."""

from collections import Counter

from cnclik.engine.graph import Cond, Node, Scan, UnsupportedError, live
from cnclik.engine.operations import COST, is_operation
from cnclik.engine.row_texts import cells_of

_KINDS = ("arithmetic", "division and root", "library")


def operations(program) -> dict:
    """{kind: number} on the most expensive path, without comparisons. Raises: `UnsupportedError`."""
    total = _block(program.graph.root, live([node for out in program.outs for node in cells_of(out)]))
    return {name: total[name] for name in _KINDS}


def _block(block, needed) -> Counter:
    total = Counter()
    for item in block.items:
        if isinstance(item, Node):
            counts = item.number in needed and item.dtype.kind == "f" and is_operation(item) and item.op != "select_n"
            total[_kind(item.op)] += counts * (item.shape[0] if item.shape else 1)
        elif item.number in needed:
            total += _region(item, needed)
    return total


def _region(item, needed) -> Counter:
    if isinstance(item, Cond):
        return max((_block(b, needed) for b in item.blocks), key=Counter.total)
    rounds = item.length if isinstance(item, Scan) else _rounds(item)
    return Counter({kind: count * rounds for kind, count in _block(item.block, needed).items()})


def _rounds(loop) -> int:
    """The most rounds of a `while`: one if the first round ends it, otherwise the number that it counts."""
    begins = loop.begins
    again = loop.then[loop.carries.index(begins)] if begins in loop.carries else None
    if again is not None and again.known and not again.value:
        return 1
    for asked in (begins, *begins.args) if begins.op == "and" else (begins,):
        if asked.op == "lt" and asked.args[0] in loop.carries and asked.args[1].known:
            count, end = asked.args
            first, then = (of[loop.carries.index(count)] for of in (loop.first, loop.then))
            counts = then.op == "add" and count in then.args and any(a.known and a.value == 1 for a in then.args)
            if first.known and counts:
                return max(int(end.value) - int(first.value), 0)
    raise UnsupportedError("a `while` loop without a bound that is known has no C form")


def _kind(op) -> str:
    cost = COST.get(op, 1)
    return _KINDS[0] if cost == 1 else _KINDS[1] if cost < 30 else _KINDS[2]
