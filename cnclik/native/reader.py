"""Reader: a traced function of one lane becomes a `Graph`.

Every array is a NumPy array of nodes, so that moving data about costs nothing; loops whose bodies are the same in each
round stay loops, other ones are written out.
"""

import functools
from collections import Counter

import jax
import numpy as np

from cnclik.engine.cells import CALLS, array_of, called, consts_and_carry, each, moved, walk
from cnclik.native.arrays import ARRAYS, UnsupportedError, kind_of
from cnclik.native.graph import BOOL, INT, REAL, Function, Graph

LARGE = 200  # equations from which on what is called several times becomes a function
WRITTEN_OUT = 64  # rounds of a loop that may be written out where it can't stay one


_SAME = """
    add sub mul div neg abs sqrt sin cos atan2 max min lt le gt ge eq ne and or xor is_finite floor ceil exp exp2 expm1
    log log1p tan asin acos atan sinh cosh tanh asinh acosh atanh cbrt erf pow rem nextafter
"""
_ELEMENTWISE = {name: name for name in _SAME.split()} | {"add_any": "add", "lt_to": "lt", "le_to": "le"}


class Reader:
    """Reads jaxprs into a graph."""

    def __init__(self, graph: Graph, repeated=None):
        """repeated: {id of a jaxpr: None, or the `Function` made of it} of what is to be called, see `repeats`."""
        self.graph, self.repeated = graph, {} if repeated is None else repeated

    def constant(self, value, aval=None):
        """An array of known nodes."""
        value = np.asarray(value)
        kind = kind_of(value if aval is None else aval)
        return array_of([self.graph.const(v, kind) for v in value.ravel().tolist()], value.shape)

    def run(self, jaxpr, consts, values) -> list:
        """Results of an open jaxpr, from arrays of nodes."""
        consts = [self.constant(c) for c in consts]
        return walk(jaxpr, consts, values, lambda v: self.constant(v.val, v.aval), self.equation)

    def equation(self, equation, inputs) -> list:
        """Results of one equation."""
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            return self._call(params, inputs)
        if (found := moved(equation, inputs)) is not None:
            return found
        if name in _ELEMENTWISE:
            return [each(functools.partial(self.graph.apply, _ELEMENTWISE[name]), *inputs)]
        if name in ARRAYS:
            return ARRAYS[name](self, equation, *inputs)
        special = getattr(self, "_" + name.replace("-", "_"), None)
        if special is None:
            raise UnsupportedError(f"the operation `{name}` has no C form")
        return special(equation, *inputs)

    def _call(self, params, inputs):
        jaxpr, consts = called(params)
        if getattr(getattr(jaxpr, "debug_info", None), "func_name", None) == "sincos":  # of `robot.trig`
            return [each(functools.partial(self.graph.apply, op), x) for op in ("sin", "cos") for x in inputs]
        if id(jaxpr) in self.repeated:
            return self._function(jaxpr, consts, inputs)
        return self.run(jaxpr, consts, inputs)

    def _function(self, jaxpr, consts, inputs):
        """A call of what is called several times."""
        ins, outs = ([v.aval for v in some] for some in (jaxpr.invars, jaxpr.outvars))
        made = self.repeated[id(jaxpr)]
        if made is None:
            made = self.repeated[id(jaxpr)] = Function(Graph(self.graph.dtype))
            cells = [made.graph.input("a", i, REAL) for i in range(sum(a.size for a in ins))]
            inside = Reader(made.graph, self.repeated)
            made.results = _flat(inside.run(jaxpr, consts, _unflat(cells, ins)))
        return _unflat(self.graph.call(made, _flat(inputs)), outs)

    # --- elementwise ----------------------------------------------------------------------------------

    def _not(self, equation, x):
        return [each(functools.partial(self.graph.apply, "not"), x)]

    def _select_n(self, equation, which, *cases):
        def choose(which, first, *others):
            for i, other in enumerate(others, 1):
                here = which if which.kind == BOOL else self.graph.apply("eq", which, self.graph.const(i, INT))
                first = self.graph.apply("select", here, other, first)
            return first

        return [each(choose, which, *cases)]

    def _convert_element_type(self, equation, x):
        kind, old = kind_of(equation.outvars[0].aval), kind_of(equation.invars[0].aval)
        if kind == old:
            return [x]
        g = self.graph
        if kind == BOOL:
            return [each(lambda v: g.apply("ne", v, g.const(0, old)), x)]
        op = "to_real" if kind == REAL else "to_int" if old == REAL else "bool_to_int"
        return [each(functools.partial(g.apply, op), x)]

    def _round(self, equation, x):
        even = int(equation.params["rounding_method"]) == 1
        return [each(functools.partial(self.graph.apply, "round_even" if even else "round_away"), x)]

    def _integer_pow(self, equation, x):
        y = equation.params["y"]
        return [each(lambda v: self._power(v, y), x)]

    def _power(self, v, y):
        g = self.graph
        if y < 0:
            return g.apply("div", g.const(1, v.kind), self._power(v, -y))
        out = None
        while y:  # as XLA does: by squaring
            if y & 1:
                out = v if out is None else g.apply("mul", out, v)
            y >>= 1
            v = g.apply("mul", v, v) if y else v
        return g.const(1, v.kind) if out is None else out

    def _square(self, equation, x):
        return [each(lambda v: self.graph.apply("mul", v, v), x)]

    def _rsqrt(self, equation, x):
        g = self.graph
        return [each(lambda v: g.apply("div", g.const(1, REAL), g.apply("sqrt", v)), x)]

    def _logistic(self, equation, x):
        g, one = self.graph, self.graph.const(1, REAL)
        down = functools.partial(g.apply, "neg")
        return [each(lambda v: g.apply("div", one, g.apply("add", one, g.apply("exp", down(v)))), x)]

    def _sign(self, equation, x):
        g = self.graph

        def sign(v):
            zero, one, less = (g.const(c, v.kind) for c in (0, 1, -1))
            down = g.apply("select", g.apply("lt", v, zero), less, v)
            return g.apply("select", g.apply("lt", zero, v), one, down)

        return [each(sign, x)]

    def _clamp(self, equation, low, x, high):
        g = self.graph
        return [each(lambda l, v, h: g.apply("min", g.apply("max", l, v), h), low, x, high)]

    # --- control flow ---------------------------------------------------------------------------------

    def _cond(self, equation, index, *inputs):
        branches = equation.params["branches"]
        (which,) = index.flat
        if which.known:
            return self._branch(branches[min(max(int(which.value), 0), len(branches) - 1)], inputs)
        if len(branches) == 2 and which.kind == INT:
            which = self.graph.apply("lt", self.graph.const(0, INT), which)
        elif len(branches) != 2:
            which = self.graph.apply("min", self.graph.apply("max", which, self.graph.const(0, INT)),
                                     self.graph.const(len(branches) - 1, INT))  # fmt: skip
        avals = [v.aval for v in equation.outvars]
        made = [lambda b=b: _flat(self._branch(b, inputs)) for b in branches]
        return _unflat(self.graph.choose(which, made, _kinds(avals)), avals)

    def _branch(self, closed, inputs):
        return self.run(closed.jaxpr, closed.consts, inputs)

    def _while(self, equation, *inputs):
        """A loop that runs once or not at all, as the library has them: an `if`."""
        params, g = equation.params, self.graph
        cond, body, ahead = params["cond_jaxpr"], params["body_jaxpr"], params["cond_nconsts"]
        of_cond, of_body, state = inputs[:ahead], inputs[ahead:][: params["body_nconsts"]], None
        state = inputs[ahead + params["body_nconsts"] :]
        (asked,) = self.run(cond.jaxpr, cond.consts, [*of_cond, *state])
        (begins,) = asked.flat
        avals = [v.aval for v in equation.outvars]
        if begins.known and not begins.value:
            return list(state)

        def once():
            made = self.run(body.jaxpr, body.consts, [*of_body, *state])
            (again,) = self.run(cond.jaxpr, cond.consts, [*of_cond, *made])
            if not again.flat[0].known or again.flat[0].value:
                raise UnsupportedError("a `while` loop without a bound that is known has no C form")
            return _flat(made)

        return _unflat(g.choose(begins, [lambda: _flat(state), once], _kinds(avals)), avals)

    def _scan(self, equation, *inputs):
        params = equation.params
        jaxpr, length, back = params["jaxpr"], params["length"], params["reverse"]
        nc, nk = consts_and_carry(equation, jaxpr)
        consts, first, xs = inputs[:nc], list(inputs[nc : nc + nk]), inputs[nc + nk :]
        avals = [v.aval for v in equation.outvars]
        stacked = avals[nk:]
        counters = [_counter(x) for x in xs]
        if length <= 1 or any(a.size for a in stacked) or None in counters:
            return self._written_out(jaxpr, length, back, consts, first, xs, stacked)

        def body(index, cells):
            g = self.graph
            if back:
                index = g.apply("sub", g.const(length - 1, INT), index)
            rows = [array_of([self._counted(index, *c, x.flat[0].kind)], ()) for c, x in zip(counters, xs, strict=True)]
            made = self.run(jaxpr.jaxpr, jaxpr.consts, [*consts, *_unflat(cells, avals[:nk]), *rows])
            return _flat(made[:nk])

        ended = self.graph.loop(length, _flat(first), body, kinds=_kinds(avals[:nk]))
        return _unflat(ended, avals[:nk])

    def _counted(self, index, first, gap, kind):
        g = self.graph
        number = g.apply("add", g.const(first, INT), g.apply("mul", g.const(gap, INT), index))
        return g.apply("to_real", number) if kind == REAL else number

    def _written_out(self, jaxpr, length, back, consts, carry, xs, stacked):
        if length > WRITTEN_OUT:
            raise UnsupportedError(f"a `scan` of {length} rounds over arrays has no C form; {WRITTEN_OUT} have")
        rounds = [None] * length
        for i in reversed(range(length)) if back else range(length):
            made = self.run(jaxpr.jaxpr, jaxpr.consts, [*consts, *carry, *(x[i] for x in xs)])
            carry, rounds[i] = made[: len(carry)], made[len(carry) :]
        if not length:
            return [*carry, *(array_of([], a.shape) for a in stacked)]
        return [*carry, *map(np.stack, zip(*rounds, strict=True))]


def repeats(jaxpr) -> dict:
    """{id: None} of the calls inside that are large, made more than once, and of real numbers alone."""
    seen = Counter()

    def count(jaxpr):
        """Equations of a jaxpr, those inside among them."""
        total = 0
        for equation in jaxpr.eqns:
            inner = [v for v in jax.tree.leaves(list(equation.params.values()), is_leaf=_is_jaxpr) if _is_jaxpr(v)]
            inner = [getattr(v, "jaxpr", v) for v in inner]
            sizes = [known.get(id(v)) or known.setdefault(id(v), count(v)) for v in inner]
            total += 1 + sum(sizes)
            if equation.primitive.name in ("jit", "pjit"):
                (of,), (size,) = inner, sizes
                real = all(v.aval.dtype.kind == "f" for v in (*of.invars, *of.outvars))
                seen[id(of)] += size >= LARGE and real
        return total

    known = {}
    count(jaxpr)
    return {key: None for key, times in seen.items() if times > 1}


def _is_jaxpr(value) -> bool:
    return hasattr(value, "eqns") or hasattr(value, "jaxpr")


def _flat(values):
    return [cell for value in values for cell in value.flat]


def _kinds(avals):
    return [kind_of(a) for a in avals for _ in range(a.size)]


def _unflat(cells, avals):
    cells = iter(cells)
    return [array_of([next(cells) for _ in range(a.size)], a.shape) for a in avals]


def _counter(x):
    """(first, gap) of whole numbers with equal gaps, over which a loop counts; None of any others."""
    if x.ndim != 1 or not x.size or not all(cell.known for cell in x.flat):
        return None
    values = [float(cell.value) for cell in x.flat]
    gap = values[1] - values[0] if len(values) > 1 else 0.0
    even = all(v == values[0] + gap * i for i, v in enumerate(values)) and values[0].is_integer() and gap.is_integer()
    return (int(values[0]), int(gap)) if even else None
