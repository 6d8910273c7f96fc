"""To C: a graph as the statements of a C function on vectors of lanes.

A scalar becomes a vector of lanes, a comparison a mask. Loops stay loops. A branch runs if some lane needs it, and each
lane keeps its own values. Stacked outputs of scans lie in the caller's work memory, lane by lane; if a result is what
one scan stacks, each round stores its part directly.
"""

import numpy as np

from cnclik.engine.graph import Cond, Node, Scan, While, live
from cnclik.engine.operations import COST, NAMES, number, text, vector
from cnclik.engine.pieces import in_pieces, read_for
from cnclik.engine.row_texts import (
    RowTexts,
    cells_of,
    in_argument,
    needed_rows,
    place_in,
    places_needed,
    whole_results,
)
from cnclik.engine.stacks import Rows

HEAVY = 60  # operations, at least, of a branch that is skipped if no lane needs it
REGION_WEIGHT = 1000


def weight(block, needed) -> int:
    """The cost of what is needed of a block, in operations."""
    several = (i for i in block.items if i.number in needed)
    return sum(COST.get(i.op, 1) if isinstance(i, Node) else REGION_WEIGHT for i in several)


class Writer(RowTexts):
    """Writes the statements of a graph."""

    prefix = ""
    beside = 4  # entries stored at once
    piece = 0  # statements of one function; 0: all in one
    type_of = staticmethod(vector)  # C type of numbers of a dtype

    def __init__(self, graph, given, outs, main, reads, writes):
        """Args:
        given: input nodes. outs: results: cells, rows or nodes.
        main: the type that sets the number of lanes of a vector.
        reads: per input, a function from an index to the text of that entry. writes: per result, a function that
          returns the statement storing texts at an index.
        """
        self.graph, self.given, self.outs, self.main = graph, given, outs, main
        self.reads, self.writes = reads, writes
        self.lines, self.names, self.scopes, self.active = [], {}, [[]], []
        self.kept: dict = {}  # {number of a node: its place in the work memory, for all pieces}
        self.tables, self.parts, self.functions = [], [], set()
        self.where, self.counted, self.operations = {}, 0, 0
        self.work = 0  # bytes of the work memory
        ends = [node for out in outs for node in cells_of(out)]
        self.used, self.needed = live(ends)
        self.direct = whole_results(outs)
        others = [node for k, out in enumerate(outs) if k not in self.direct for node in cells_of(out)]
        self.stored = needed_rows(graph, self.needed, others)
        self.material = places_needed(graph, self.needed)

    # --- text -----------------------------------------------------------------------------------------

    def line(self, words):
        self.lines.append(words)

    def new(self, letter="t") -> str:
        """An unused name."""
        self.counted += 1
        return f"{letter}{self.counted}"

    def of(self, node, plain=False) -> str:
        """A node in an expression; a plain constant as a number."""
        if node.known:
            words = number(node.value, node.dtype)
            return f"({words})" if plain else self.splat(node.dtype, words)
        if node.number not in self.names:  # load once: compilers search all earlier stores for each load
            self.names[node.number] = self.variable(node, self.kept[node.number], "t")
            self.scopes[-1].append(node.number)
        return self.names[node.number]

    def splat(self, dtype, words) -> str:
        """A number that is the same in all lanes."""
        return f"splat_{vector(dtype)}({words})"

    def declare(self, node, words) -> str:
        """Declares a constant of the node's type."""
        self.operations += 1
        self.counted += 1
        name = self.names[node.number] = f"t{self.counted}"
        self.lines.append(f"const {self.type_of(node.dtype)} {name} = {words};")
        return name

    def variable(self, node, words, letter="c") -> str:
        name = self.new(letter)
        self.line(f"{self.type_of(node.dtype)} {name} = {words};")
        return name

    def room(self, dtype, entries, length=1) -> str:
        """An array of `entries` · length vectors in the work memory."""
        size = self.vector_bytes(dtype)
        place = -(-self.work // size) * size
        self.work = place + entries * size * length
        return f"AT({vector(dtype)}, {place})"

    def vector_bytes(self, dtype) -> int:
        """Bytes of a vector with as many lanes as AVX-512 has, the largest."""
        dtype = np.dtype(dtype)
        return 64 * max(1, (self.main.itemsize if dtype.kind == "b" else dtype.itemsize) // self.main.itemsize)

    def applied(self, node, of) -> str:
        """An operation; the C library functions it uses are noted."""
        if node.op in ("sin", "cos"):
            return self.sincos(node, of)
        self.functions.add((node.op, vector(node.args[0].dtype), getattr(node, "params", None)))
        return text(node, of)

    def sincos(self, node, of) -> str:
        """The name of a sine or cosine; both of an angle are computed at once."""
        angle = of(node.args[0], False)
        key = "sincos", angle
        if key not in self.names:
            s, c, T = self.new(), self.new(), self.type_of(node.dtype)
            self.line(f"{T} {s}, {c};")
            self.line(f"{self.prefix}sincos_{T}({angle}, &{s}, &{c});")
            self.names[key] = s, c
            self.scopes[-1].append(key)
        return self.names[key][node.op == "cos"]

    # --- statements -----------------------------------------------------------------------------------

    def is_needed(self, item) -> bool:
        return item.number in self.needed

    def block(self, block, ending=()):
        """Writes a block. `ending` are the nodes that are used after it. `leave` must follow."""
        self.scopes.append([])
        items = [i for i in block.items if i.number in self.needed]
        items = [i for i in items if not (isinstance(i, Node) and i.shape and i.number not in self.material)]
        if self.piece and len(items) > 1.5 * self.piece:
            in_pieces(self, items, ending)
        else:
            writes = self.by_kind
            for item in items:
                writes[type(item)](item)

    @property
    def by_kind(self) -> dict:
        """What writes an item of a block."""
        return {Node: self.node, Scan: self.scan, While: self.loop, Cond: self.choice}

    def leave(self):
        """Ends a block: its values go out of scope."""
        for key in self.scopes.pop():
            self.names.pop(key, None)

    def node(self, n):
        if n.number in self.material:
            self.materialise(n)
        elif n.number in self.names:
            return
        elif n.op in NAMES:
            words = self.applied(n, self.of)
            if n.op in ("sin", "cos"):
                self.names[n.number] = words
                self.operations += 1
            else:
                self.declare(n, words)
        elif n.op in ("index", "pick", "take"):
            getattr(self, n.op)(n)

    def index(self, n):
        """One entry of an argument, or of a row."""
        (whole,) = n.args
        if whole.op == "input":
            at = int(np.ravel_multi_index(n.params, whole.shape))
            self.declare(n, self.load(whole, str(at)))
        else:
            self.names[n.number] = self.row(whole, str(n.params[0]), {})

    def load(self, node, at) -> str:
        return self.reads[self.given.index(node)](at)

    def pick(self, n):
        """A cell whose index differs from lane to lane."""
        index, *cells = n.args
        which, name = f"{self.of(index)}[i]", self.new()
        self.names[n.number] = name
        at = f"{self.listed(cells)}[{which}]"
        self.line(f"{self.type_of(n.dtype)} {name};")
        self.line(f"for (int i = 0; i < W; ++i) {name}[i] = {at}[i];")

    def take(self, n):
        """A row's entry at a round that differs from lane to lane."""
        row, index = n.args
        name = self.names[n.number] = self.new()
        self.line(f"{self.type_of(n.dtype)} {name};")
        which = f"{self.of(index)}[i]"
        if in_argument(row):
            at = self.reads[self.given.index(row.args[0])](place_in(row, f"(int64_t){which}"), alone=True)
        else:
            at = f"{self.row(row, which, {})}[i]"
        self.line(f"for (int i = 0; i < W; ++i) {name}[i] = {at};")

    # --- regions --------------------------------------------------------------------------------------

    def scan(self, r):
        nk = len(r.carries)
        alive = [i for i, c in enumerate(r.carries) if {c.number, r.outs[i].number} & self.needed]
        rows = [i for i, row in enumerate(r.rows) if row.number in self.needed]
        stacked = [
            (y, node) for y, node in zip((r.ys[s] for s in r.stacks), r.outs[nk:], strict=True) if self.is_needed(node)
        ]
        j = self.new("j")
        k = f"({r.length - 1} - {j})" if r.reverse else j
        stores = self.make_room(r, stacked, k)
        direct = [(o, *about[1:]) for o, about in self.direct.items() if about[0] is r]
        names = {i: self.variable(r.carries[i], self.of(r.first[i])) for i in alive}
        self.names |= {r.carries[i].number: name for i, name in names.items()}
        self.line(f"for (int64_t {j} = 0; {j} < {r.length}; ++{j}) {{")
        self.scopes.append([])
        memo = {}
        for i in rows:
            if r.rows[i].shape:
                self.where[r.rows[i].number] = lambda o, x=r.xs[i]: self.where[x.number](k, o)
            else:
                self.names[r.rows[i].number] = self.row(r.xs[i], k, memo)
        ends = [r.then[i] for i in alive] + [y for y, _ in stores]
        self.block(r.block, ends + [y for _, _, _, ys in direct for y in ys])
        for y, node in stores:
            self.line(f"{self.where[node.number](k)} = {self.of(y)};")
        for o, start, length, ys in direct:
            words = list(map(self.of, ys))
            if length < r.length:
                self.line(f"if ({k} >= {start} && {k} < {start + length}) {{")
            self.store(o, words, f"({k} - ({start})) * {len(ys)} + ")
            if length < r.length:
                self.line("}")
        self.move_on(r, names)
        self.line("}")
        self.leave()
        self.leave()
        self.names |= {r.outs[i].number: name for i, name in names.items()}

    def make_room(self, r, stacked, k) -> list:
        """Reserves work memory for stacked outputs. Returns (y, node) of those stored as a round ends."""
        stores, groups = [], {}
        for y, node in stacked:
            if len(node.shape) == 2 and node.number in self.stored:  # an inner loop stores into it
                array = self.room(node.dtype, node.shape[1], node.shape[0])
                self.where[node.number] = lambda o, i, a=array, s=node.shape[1]: f"{a}[({o}) * {s} + ({i})]"
                self.where[y.number] = lambda i, node=node: self.where[node.number](k, i)
            elif node.number in self.where:
                stores.append((y, node))
            elif node.number in self.stored:
                groups.setdefault(node.dtype, []).append((y, node))
        for dtype, some in groups.items():
            array = self.room(dtype, len(some), r.length)
            for i, (y, node) in enumerate(some):
                self.where[node.number] = lambda k, a=array, m=len(some), i=i: f"{a}[({k}) * {m} + {i}]"
                stores.append((y, node))
        return stores

    def move_on(self, r, names, mask=None):
        """Updates the carries of active lanes; a carry that another one reads is copied first."""
        carried = {r.carries[i].number for i in names}
        texts = {}
        for i, name in names.items():
            then = r.then[i]
            if then is r.carries[i]:
                continue
            texts[name] = self.variable(then, self.of(then), "t") if then.number in carried else self.of(then)
        for i, name in names.items():
            if name in texts:
                words = texts[name]
                words = words if mask is None else f"select_{self.type_of(r.carries[i].dtype)}({mask}, {words}, {name})"
                self.line(f"{name} = {words};")

    def loop(self, r):
        names = [self.variable(c, self.of(f)) for c, f in zip(r.carries, r.first, strict=True)]
        self.names |= {c.number: name for c, name in zip(r.carries, names, strict=True)}
        self.line("for (;;) {")
        self.block(r.asking, [r.begins])
        self.rounds(r, dict(enumerate(names)))
        self.line("}")
        self.leave()
        self.leave()
        self.names |= {o.number: name for o, name in zip(r.outs, names, strict=True)}
        for o in r.outs:
            if not self.is_needed(o):  # else compilers warn of a variable that is set but not used
                self.line(f"(void){self.names[o.number]};")

    def rounds(self, r, names):
        """The inside of a loop: it runs while some lane is active."""
        asked, among = self.new(), f" & {self.active[-1]}" if self.active else ""
        self.line(f"const M {asked} = {self.of(r.begins)}{among};")
        self.line(f"if (!ANY({asked})) break;")
        self.active.append(asked)
        self.block(r.block, r.then)
        self.active.pop()
        self.move_on(r, names, asked)

    def choice(self, r):
        alive, which, names = [i for i, o in enumerate(r.outs) if o.number in self.needed], self.new(), {}
        self.line(f"const {self.type_of(r.which.dtype)} {which} = {self.of(r.which)};")
        given = next((k for k, b in enumerate(r.blocks) if not any(map(self.is_needed, b.items))), None)
        for i in alive:
            at_first = self.splat(r.outs[i].dtype, "0") if given is None else self.of(r.results[given][i])
            names[i] = self.variable(r.outs[i], at_first, "t")
        for k in sorted({*range(len(r.blocks))} - {given}):  # the given case needs no computation
            block, results, mask = r.blocks[k], r.results[k], self.new()
            truth = (f"~{which}", which)[k] if r.which.dtype.kind == "b" else f"MASK({which} == {k})"
            among = f" & {self.active[-1]}" if self.active else ""
            self.line(f"const M {mask} = {truth}{among};")
            self.line(f"if (ANY({mask})) {{" if weight(block, self.needed) >= HEAVY else "{")
            self.active.append(mask)
            self.block(block, [results[i] for i in alive])
            for i in alive:
                pick, result = f"select_{self.type_of(r.outs[i].dtype)}", self.of(results[i])
                self.line(f"{names[i]} = {pick}({mask}, {result}, {names[i]});")
            self.active.pop()
            self.line("}")
            self.leave()
        self.names |= {r.outs[i].number: name for i, name in names.items()}

    # --- results --------------------------------------------------------------------------------------

    def statements(self) -> list:
        """All lines of the function."""
        for node in self.given:
            if node.number in self.needed and not node.shape:
                self.declare(node, self.load(node, "0"))
        self.block(self.graph.root, [n for out in self.outs for c in cells_of(out) for n in read_for(c)])
        for o, out in enumerate(self.outs):
            if o in self.direct:
                continue
            if isinstance(out, Rows):
                self.line(f"for (int64_t k = 0; k < {out.length}; ++k) {{")
                self.scopes.append([])
                memo = {}
                self.store(o, [self.row(c, "k", memo) for c in out.cells.flat], f"k * {out.cells.size} + ")
                self.line("}")
                self.leave()
            else:
                self.store(o, list(map(self.of, cells_of(out))))
        self.leave()
        return self.lines

    def store(self, o, texts, offset=""):
        """Writes entries of a result, four at once if there are as many; some may be stored twice."""
        several = self.beside <= len(texts) and cells_of(self.outs[o])[0].dtype.kind != "b"
        at, some = 0, self.beside if several else 1
        while at < len(texts):
            at = min(at, len(texts) - some)
            self.line(self.writes[o](f"{offset}{at}", *texts[at : at + some]))
            at += some
