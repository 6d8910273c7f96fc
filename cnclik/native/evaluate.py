"""Evaluate: a graph worked out in NumPy for many lanes at once. For test vectors, and as a second opinion."""

import numpy as np

from cnclik.native.graph import BOOL, Call, Choice, Loop, Node, live
from cnclik.native.operations import OPERATIONS

_MANY = {"select": np.where, "not": np.logical_not, "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor}


def evaluate(graph, outputs, inputs) -> list:
    """Values of the output nodes, an array over lanes each.

    Args:
      inputs: {name: (lanes, size)} of all arguments that the outputs need.
    """
    needed, values = live(graph, outputs), {}
    dtype = graph.dtype

    def of(node):
        if node.known:
            return node.value if node.kind != "real" else dtype.type(node.value)
        if node.op == "input":
            name, place = node.value
            return inputs[name][:, place]
        return values[node.number]

    def block(b):
        for item in b.items:
            if isinstance(item, Node):
                if item.number in needed:
                    values[item.number] = one(item)
            elif id(item) in needed:
                {Loop: loop, Choice: choice, Call: call}[type(item)](item)

    def call(made):
        args = np.stack(np.broadcast_arrays(*map(of, made.args), np.empty(lanes, dtype))[:-1], -1)
        ends(made, evaluate(made.function.graph, made.function.results, {"a": args}))

    def one(node):
        args = [of(a) for a in node.args]
        if node.op == "pick":
            index, *cells = args
            table = np.stack(np.broadcast_arrays(*cells, index)[:-1])
            return np.take_along_axis(table, np.broadcast_to(index, table.shape[1:])[None], 0)[0]
        if node.op == "to_int":
            return np.where(np.isnan(args[0]), 0, np.clip(args[0], -(2.0**31), 2.0**31 - 1)).astype(np.int32)
        if node.op in ("to_real", "bool_to_int"):
            return np.asarray(args[0]).astype(dtype if node.op == "to_real" else np.int32)
        found = (_MANY.get(node.op) or OPERATIONS[node.op].now)(*args)
        return np.asarray(found).astype({"real": dtype, "int": np.int32}.get(node.kind, bool))

    def loop(made):
        state = [of(node) if node.number in needed else None for node in made.first]
        for k in range(made.length if isinstance(made.length, int) else int(np.max(of(made.length)))):
            values[made.index.number] = np.int32(k)
            for node, value in zip(made.carries, state, strict=True):
                values[node.number] = value
            block(made.block)
            state = [of(n) if c.number in needed else None for n, c in zip(made.then, made.carries, strict=True)]
        ends(made, state)

    def choice(made):
        which, found = of(made.which), []
        for b in made.blocks:
            block(b)
        wanted = {n.value[1] for n in graph.ends if n.value[0] is made and n.number in needed}
        for i in range(len(made.results[0])):
            if i not in wanted:
                found.append(None)
                continue
            several = [of(results[i]) for results in made.results]
            picked = np.where(which, several[1], several[0]) if made.which.kind == BOOL else np.choose(which, several)
            found.append(picked)
        ends(made, found)

    def ends(region, found):
        for node in graph.ends:
            if node.value[0] is region:
                values[node.number] = found[node.value[1]]

    lanes = len(next(iter(inputs.values())))
    with np.errstate(all="ignore"):
        block(graph.root)
        return [np.broadcast_to(of(node), (lanes,)) for node in outputs]
