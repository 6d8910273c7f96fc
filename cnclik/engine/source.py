"""Source: the whole C file of a graph: types, functions on lanes, the tile, and the entries that run it."""

import re

import numpy as np

from cnclik.engine.graph import Node
from cnclik.engine.operations import LIBRARY, TYPES, header, scalar, vector
from cnclik.engine.row_texts import all_items
from cnclik.engine.sines import filled
from cnclik.engine.to_c import Writer

LONG = 20_000  # nodes; longer programs are written in pieces
PIECE = 1_000  # from 1,000 to 5,000 the speed differs by about 10 %, and compile time grows by up to a half
_TILE = "int64_t first, int64_t n, const void *const *in, const int64_t *stride, void *const *out, char *restrict work"
_REAL = {"float32": ("S32", "int32_t", "f"), "float64": ("S64", "int64_t", "")}


def main_type(graph, given, shapes) -> np.dtype:
    """The type that sets the number of lanes of a vector: float64 if most numbers are float64, otherwise float32."""
    several = [n.dtype for n in all_items(graph.root) if isinstance(n, Node)]
    several += [np.dtype(x.dtype) for x in (*given, *shapes)]
    wide, narrow = (several.count(np.dtype(t)) for t in (np.float64, np.float32))
    return np.dtype(np.float64 if wide > narrow else np.float32)


def write(graph, given, outs, shapes) -> tuple:
    """(C text, number of operations) of a graph; `shapes` are the results' avals."""
    main = main_type(graph, given, shapes)
    reads = [lane(n.dtype, f"(const {scalar(n.dtype)} *)in[{i}]", f"stride[{i}]") for i, n in enumerate(given)]
    writes = [
        entry(np.dtype(s.dtype), f"({scalar(np.dtype(s.dtype))} *)out[{o}]", s.size) for o, s in enumerate(shapes)
    ]
    writer = Writer(graph, given, outs, main, reads, writes)
    writer.piece = PIECE if len(writer.needed) > LONG else 0
    writer.statements()
    text = [f"#define MAIN {main.itemsize}", header("vectors.h"), *_types(writer, main)]
    text += [f"#define WORK ((int64_t){writer.work} / 64 * BYTES)", *writer.tables, *(body for _, body in writer.parts)]
    text += [
        f"static void tile({_TILE})",
        "{",
        *writer.lines,
        "}",
        *_call(given, shapes),
        header("calls.h"),
        header("handler.h"),
    ]
    return "\n".join(text) + "\n", writer.operations


def lane(dtype, data, stride):
    """A function that writes loads of entries of lanes from `first` on, or of lane i alone; lanes are `stride` numbers
    apart."""

    def load(at, alone=False):
        if alone:
            return f"({data})[(first + (i < n ? i : n - 1)) * {stride} + ({at})]"
        return f"load_{vector(dtype)}({data} + first * {stride} + ({at}), {stride}, n)"

    return load


def entry(dtype, data, size):
    """A function that writes stores of entries of lanes from `first` on, each lane with `size` numbers."""

    def store(at, *words):
        name = f"four_{vector(dtype)}" if len(words) > 1 else vector(dtype)
        return f"store_{name}({data} + first * {size} + {at}, {size}, {', '.join(words)}, n);"

    return store


def _types(writer, main):
    used = {dtype.name for dtype in {main, *(n.dtype for n in writer.used)}} - {"bool"}
    for name in TYPES:
        if name not in used:
            continue
        T, N = TYPES[name]
        dtype, real = np.dtype(name), name in _REAL
        bits, number, suffix = _REAL[name] if real else (f"S{8 * dtype.itemsize}", "", "")
        defined = {"T": T, "N": N, "K(name)": f"name##_{T}", "BITS": bits, "SIZE": dtype.itemsize}
        defined |= {"LIBM(name)": f"name##{suffix}" if suffix else "name", "BITS_NUMBER": number}
        defined |= {"SIGNED": int(dtype.kind == "i")}
        yield from (f"#define {key} {value}" for key, value in defined.items())
        yield header("numbers.h")
        yield filled(header("real.h"), dtype.itemsize) if real else header("whole.h")
        if real:
            yield from _library(writer, T)
        yield from (f"#undef {key.split('(')[0]}" for key in defined)
        if real:
            yield from (f"#undef {key}" for key in sorted(set(re.findall(r"#define (\w+)", header("real.h")))))


def _library(writer, T):
    """Lane-by-lane versions of the C library functions in use."""
    asked = {op for op, of, _ in writer.functions if of == T}
    asked |= {"exp"} if "logistic" in asked else set()
    asked |= {"fmod"} if "rem" in asked else set()
    for name in sorted(asked & set(LIBRARY)):
        each, of = ("EACH", "x[i]") if LIBRARY[name] == 1 else ("EACH_OF_TWO", "x[i], y[i]")
        yield f"{each}({name}, LIBM({name})({of}))"


def _call(given, shapes):
    """Tables that the entries for numbers and for XLA read."""
    ins = [(len(n.shape), int(np.prod(n.shape))) for n in given]

    def table(name, values):
        return f"static const int64_t {name}[] = {{{', '.join(map(str, values)) or '0'}}};"

    yield f"#define ARGUMENTS {len(ins)}\n#define RESULTS {len(shapes)}"
    yield table("argument_rank", [r for r, _ in ins])
    yield table("argument_size", [s for _, s in ins])
    yield table("result_rank", [s.ndim for s in shapes])
    yield table("argument_bytes", [n.dtype.itemsize * size for n, (_, size) in zip(given, ins, strict=True)])
    yield table("result_bytes", [s.dtype.itemsize * s.size for s in shapes])
