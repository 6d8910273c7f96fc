"""Vector: a graph as statements on vectors of lanes, by the vector types of GCC and Clang.

A scalar becomes a vector of lanes, a comparison a mask; branches run where some lane needs them, and each lane keeps
what is its own. Loops have the same length in all lanes.
"""

from cnclik.native.graph import BOOL, INT, REAL, Choice, functions
from cnclik.native.operations import OPERATIONS
from cnclik.native.scalar import Writer, number

_TEXTS = {
    "abs": "vabs({0})",
    "sqrt": "vsqrt({0})",
    "atan2": "vatan2({0}, {1})",
    "max": "SEL(({0} > {1}) | ({0} != {0}), {0}, {1})",
    "min": "SEL(({0} < {1}) | ({0} != {0}), {0}, {1})",
    "select": "SEL({0}, {1}, {2})",
    "not": "~{0}",
    "is_finite": "(({0} - {0}) == ({0} - {0}))",
    "round_even": "vround({0})",
    "to_int": "vint({0})",
    "to_real": "__builtin_convertvector({0}, V)",
    "bool_to_int": "-{0}",
}
_WHOLE = {
    "max": "SELI({0} > {1}, {0}, {1})",
    "min": "SELI({0} < {1}, {0}, {1})",
    "select": "SELI({0}, {1}, {2})",
    "abs": "SELI({0} < 0, -{0}, {0})",
}


class VectorWriter(Writer):
    """Writes the statements of a graph for vectors of lanes."""

    types, sincos_function = {REAL: "V", INT: "I", BOOL: "I"}, "vsincos"

    def __init__(self, graph, outputs, places, functions=None):
        super().__init__(graph, outputs, places, functions)
        self.mapped = set()  # functions of libm, called lane by lane

    def of(self, node) -> str:
        if node.known:
            text = number(node.value, node.kind, self.graph.dtype)
            if node.kind == REAL:
                return f"SPLAT({text})"
            return f"SPLATI({-int(node.value) if node.kind == BOOL else text})"
        if node.op == "index":
            return f"SPLATI({self.names[node.number]})"
        return super().of(node)

    def plain(self, node) -> str:
        """A node beside a vector in arithmetic, where a constant may stay a scalar."""
        if node.known and node.kind == REAL:
            return f"({number(node.value, node.kind, self.graph.dtype)})"
        return self.of(node)

    def input(self, node):
        if node.number in self.needed and node.number not in self.names:
            name, place = node.value
            where, _ = self.places[name]
            self.declare(node, where.format(place))

    def node(self, node):
        if node.op in ("sin", "cos"):
            self.sincos(node)
        elif node.op == "pick":
            self.pick(node)
        elif node.op in ("add", "sub", "mul", "div", "lt", "le", "eq", "ne") and node.args[0].kind == REAL:
            self.declare(node, OPERATIONS[node.op].text.format(*map(self.plain, node.args)))
        else:
            whole = node.kind != REAL and node.args[-1].kind != REAL
            text = (_WHOLE.get(node.op) if whole else None) or _TEXTS.get(node.op)
            if text is None and OPERATIONS[node.op].text[0] not in "{-":
                self.mapped.add(node.op)
                text = f"v{node.op}({', '.join(f'{{{i}}}' for i in range(len(node.args)))})"
            self.used.add(node.op)
            self.declare(node, (text or OPERATIONS[node.op].text).format(*map(self.of, node.args)))

    def pick(self, node):
        index, *cells = node.args
        table, name, at = self.new(), self.new(node.kind), self.new(INT)
        self.names[node.number] = name
        kind = self.types[node.kind]
        self.line(f"const I {at} = {self.of(index)};")
        self.line(f"const {kind} {table}[{len(cells)}] = {{{', '.join(map(self.of, cells))}}};")
        self.line(f"{kind} {name};")
        self.line(f"for (int i = 0; i < W; ++i) {name}[i] = {table}[{at}[i]][i];")

    # --- regions --------------------------------------------------------------------------------------

    def choice(self, choice: Choice):
        wanted = sorted({i for n, i in self.results.get(id(choice), {}).items() if n in self.needed})
        kinds = [choice.results[0][i].kind for i in wanted]
        names = [self.new(k) for k in kinds]
        which = self.new(BOOL)
        self.line(f"const I {which} = {self.of(choice.which)};")
        for i, kind, name in zip(wanted, kinds, names, strict=True):
            seen = choice.results[0][i]
            at_first = self.of(seen) if seen.known or seen.number in self.names else f"({self.types[kind]})vzero()"
            self.line(f"{self.types[kind]} {name} = {at_first};")
        two = choice.which.kind == BOOL
        for k, (block, results) in enumerate(zip(choice.blocks, choice.results, strict=True)):
            busy = any(self.needs(item) for item in block.items)
            if k == 0 and not busy and two:
                continue  # what it gives is there
            mask = (f"~{which}", which)[k] if two else f"({which} == {k})"
            self.line(f"if (ANY({mask})) {{")

            def ending(results=results, mask=mask):
                for i, kind, name in zip(wanted, kinds, names, strict=True):
                    pick = "SEL" if kind == REAL else "SELI"
                    self.line(f"{name} = {pick}({mask}, {self.of(results[i])}, {name});")

            self.inside(block, ending)
            self.line("}")
        self.outs(choice, wanted, names)


def inner(graph, prefix) -> tuple:
    """The functions that a graph calls several times: their texts, {function: its name in C}, and their writers."""
    called = {f: f"{prefix}_part{i}" for i, f in enumerate(functions(graph), 1)}
    texts, writers = [], []
    for function, name in called.items():
        writer = VectorWriter(function.graph, function.results, {"a": ("a[{0}]", True)}, called)
        lines = writer.statements()
        lines += [f"  r[{i}] = {v};" for i, v in enumerate([writer.of(node) for node in function.results])]
        texts.append(f"static void {name}(const V *a, V *r)\n{{\n" + "\n".join(lines) + "\n}\n")
        writers.append(writer)
    return texts, called, writers
