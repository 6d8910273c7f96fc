"""Pieces: a long block as several C functions, as compile time grows faster than the length of a function.

Values pass between them in the work memory, as soon as they are computed: then the compiler need not keep them in
registers or on the stack up to the piece's end. A place is reused once its value has been read for the last time.
"""

from cnclik.engine.graph import Node
from cnclik.engine.operations import NAMES
from cnclik.engine.row_texts import all_items

_ARGUMENTS = "(const void *const *in, const int64_t *stride, int64_t first, int64_t n, char *restrict work)"


def in_pieces(writer, items, ending):
    """Writes the items of a block as functions of some statements each; loops and branches stay outside."""
    groups = _groups(items, writer.piece)
    made = [(k, [item] if isinstance(item, Node) else item.outs) for k, group in enumerate(groups) for item in group]
    home = {n.number: k for k, nodes in made for n in nodes}
    own = {k for k, group in enumerate(groups) if _is_plain(group[0])}  # groups that become functions
    last = {n.number: len(groups) for n in ending}  # the last group that reads a value
    passed = {n.number: n for n in ending if home.get(n.number) in own}
    for k, group in enumerate(groups):
        for n in (n for item in group for n in _scalars(item) if not n.known):
            at = home.get(n.number)
            last[n.number] = max(last.get(n.number, k), k)
            if at != k and {at, k} & own:
                passed[n.number] = n
    begin, end = ([[] for _ in range(len(groups) + 2)] for _ in range(2))
    for n in passed.values():
        if n.number not in writer.kept:
            begin[home.get(n.number, -1)].append(n)
            end[last[n.number]].append(n)
    unused: dict = {}  # free places, by type
    writes = writer.by_kind
    for n in begin[-1]:  # already computed
        _keep(writer, n, unused)
    for k, group in enumerate(groups):
        if k in own:
            lines, names, writer.lines, writer.names = writer.lines, writer.names, [], {}
            writer.scopes.append([])
        leaving = {n.number for n in begin[k]}
        for item in group:
            writes[type(item)](item)
            for n in [item] if isinstance(item, Node) else item.outs:
                if n.number in leaving:
                    _keep(writer, n, unused)
        for n in end[k]:
            unused.setdefault(n.dtype, []).append(writer.kept.pop(n.number))
        if k in own:
            writer.leave()
            name, body = f"piece{len(writer.parts)}", "\n".join(writer.lines)
            writer.parts.append((name, f"static void __attribute__((noinline)) {name}{_ARGUMENTS}\n{{\n{body}\n}}\n"))
            writer.lines, writer.names = lines, names
            writer.line(f"{name}(in, stride, first, n, work);")


def _keep(writer, n, unused):
    """Stores a value in the work memory, where all later pieces find it."""
    places = unused.get(n.dtype)
    place = places.pop() if places else f"*{writer.room(n.dtype, 1)}"
    writer.line(f"{place} = {writer.of(n)};")
    writer.kept[n.number] = place


def _is_plain(item) -> bool:
    """Whether an item may be part of a piece: it reads only scalars and arguments."""
    if not isinstance(item, Node) or item.shape:
        return False
    return item.op in NAMES or item.op == "pick" or (item.op == "index" and item.args[0].op == "input")


def _groups(items, most):
    groups = []
    for item in items:
        if groups and _is_plain(item) and _is_plain(groups[-1][0]) and len(groups[-1]) < most:
            groups[-1].append(item)
        else:
            groups.append([item])
    return groups


def _scalars(item):
    """Scalar nodes that an item reads, also through rows and inner regions."""
    if isinstance(item, Node):
        queue = list(item.args)
    else:
        inner = all_items(*item.blocks)
        regions = [item, *(i for i in inner if not isinstance(i, Node))]
        queue = [n for r in regions for n in r.used]
        queue += [a for i in inner if isinstance(i, Node) for a in i.args]
    seen = set()
    while queue:
        n = queue.pop()
        if n.number in seen:
            continue
        seen.add(n.number)
        if n.shape:
            queue += n.args
        elif n.op != "input" or not n.shape:
            yield n


def read_for(result):
    """The scalar nodes of a result or of its row."""
    return _scalars(result) if result.shape else (result,)
