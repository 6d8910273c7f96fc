"""Source: a program's header and source in C99."""

import textwrap

import numpy as np

from cnclik.integrate.status import Status
from cnclik.native.graph import INT, functions
from cnclik.native.scalar import Writer, number
from cnclik.reaching.result import ReachStatus
from cnclik.robot.trig import RANGE, TABLES
from cnclik.version import __version__

GROUPS = ("parameters", "input", "history")
REACHED = tuple(ReachStatus[name] for name in ("SOLVED", "OUT_OF_REACH", "OUT_OF_BUDGET", "NON_FINITE"))


PREFIX = "clik_"  # of all names that others see: so none is a keyword, a macro, or a function of a library


class Names:
    """How things are called in the C of one export."""

    def __init__(self, name, dtype, what):
        name = PREFIX + name.removeprefix(PREFIX)
        self.name, self.dtype, self.what = name, np.dtype(dtype), what
        self.real = "float" if self.dtype.itemsize == 4 else "double"
        self.suffix = "f" * (self.dtype.itemsize == 4)
        self.entry = f"{name}_step" if what == "solve" else name  # one call
        self.statuses = {"step": Status, "solve": Status, "reach": REACHED}.get(what, ())

    def type(self, group) -> str:
        return f"{self.name}_{group}"

    def place(self, group, field) -> tuple:
        """(C expression of a field, whether it is an array)."""
        return f"{group}->{field.name}", bool(field.shape)


def comment(text) -> str:
    """A block comment, whatever a robot's joints are called."""
    text = "".join(c if " " <= c <= "~" or c == "\n" else "?" for c in text)
    for mark in ("*/", "/*", "??"):  # comments that end or begin, trigraphs
        text = text.replace(mark, f"{mark[0]} {mark[1]}")
    lines = [line for part in text.strip().split("\n") for line in (textwrap.wrap(part, 110) or [""])]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"]) + "\n"


def header(program, names, told, more="") -> str:
    """The header: types, the status bits, and what can be called.

    Args:
      told: the configuration in words, line by line.
      more: what else can be called.
    """
    guard = f"{names.name.upper()}_H"
    groups = {g: fields for g, fields in program.inputs.items() if fields}
    groups["output"] = [field for field, _ in program.outputs["output"]]
    types = "\n".join(struct(names, group, fields) for group, fields in groups.items())
    bits = ""
    if names.statuses:
        inside = ",\n".join(f"  {names.name.upper()}_{s.name} = {int(s)}" for s in names.statuses)
        bits = f"/* {'Bits of the' if names.statuses is Status else 'The'} status. */\nenum {{\n{inside}\n}};\n\n"
    calls = [f"{signature(program, names)};"]
    about = "One call; returns the status." if bits else "One call."
    if program.inputs["history"]:
        about += " Fill `history` with zeros to start: it is read and written."
    if program.inputs["parameters"]:
        calls.insert(0, f"/* The parameters as they were exported. */\n{defaults_signature(names)};\n")
    calls[-1] = f"/* {about} */\n{calls[-1]}"
    return (
        comment("\n".join([f"{names.name}: written by cnclik {__version__}. Do not edit: export again.", "", *told]))
        + f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n\n"
        + '#ifdef __cplusplus\nextern "C" {\n#endif\n\n'
        + f"{bits}{types}\n"
        + "\n".join([*calls, *["\n" + more] * bool(more)])
        + "\n\n#ifdef __cplusplus\n}\n#endif\n\n#endif\n"
    )


def struct(names, group, fields) -> str:
    lines = []
    for f in fields:
        size = f"[{f.size}]" if f.shape else ""
        lines.append(f"  {_type(names, f)} {f.name}{size};" + (f" /* {f.about} */" if f.about else ""))
    return "typedef struct {\n" + "\n".join(lines) + f"\n}} {names.type(group)};\n"


def _type(names, field) -> str:
    return "int32_t" if field.kind == INT else names.real


def arguments(program, names, ending=("output",)) -> str:
    """The parameters of the C function."""
    given = [g for g in GROUPS if program.inputs[g]]
    const = {"parameters": "const ", "input": "const "}
    return ", ".join(f"{const.get(g, '')}{names.type(g)} *{g}" for g in (*given, *ending))


def signature(program, names) -> str:
    """The C function's own line."""
    returns = "int32_t" if names.statuses else "void"
    return f"{returns} {names.entry}({arguments(program, names)})"


def defaults_signature(names) -> str:
    return f"void {names.name}_defaults({names.type('parameters')} *parameters)"


def source(program, names, more="", inside=None) -> str:
    """The whole source file; `more` stands at its end. `inside`: another text for the function, and what it uses."""
    function, used = inside or body(program, names)
    parts = [
        f"/* Written by cnclik {__version__}; see {names.name}.h. */\n",
        f'#include "{names.name}.h"\n\n#include <math.h>\n' + "#include <string.h>\n" * bool(inside),
        *helpers(names, used),
    ]
    if program.inputs["parameters"]:
        parts.append(_defaults(program, names))
    return "\n".join([*parts, function, *[more] * bool(more)])


def places(program, names) -> dict:
    """{argument: (its place in C, whether that is an array)}."""
    return {f"{g}.{f.name}": names.place(g, f) for g, fields in program.inputs.items() for f in fields}


def body(program, names, line=""):
    """The function's text, and the operations in it. `line`: its own line, where it isn't the exported one."""
    given = [g for g in program.inputs if program.inputs[g]]
    called = {f: f"{names.name}_part{i}" for i, f in enumerate(functions(program.graph), 1)}
    used = set()
    parts = [_part(f, called, used) for f in called]
    writer = Writer(program.graph, program.ends, places(program, names), called)
    lines = writer.statements()
    stores = []
    for group, fields in program.outputs.items():
        for field, nodes in fields:
            place, array = names.place(group, field)
            values = [writer.of(node) for node in nodes]  # all is read before anything is written
            stores += [f"  {place}{f'[{i}]' if array else ''} = {v};" for i, v in enumerate(values)]
    lines += stores
    lines[:0] = [f"  (void){g};" for g in given if not any(f"{g}->" in text for text in lines)]
    if names.statuses and "output" in program.outputs:
        lines.append("  return output->status;")
    text = f"{line or signature(program, names)}\n{{\n" + "\n".join(lines) + "\n}\n"
    return named_as("\n".join([*parts, text]), names), writer.used | used


def _part(function, called, used) -> str:
    """A function that is called several times."""
    writer = Writer(function.graph, function.results, {"a": ("a", True)}, called)
    lines = writer.statements()
    lines += [f"  r[{i}] = {v};" for i, v in enumerate([writer.of(node) for node in function.results])]
    used |= writer.used
    return f"static void {called[function]}(const @REAL@ *a, @REAL@ *r)\n{{\n" + "\n".join(lines) + "\n}\n"


def named_as(text, names) -> str:
    """The text with the placeholders of this export's own names filled in."""
    there = {"SINCOS": f"{names.name}_sincos", "TO_INT": f"{names.name}_to_int", "REAL": names.real}
    for word, name in there.items():
        text = text.replace(f"@{word}@", name)
    return text


def _defaults(program, names) -> str:
    lines = []
    for f in program.inputs["parameters"]:
        for i, value in enumerate(np.ravel(f.value).tolist()):
            lines.append(f"  parameters->{f.name}{f'[{i}]' if f.shape else ''} = {number(value, f.kind, names.dtype)};")
    return f"{defaults_signature(names)}\n{{\n" + "\n".join(lines) + "\n}\n"


def helpers(names, used) -> list:
    """The static functions that some operations need."""
    made = []
    if "sincos" in used:
        made.append(named_as(sincos(names), names))
    if "to_int" in used:
        made.append(named_as(_TO_INT.replace("{f}", names.suffix), names))
    return made


_TO_INT = """/* Towards 0; what is too large to the nearest, NaN to 0. */
static int32_t @TO_INT@(@REAL@ x)
{
  if (x != x) {
    return 0;
  }
  return x <= -2147483648.0{f} ? INT32_MIN : x >= 2147483648.0{f} ? INT32_MAX : (int32_t)x;
}
"""


def sincos(names) -> str:
    """Sine and cosine together, as `cnclik.robot.trig` has them."""
    table, f = TABLES[24 if names.suffix else 53], names.suffix
    *exact, part, tail = table.half_pi

    def c(x):
        text = number(x, "real", names.dtype)
        return f"({text})" if text.startswith("-") else text

    def horner(coefficients):
        text = c(coefficients[-1])
        for a in coefficients[-2::-1]:
            text = f"({text} * z + {c(a)})"
        return text

    reduce = "\n".join(f"  x = x - k * {c(p)};" for p in exact)
    magic = 1.5 * 2.0 ** (23 if f else 52)
    return f"""/* sin x and cos x within 2 ulp: x = k pi/2 + r, then two polynomials of r (Cody & Waite 1980). */
static void @SINCOS@(@REAL@ x, @REAL@ *sine, @REAL@ *cosine)
{{
  @REAL@ k, r, s, t, z;
  int32_t quadrant;
  if (!(fabs{f}(x) <= {c(RANGE)})) {{
    *sine = sin{f}(x);
    *cosine = cos{f}(x);
    return;
  }}
  k = (x * {c(2 / np.pi)} + {c(magic)}) - {c(magic)}; /* to the nearest whole number */
{reduce}
  r = x - k * {c(part)};
  r = r + (((x - r) - k * {c(part)}) - k * {c(tail)});
  z = r * r;
  s = r + r * z * {horner(table.sine)};
  t = ({c(1.0)} - {c(0.5)} * z) + z * z * {horner(table.cosine)};
  quadrant = (int32_t)k;
  if (quadrant & 1) {{
    const @REAL@ swap = s;
    s = t;
    t = swap;
  }}
  *sine = (quadrant & 2) ? -s : s;
  *cosine = ((quadrant + 1) & 2) ? -t : t;
}}
"""
