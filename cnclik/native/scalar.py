"""Scalar: a graph as the statements of a C99 function."""

import math

import numpy as np

from cnclik.native.graph import BOOL, INT, REAL, Call, Choice, Loop, Node, live
from cnclik.native.operations import OPERATIONS

_OF_WHOLE = {  # numbers that can't be NaN
    "max": "{0} > {1} ? {0} : {1}",
    "min": "{0} < {1} ? {0} : {1}",
    "abs": "{0} < 0 ? -{0} : {0}",
    "rem": "{0} % {1}",
}
TYPES = {REAL: "@REAL@", INT: "int32_t", BOOL: "int"}


def number(value, kind, dtype) -> str:
    """A constant in C, exact."""
    if kind != REAL:
        return str(int(value))
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    single = np.dtype(dtype).itemsize == 4
    digits = str(np.float32(value)) if single else repr(float(value))
    return digits + "f" * single


def rows(values, kind, dtype, indent="  ") -> str:
    """A table's initializer in C, row by row."""
    lines = (", ".join(number(v, kind, dtype) for v in row) for row in np.asarray(values).tolist())
    return "{\n" + ",\n".join(f"{indent}{{{line}}}" for line in lines) + f"\n{indent[2:]}}}"


class Writer:
    """Writes the statements of a graph.

    types: what numbers of each kind are called in C. sincos_function: what gives both of an angle.
    """

    types, sincos_function = TYPES, "@SINCOS@"

    def __init__(self, graph, outputs, places, functions=None):
        """places: {input name: (C expression, whether it is an array)}; functions: {function: its name in C}."""
        self.graph, self.places, self.functions = graph, places, functions or {}
        self.needed = live(graph, outputs)
        self.lines, self.names, self.used, self.depth = [], {}, set(), 1
        self.counted = 0

    def statements(self) -> list:
        """All lines but those of the results; `used` then holds the operations in them."""
        self.inputs()
        self.block(self.graph.root)
        return self.lines

    def inputs(self):
        """Every argument is read once, and before anything is written."""
        stack, seen = [self.graph.root], {}
        for block in stack:
            for item in block.items:
                if isinstance(item, Node):
                    seen |= {a.number: a for a in item.args if a.op == "input"}
                elif isinstance(item, Call):
                    continue
                else:
                    stack += [item.block] if isinstance(item, Loop) else item.blocks
        for node in sorted(seen.values(), key=lambda n: n.number):
            self.input(node)

    def input(self, node):
        """One argument; said again, nothing."""
        if node.number in self.needed and node.number not in self.names:
            name, place = node.value
            place_of, array = self.places[name]
            self.declare(node, f"{place_of}[{place}]" if array else place_of)

    # --- names ----------------------------------------------------------------------------------------

    def new(self, kind=REAL) -> str:
        """A name not in use."""
        self.counted += 1
        return f"{'vnb'[(REAL, INT, BOOL).index(kind)]}{self.counted}"

    def of(self, node) -> str:
        """A node in an expression."""
        if node.known:
            text = number(node.value, node.kind, self.graph.dtype)
            return f"({text})" if text.startswith("-") else text
        if node.op == "input":
            self.input(node)
        return self.names[node.number]

    def line(self, text):
        self.lines.append("  " * self.depth + text)

    def declare(self, node, text):
        self.names[node.number] = self.new(node.kind)
        self.line(f"const {self.types[node.kind]} {self.names[node.number]} = {text};")

    # --- statements -----------------------------------------------------------------------------------

    def block(self, block):
        for item in block.items:
            if isinstance(item, Node):
                if item.number in self.needed and item.number not in self.names:
                    self.node(item)
            elif self.needs(item):
                {Loop: self.loop, Choice: self.choice, Call: self.call}[type(item)](item)

    def needs(self, item) -> bool:
        """Whether a node or region has a part in the results."""
        return (item.number if isinstance(item, Node) else id(item)) in self.needed

    def call(self, call):
        given, found, real = self.new(), self.new(), self.types[REAL]
        self.line(f"const {real} {given}[{len(call.args)}] = {{{', '.join(map(self.of, call.args))}}};")
        self.line(f"{real} {found}[{len(call.function.results)}];")
        self.line(f"{self.functions[call.function]}({given}, {found});")
        places = range(len(call.function.results))
        self.outs(call, places, [f"{found}[{i}]" for i in places])

    def node(self, node):
        if node.op in ("sin", "cos"):
            self.sincos(node)
        elif node.op == "pick":
            self.pick(node)
        else:
            self.used.add(node.op)
            single = "f" * (self.graph.dtype.itemsize == 4)
            text = _OF_WHOLE.get(node.op) if node.kind != REAL else None
            self.declare(node, (text or OPERATIONS[node.op].text).format(*map(self.of, node.args), f=single))

    def sincos(self, node):
        """Both of an angle at once, and the one alone where that is all that is wanted."""
        self.used.add("sincos")
        (x,) = node.args
        names = []
        for op in ("sin", "cos"):
            name = self.new()
            names.append(name)
            there = node if op == node.op else node.block.table.get((op, REAL, None, x.number))
            if there is not None:
                self.names[there.number] = name
        self.line(f"{self.types[REAL]} {names[0]}, {names[1]};")
        self.line(f"{self.sincos_function}({self.of(x)}, &{names[0]}, &{names[1]});")

    def pick(self, node):
        index, *cells = node.args
        table = self.new()
        constant = all(c.known for c in cells)
        kind = ("static const " if constant else "const ") + self.types[node.kind]
        self.line(f"{kind} {table}[{len(cells)}] = {{{', '.join(map(self.of, cells))}}};")
        self.declare(node, f"{table}[{self.of(index)}]")

    def loop(self, loop):
        carried = [i for i, node in enumerate(loop.carries) if node.number in self.needed]
        for i in carried:
            name = self.names[loop.carries[i].number] = self.new(loop.carries[i].kind)
            self.line(f"{self.types[loop.carries[i].kind]} {name} = {self.of(loop.first[i])};")
        index = self.names[loop.index.number] = self.new(INT)
        length = self.of(loop.length) if isinstance(loop.length, Node) else loop.length
        self.line(f"for (int32_t {index} = 0; {index} < {length}; ++{index}) {{")
        self.inside(loop.block, lambda: self.assign(loop, carried))
        self.line("}")
        self.outs(loop, carried, [self.names[loop.carries[i].number] for i in carried])

    def assign(self, loop, carried):
        """The next values of what is carried; one that is another's old value is put aside first."""
        later = []
        for i in carried:
            then, name = loop.then[i], self.names[loop.carries[i].number]
            if then is loop.carries[i]:
                continue
            if then.op == "carry" and then.value[0] is loop:
                aside = self.new(then.kind)
                self.line(f"const {self.types[then.kind]} {aside} = {self.of(then)};")
                later.append((name, aside))
            else:
                later.append((name, self.of(then)))
        for name, value in later:
            self.line(f"{name} = {value};")

    def inside(self, block, ending):
        self.depth += 1
        self.block(block)
        ending()
        self.depth -= 1

    def outs(self, region, places, names):
        region_names = dict(zip(places, names, strict=True))
        self.names |= {n: region_names[i] for n, i in self.results.get(id(region), {}).items() if i in region_names}

    @property
    def results(self):
        """{region: {number of a node that stands for a result of it: which}}."""
        if not hasattr(self, "_results"):
            self._results = {}
            for node in self.graph.ends:
                region, i = node.value
                self._results.setdefault(id(region), {})[node.number] = i
        return self._results

    def choice(self, choice: Choice):
        wanted = sorted({i for n, i in self.results.get(id(choice), {}).items() if n in self.needed})
        kinds = [choice.results[0][i].kind for i in wanted]
        names = [self.new(k) for k in kinds]
        empty = not any(map(self.needs, choice.blocks[0].items))
        two = choice.which.kind == BOOL

        def set_to(results):
            def ending():
                for i, name in zip(wanted, names, strict=True):
                    self.line(f"{name} = {self.of(results[i])};")

            return ending

        for i, kind, name in zip(wanted, kinds, names, strict=True):
            at_first = f" = {self.of(choice.results[0][i])}" if two and empty else ""
            self.line(f"{self.types[kind]} {name}{at_first};")
        which = self.of(choice.which)
        if two:
            self.line(f"if ({which}) {{")
            self.inside(choice.blocks[1], set_to(choice.results[1]))
            if not empty:
                self.line("} else {")
                self.inside(choice.blocks[0], set_to(choice.results[0]))
            self.line("}")
        else:
            for i, (block, results) in enumerate(zip(choice.blocks, choice.results, strict=True)):
                last = i == len(choice.blocks) - 1
                self.line(("} else " if i else "") + ("{" if last else f"if ({which} == {i}) {{"))
                self.inside(block, set_to(results))
            self.line("}")
        self.outs(choice, wanted, names)
