"""Lanes source: the loop in time for many lanes at once, as C with the vector types of GCC and Clang."""

import numpy as np

from cnclik.engine.routine import INT
from cnclik.engine.source import entry, lane, vectors
from cnclik.engine.to_c import Writer
from cnclik.export.source import Names, guarded
from cnclik.version import __version__


def batch_header(program, names: Names) -> str:
    given = "\n".join(f"     {i}: {f.name} ({f.size}) {f.about}" for i, f in enumerate(_given(program)))
    found = "\n".join(f"     {i}: {f.name} ({f.size})" for i, f in enumerate(_found(program)))
    about = f"{names.name}_batch: many loops side by side. Written by cnclik {__version__}."
    text = f"""\
/* Numbers of each lane: those of lane i begin at data + i * stride; with stride 0 all lanes share them. */
typedef struct {{
  const {names.real} *data;
  int64_t stride;
}} {names.name}_column;

/* The loops of lanes first to last - 1, `steps` steps each.
   given, one column each:
{given}
   found, lane after lane, one array each or NULL (residual and contraction: the largest; least: the least):
{found}
   status: the bits of all steps together, one per lane, or NULL. */
{_signature(names)};"""
    return guarded(f"{names.name}_batch", about, text)


def _given(program) -> list:
    return [f for group, fields in program.inputs.items() for f in fields if group != "steps"]


def _found(program) -> list:
    return [f for f in program.outputs["output"] if f.name != "status"]


def _signature(names) -> str:
    real, name = names.real, names.name
    return (
        f"void {name}_batch(int64_t first, int64_t last, int32_t steps, const {name}_column *given,\n"
        f"  {real} *const *found, int32_t *status)"
    )


def batch_source(program, names: Names) -> str:
    reads = [lane(names.dtype, f"given[{i}].data", f"given[{i}].stride") for i, _ in enumerate(_given(program))]
    reads.append(lambda at: "splat_S32(steps)")
    numbers, results = _found(program), program.outputs["output"]
    writes = [_kept(names, f, "status" if f.kind == INT else f"found[{numbers.index(f)}]") for f in results]
    writer = Writer(program.graph, program.given, program.outs, names.dtype, reads, writes, shared=program.given[-1:])
    lines = [f"  {line}" for line in (*writer.statements(), *(f"(void){word};" for word in ("status", "found")))]
    if writer.work[0]:
        lines[:0] = [
            f"  char memory[{writer.work[0] + 256}], *work = (char *)(((uintptr_t)memory + 255) & ~(uintptr_t)255);"
        ]
    lines[:0] = [f"  {table}" for table in writer.tables]
    return f"""/* Written by cnclik {__version__}; see {names.name}_batch.h. Vectors of lanes: GCC or Clang. */
#include "{names.name}_batch.h"

{vectors(writer, names.dtype)}
static void lanes(int64_t first, int64_t n, int32_t steps, const {names.name}_column *given,
  {names.real} *const *found, int32_t *status)
{{
{chr(10).join(lines)}
}}

{_signature(names)}
{{
  for (; first < last; first += W) {{
    lanes(first, last - first < W ? last - first : W, steps, given, found, status);
  }}
}}
"""


def _kept(names, field, where):
    store = entry(np.dtype(np.int32) if field.kind == INT else names.dtype, where, field.size)
    return lambda at, *words: f"if ({where}) {store(at, *words)}"
