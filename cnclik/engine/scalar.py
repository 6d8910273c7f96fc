"""Scalar: a graph as the statements of a C99 function for one lane: plain numbers, branches and loops."""

import re

import numpy as np

from cnclik.engine.algebra import COMMUTES
from cnclik.engine.graph import Cond, UnsupportedError
from cnclik.engine.operations import BINARY, BITS, COMPARED, LIBRARY, header, number, scalar
from cnclik.engine.sines import filled
from cnclik.engine.to_c import Writer


class ScalarWriter(Writer):
    """Writes the statements of a graph for one lane. They call `helpers` for its `functions`."""

    beside = 1

    def __init__(self, graph, given, outs, reads, writes, prefix=""):
        super().__init__(graph, given, outs, np.dtype(np.float64), reads, writes)
        self.prefix = prefix

    def statements(self) -> list:
        return indented(super().statements())

    def type_of(self, dtype) -> str:
        return _type(dtype)

    def splat(self, dtype, words) -> str:
        return f"({words})" if words.startswith("-") else words

    def of(self, node, plain=False) -> str:
        if node.known and node.dtype.kind == "b":
            return str(int(node.value))
        return super().of(node)

    def room(self, dtype, entries, length=1) -> str:
        name = self.new("r")
        self.line(f"{_type(dtype)} {name}[{entries * length}];")
        return name

    def applied(self, node, of) -> str:
        if node.op in ("sin", "cos"):
            return self.sincos(node, of)
        args = node.args[::-1] if node.op in COMMUTES and node.args[0].known else node.args
        return _text(node, [of(a, False) for a in args])

    def sincos(self, node, of) -> str:
        self.functions.add(scalar(node.dtype))
        return super().sincos(node, of)

    def pick(self, n):
        index, *cells = n.args
        table = self.listed(cells, "static const" if all(c.known for c in cells) else "const")
        self.declare(n, f"{table}[{self.of(index)}]")

    def take(self, n):
        row, index = n.args
        self.declare(n, self.row(row, self.of(index), {}))

    def table(self, values, k) -> str:
        words = super().table(values, k)
        self.lines += self.tables
        self.tables = []
        return words

    def rounds(self, r, names):
        self.line(f"if (!{self.of(r.begins)}) {{")
        self.line("break;")
        self.line("}")
        self.block(r.block)
        self.move_on(r, names)

    def choice(self, r: Cond):
        alive = [i for i, o in enumerate(r.outs) if o.number in self.needed]
        names, which, two = {i: self.new("t") for i in alive}, self.of(r.which), r.which.dtype.kind == "b"
        cases = list(enumerate(zip(r.blocks, r.results, strict=True)))[:: -1 if two else 1]
        for i, name in names.items():
            self.line(f"{self.type_of(r.outs[i].dtype)} {name};")
        for place, (k, (block, results)) in enumerate(cases):
            asked = "" if place == len(cases) - 1 else f"if ({which}) " if two else f"if ({which} == {k}) "
            self.line(f"{'} else ' * (place > 0)}{asked}{{")
            self.block(block)
            for i, name in names.items():
                self.line(f"{name} = {self.of(results[i])};")
            self.leave()
        self.line("}")
        self.names |= {r.outs[i].number: name for i, name in names.items()}


def indented(lines) -> list:
    """The lines of a function's body, indented by two spaces per brace."""
    depth, found = 1, []
    for line in lines:
        depth -= line.startswith("}")
        found.append("  " * depth + line)
        depth += line.endswith("{")
    return found


def helpers(functions, prefix="") -> str:
    """The C functions that statements call: a writer's `functions`, with its prefix."""
    return "\n".join(_sincos(N, f"{prefix}sincos_{N}") for N in sorted(functions))


def _sincos(N, name):
    size, f = (4, "f") if N == "float" else (8, "")
    text = re.sub(r"LIBM\((\w+)\)", rf"\1{f}", filled(header("sincos.h"), size))
    return re.sub("SINCOS|REAL", lambda found: name if found[0] == "SINCOS" else N, text)


def _type(dtype) -> str:
    return "int" if np.dtype(dtype).kind == "b" else scalar(np.dtype(dtype))


_OF_BITS = {"add": "|", "max": "|", "mul": "&", "min": "&"}  # on booleans
_SIMPLE = {
    **{"square": "{0} * {0}", "is_finite": "isfinite({0}) != 0", "logistic": "1 / (1 + exp{f}(-{0}))"},
    **{"rsqrt": "1 / sqrt{f}({0})", "sqrt": "sqrt{f}({0})", "atan2": "atan2{f}({0}, {1})"},
}
_REAL = {
    **{"max": "({0} > {1} || {0} != {0} || ({0} == {1} && !signbit({0}))) ? {0} : {1}"},
    **{"min": "({0} < {1} || {0} != {0} || ({0} == {1} && signbit({0}))) ? {0} : {1}"},
    **{"abs": "fabs{f}({0})", "sign": "{0} > 0 ? 1 : {0} < 0 ? -1 : {0}", "rem": "fmod{f}({0}, {1})"},
}
_WHOLE = {
    **{"max": "{0} > {1} ? {0} : {1}", "min": "{0} < {1} ? {0} : {1}", "sign": "({0} > 0) - ({0} < 0)"},
    **{name: f"({{N}})((uint64_t){{0}} {BINARY[name]} {{1}})" for name in ("add", "sub", "mul")},  # they wrap
    **{"neg": "({N})(0 - (uint64_t){0})", "abs": "{0} < 0 ? ({N})(0 - (uint64_t){0}) : {0}"},
    "rem": "{1} == 0 ? {0} : {minus} ? 0 : {0} % {1}",
    "div": "{1} == 0 ? ({N})-1 : {minus} ? ({N})(0 - (uint64_t){0}) : {0} / {1}",
    "shift_left": "(uint64_t){1} < {bits} ? ({N})((uint64_t){0} << {1}) : 0",
    "shift_right_logical": "(uint64_t){1} < {bits} ? ({N})((uint{bits}_t){0} >> {1}) : 0",
    "shift_right_arithmetic": "({N})((int{bits}_t){0} >> ((uint64_t){1} < {bits} ? {1} : {bits} - 1))",
}


def _text(node, a) -> str:
    """An operation in C, given the texts of its arguments."""
    name, dtype = node.op, node.args[-1].dtype
    kind, bits = dtype.kind, 8 * dtype.itemsize
    words = {"f": "f" * (dtype == np.float32), "N": _type(dtype), "bits": bits}
    words["minus"] = f"{a[-1]} == -1" if kind == "i" else "0"
    if name == "convert_element_type":
        return _converted(a[0], node.args[0].dtype, node.dtype)
    if name == "select_n":
        return _selected(a, node.args[0].dtype.kind)
    if kind == "b" and name in _OF_BITS:
        return f"{a[0]} {_OF_BITS[name]} {a[1]}"
    if name in COMPARED or name in BITS or (name in BINARY and kind == "f"):
        return f"{a[0]} {(COMPARED | BITS | BINARY)[name]} {a[1]}"
    if name == "not" or (name == "neg" and kind == "f"):
        return f"{'-' if name == 'neg' else '!' if kind == 'b' else '~'}{a[0]}"
    if kind == "u" and name in ("abs", "sign"):
        return f"{a[0]}{' > 0' * (name == 'sign')}"
    if name == "round":
        return f"{'nearbyint' if node.params == 1 else 'round'}{words['f']}({a[0]})"
    form = (_REAL if kind == "f" else _WHOLE).get(name) or _SIMPLE.get(name)
    if form is not None:
        return form.format(*a, **words)
    if name not in LIBRARY:
        raise UnsupportedError(f"the operation `{name}` has no C form")
    return f"{name}{'f' * (node.dtype == np.float32)}({', '.join(a)})"


def _selected(a, kind):
    if kind == "b":
        return f"{a[0]} ? {a[2]} : {a[1]}"
    return " : ".join([*(f"{a[0]} == {k} ? {x}" for k, x in enumerate(a[1:-1])), a[-1]])


def _converted(x, old, new):
    N = _type(new)
    if new.kind == "b":
        return f"{x} != 0"
    if old.kind != "f" or new.kind == "f":
        return f"({N}){x}"
    about = np.iinfo(new)
    low, top = (number(old.type(v), old) for v in (about.min, 2.0 ** (about.bits - (new.kind == "i"))))
    inside = f"{x} <= {low} ? {number(about.min, new)} : {x} >= {top} ? {number(about.max, new)} : ({N}){x}"
    return f"{x} != {x} ? 0 : {inside}"
