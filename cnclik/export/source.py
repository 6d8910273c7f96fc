"""Source: a program's header and source in C99."""

import textwrap

import numpy as np

from cnclik.engine.operations import number
from cnclik.engine.routine import INT
from cnclik.engine.scalar import ScalarWriter, helpers
from cnclik.integrate.status import Status
from cnclik.reaching.result import ReachStatus
from cnclik.version import __version__

GROUPS = ("parameters", "input")
REACHED = tuple(ReachStatus[name] for name in ("SOLVED", "OUT_OF_REACH", "OUT_OF_BUDGET", "NON_FINITE"))


PREFIX = "clik_"  # prefix of all public names, so that none is a keyword, a macro, or a library function


class Names:
    def __init__(self, name, dtype, what):
        name = PREFIX + name.removeprefix(PREFIX)
        self.name, self.dtype, self.what = name, np.dtype(dtype), what
        self.real = "float" if self.dtype.itemsize == 4 else "double"
        self.suffix = "f" if self.real == "float" else ""
        self.entry = f"{name}_step" if what == "solve" else name  # function for one call
        self.statuses = {"step": Status, "solve": Status, "reach": REACHED}.get(what, ())

    def type(self, group) -> str:
        return f"{self.name}_{group}"

    def number(self, value, kind="real") -> str:
        return number(value, self.dtype if kind == "real" else np.int32)

    def rows(self, values, kind="real", indent="  ") -> str:
        """A table's initializer in C, row by row."""
        lines = (", ".join(self.number(v, kind) for v in row) for row in np.asarray(values).tolist())
        return "{\n" + ",\n".join(f"{indent}{{{line}}}" for line in lines) + f"\n{indent[2:]}}}"


def comment(text) -> str:
    """A block comment that is safe for any name of a joint."""
    text = "".join(c if " " <= c <= "~" or c == "\n" else "?" for c in text)
    for mark in ("*/", "/*", "??"):  # ends or starts of comments, trigraphs
        text = text.replace(mark, f"{mark[0]} {mark[1]}")
    lines = [line for part in text.strip().split("\n") for line in (textwrap.wrap(part, 110) or [""])]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"]) + "\n"


def header(program, names, configuration, more="") -> str:
    """The header: types, the status bits, and the functions.

    Args:
      configuration: the configuration in words, line by line.
      more: further declarations.
    """
    groups = {g: fields for g, fields in program.inputs.items() if fields}
    groups["output"] = program.outputs["output"]
    types = "\n".join(struct(names, group, fields) for group, fields in groups.items())
    bits = ""
    if names.statuses:
        inside = ",\n".join(f"  {names.name.upper()}_{s.name} = {int(s)}" for s in names.statuses)
        bits = f"/* {'Bits of the' if names.statuses is Status else 'The'} status. */\nenum {{\n{inside}\n}};\n\n"
    calls = [f"{signature(program, names)};"]
    about = "One call; returns the status." if bits else "One call."
    if program.inputs["parameters"]:
        calls.insert(0, f"/* The parameters as they were exported. */\n{defaults_signature(names)};\n")
    calls[-1] = f"/* {about} */\n{calls[-1]}"
    if more:
        calls.append(f"\n{more}")
    about = "\n".join(
        [f"{names.name}: written by cnclik {__version__}. Do not edit: export again.", "", *configuration]
    )
    return guarded(names.name, about, f"{bits}{types}\n" + "\n".join(calls))


def guarded(name, about, text) -> str:
    """A header for C and C++, with a comment at the top."""
    guard = f"{name.upper()}_H"
    return f"""{comment(about)}#ifndef {guard}
#define {guard}

#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

{text}

#ifdef __cplusplus
}}
#endif

#endif
"""


def struct(names, group, fields) -> str:
    lines = []
    for f in fields:
        kind, size = "int32_t" if f.kind == INT else names.real, f"[{f.size}]" if f.shape else ""
        lines.append(f"  {kind} {f.name}{size};" + (f" /* {f.about} */" if f.about else ""))
    return "typedef struct {\n" + "\n".join(lines) + f"\n}} {names.type(group)};\n"


def arguments(program, names, ending=("output",)) -> str:
    given = [g for g in GROUPS if program.inputs[g]]
    return ", ".join(f"{'const ' if g in GROUPS else ''}{names.type(g)} *{g}" for g in (*given, *ending))


def signature(program, names) -> str:
    returns = "int32_t" if names.statuses else "void"
    return f"{returns} {names.entry}({arguments(program, names)})"


def defaults_signature(names) -> str:
    return f"void {names.name}_defaults({names.type('parameters')} *parameters)"


def source(program, names, more=None, inside=None) -> str:
    """The whole source file. `inside`: functions in place of the program's own; `more`: text at the end.

    Each is a text with the `functions` for `helpers`.
    """
    function, used = inside or body(program, names)
    ending, also = more or ("", set())
    parts = [
        f"/* Written by cnclik {__version__}; see {names.name}.h. */\n",
        f'#include "{names.name}.h"\n\n#include <math.h>\n' + ("#include <string.h>\n" if inside else ""),
        helpers(used | also, f"{names.name}_"),
    ]
    if program.inputs["parameters"]:
        parts.append(_defaults(program, names))
    return "\n".join(filter(None, [*parts, function, ending]))


def statements(program, names, place=lambda group, field: f"{group}->{field.name}"):
    """(lines of a function of the program, the `functions` for `helpers`); `place` gives the C place of a field."""
    writer = ScalarWriter(program.graph, program.given, program.outs, *program.places(place), f"{names.name}_")
    return writer.statements(), writer.functions


def body(program, names):
    """The exported function's text, and the `functions` for `helpers`."""
    lines, used = statements(program, names)
    given = [g for g in program.inputs if program.inputs[g]]
    lines[:0] = [f"  (void){g};" for g in given if not any(f"{g}->" in text for text in lines)]
    if names.statuses and "output" in program.outputs:
        lines.append("  return output->status;")
    return f"{signature(program, names)}\n{{\n" + "\n".join(lines) + "\n}\n", used


def _defaults(program, names) -> str:
    lines = []
    for f in program.inputs["parameters"]:
        for i, value in enumerate(np.ravel(f.value).tolist()):
            lines.append(f"  parameters->{f.name}{f'[{i}]' if f.shape else ''} = {names.number(value, f.kind)};")
    return f"{defaults_signature(names)}\n{{\n" + "\n".join(lines) + "\n}\n"
