"""Pieces: a long block as several C functions, since a compiler's time grows faster than a function's length.

What goes from one to another lies in an array of the function around them.
"""

from cnclik.engine.graph import Node
from cnclik.engine.operations import is_operation
from cnclik.engine.row_texts import all_items

_ARGUMENTS = "(char *restrict env, const void *const *in, const int64_t *stride, int64_t first, int64_t n, char *work)"


def in_pieces(writer, items, ending):
    """Writes the items of a block as functions of some statements each; loops and branches stay outside."""
    groups = _groups(items, writer.piece)
    home = {n.number: k for k, group in enumerate(groups) for n in group if isinstance(n, Node) and len(group) > 1}
    home |= {n.number: k for k, group in enumerate(groups) for n in group if isinstance(n, Node)}
    places, size = {}, 0
    for k, group in enumerate(groups):
        for item in group:
            for n in _scalars(item):
                inside = _is_inline(group) and n.number not in home
                if n.number not in places and not n.known and home.get(n.number) != k and not inside:
                    places[n.number] = n, size
                    size += -(-writer.vector_bytes(n.dtype) // 256) * 256
    for n in ending:
        if n.number in home and n.number not in places:
            places[n.number] = n, size
            size += -(-writer.vector_bytes(n.dtype) // 256) * 256
    env = writer.new("env")
    writer.line(f"char {env}_[{size + 256}], *{env} = (char *)(((uintptr_t){env}_ + 255) & ~(uintptr_t)255);")

    def place(number, var):
        n, at = places[number]
        return f"(*({writer.type(n)} *)({var} + {at}))"

    for number, (n, _) in places.items():  # what is there already
        if number not in home and number in writer.names:
            writer.line(f"{place(number, env)} = {writer.of(n)};")
    for k, group in enumerate(groups):
        if _is_inline(group):
            _outside(writer, group[0], places, place, env)
        else:
            before = [m for m in places if home.get(m, -1) < k]
            _function(writer, group, before, places, lambda m: place(m, "env"))
            writer.line(f"{writer.parts[-1][0]}({env}, in, stride, first, n, work);")
            writer.names |= {n.number: place(n.number, env) for n in group if n.number in places}


def _outside(writer, item, places, place, env):
    """A region, or what reads rows: where it stands, in the function around the pieces."""
    writer.items([item])
    for n in [item] if isinstance(item, Node) else item.outs:
        if n.number in places and n.number in writer.names:
            writer.line(f"{place(n.number, env)} = {writer.of(n)};")
            writer.names[n.number] = place(n.number, env)


def _function(writer, group, before, places, place):
    lines, names, writer.lines = writer.lines, writer.names, []
    writer.names = {m: place(m) for m in before}
    writer.scopes.append([])
    writer.items(group)
    for n in group:
        if n.number in places:
            writer.line(f"{place(n.number)} = {writer.of(n)};")
    writer.leave()
    name = f"piece{len(writer.parts)}"
    body = "\n".join(writer.lines)
    writer.parts.append((name, f"static void __attribute__((noinline)) {name}{_ARGUMENTS}\n{{\n{body}\n}}\n"))
    writer.lines, writer.names = lines, names


def _is_plain(item) -> bool:
    """Whether an item may be part of a function of its own: it reads scalars and arguments alone."""
    if not isinstance(item, Node) or item.shape:
        return False
    return is_operation(item) or item.op == "pick" or (item.op == "index" and item.args[0].op == "input")


def _is_inline(group) -> bool:
    return not _is_plain(group[0])


def _groups(items, most):
    groups = []
    for item in items:
        if groups and _is_plain(item) and not _is_inline(groups[-1]) and len(groups[-1]) < most:
            groups[-1].append(item)
        else:
            groups.append([item])
    return groups


def _scalars(item):
    """Scalar nodes that an item refers to, through the rows it reads and the regions in it."""
    if isinstance(item, Node):
        queue = list(item.args)
    else:
        inner = list(all_items(*item.blocks))
        regions = [item, *(i for i in inner if not isinstance(i, Node))]
        queue = [n for r in regions for n in (*r.used, *getattr(r, "xs", ()))]
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
    """The scalar nodes that a result is, or that its row is made of."""
    return _scalars(result) if result.shape else (result,)
