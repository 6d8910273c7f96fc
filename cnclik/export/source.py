"""Source: the header and the source of an exported function in C99."""

import textwrap

import numpy as np

from cnclik.engine.operations import number
from cnclik.engine.routine import INT
from cnclik.engine.scalar import ScalarWriter, helpers
from cnclik.integrate.status import Status
from cnclik.version import __version__

GROUPS = ("parameters", "input")
PREFIX = "clik_"  # prefix of all public names, so that none is a keyword, a macro, or a library function


class Names:
    """The names of an export in C."""

    def __init__(self, name, dtype):
        self.name, self.dtype = PREFIX + name.removeprefix(PREFIX), np.dtype(dtype)
        self.real = "float" if self.dtype.itemsize == 4 else "double"

    def type(self, group) -> str:
        return f"{self.name}_{group}"

    def number(self, value, kind="real") -> str:
        return number(value, self.dtype if kind == "real" else np.int32)


def comment(text) -> str:
    """Return a block comment that is safe for any name of a joint."""
    text = _unmarked("".join(c if " " <= c <= "~" or c == "\n" else "?" for c in text))
    lines = [line for part in text.strip().split("\n") for line in (textwrap.wrap(part, 110) or [""])]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"]) + "\n"


def _unmarked(text) -> str:
    """Return a text without what ends or starts a comment, and without trigraphs."""
    for mark in ("*/", "/*", "??"):
        text = text.replace(mark, f"{mark[0]} {mark[1]}")
    return text


def header(program, names, configuration) -> str:
    """Return the header: types, status bits and functions.

    Args: configuration: the configuration in words, line by line.
    """
    groups = {group: fields for group, fields in program.inputs.items() if fields}
    groups["output"] = program.outputs["output"]
    types = "\n".join(_struct(names, group, fields) for group, fields in groups.items())
    bits, about = "", "One call."
    if has_status(program):
        inside = ",\n".join(f"  {names.name.upper()}_{s.name} = {int(s)}" for s in Status)
        bits, about = f"/* Bits of the status. */\nenum {{\n{inside}\n}};\n\n", "One call; returns the status."
    calls = f"/* {about} */\n{_signature(program, names)};"
    if program.inputs["parameters"]:
        calls = f"/* The parameters as they were exported. */\n{_defaults_signature(names)};\n\n{calls}"
    title = [f"{names.name}: written by cnclik {__version__}. Do not edit: export again.", "", *configuration]
    guard = f"{names.name.upper()}_H"
    return f"""{comment(chr(10).join(title))}#ifndef {guard}
#define {guard}

#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

{bits}{types}
{calls}

#ifdef __cplusplus
}}
#endif

#endif
"""


def has_status(program) -> bool:
    return any(field.name == "status" for field in program.outputs["output"])


def _struct(names, group, fields) -> str:
    lines = []
    for f in fields:
        kind, size = "int32_t" if f.kind == INT else names.real, f"[{f.size}]" if f.shape else ""
        lines.append(f"  {kind} {f.name}{size};" + (f" /* {_unmarked(f.about)} */" if f.about else ""))
    return "typedef struct {\n" + "\n".join(lines) + f"\n}} {names.type(group)};\n"


def _signature(program, names) -> str:
    const = {"parameters": "const ", "input": "const "}
    groups = [*(group for group in GROUPS if program.inputs[group]), "output"]
    arguments = ", ".join(f"{const.get(group, '')}{names.type(group)} *{group}" for group in groups)
    return f"{'int32_t' if has_status(program) else 'void'} {names.name}({arguments})"


def _defaults_signature(names) -> str:
    return f"void {names.name}_defaults({names.type('parameters')} *parameters)"


def source(program, names) -> str:
    """Return the whole source file."""
    reads, writes = program.places(lambda group, field: f"{group}->{field.name}")
    writer = ScalarWriter(program.graph, program.given, program.outs, reads, writes, f"{names.name}_")
    lines = writer.statements()
    given = [group for group in program.inputs if program.inputs[group]]
    lines[:0] = [f"  (void){group};" for group in given if not any(f"{group}->" in text for text in lines)]
    if has_status(program):
        lines.append("  return output->status;")
    parts = [
        f"/* Written by cnclik {__version__}; see {names.name}.h. */\n",
        f'#include "{names.name}.h"\n\n#include <math.h>\n',
        helpers(writer.functions, f"{names.name}_"),
        _defaults(program, names) if program.inputs["parameters"] else "",
        f"{_signature(program, names)}\n{{\n" + "\n".join(lines) + "\n}\n",
    ]
    return "\n".join(filter(None, parts))


def _defaults(program, names) -> str:
    lines = []
    for f in program.inputs["parameters"]:
        for i, value in enumerate(np.ravel(f.value).tolist()):
            lines.append(f"  parameters->{f.name}{f'[{i}]' if f.shape else ''} = {names.number(value, f.kind)};")
    return f"{_defaults_signature(names)}\n{{\n" + "\n".join(lines) + "\n}\n"
