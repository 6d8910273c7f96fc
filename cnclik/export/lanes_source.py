"""Lanes source: the loop in time for many lanes at once, as C with the vector types of GCC and Clang."""

from cnclik.export.source import Names, comment
from cnclik.native.prelude import prelude
from cnclik.native.vector import VectorWriter, inner
from cnclik.version import __version__


def batch_header(program, names: Names) -> str:
    """The header of the function for many lanes."""
    guard = f"{names.name.upper()}_BATCH_H"
    given = "\n".join(f"     {i}: {f.name} ({f.size}) {f.about}" for i, f in enumerate(_given(program)))
    found = "\n".join(f"     {i}: {f.name} ({f.size})" for i, f in enumerate(_found(program)))
    about = comment(f"{names.name}_batch: many loops side by side. Written by cnclik {__version__}.")
    return f"""{about}#ifndef {guard}
#define {guard}

#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

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
{_signature(names)};

#ifdef __cplusplus
}}
#endif

#endif
"""


def _given(program) -> list:
    return [f for fields in program.inputs.values() for f in fields]


def _found(program) -> list:
    return [f for f, _ in program.outputs["output"] if f.name != "status"]


def _signature(names) -> str:
    real, name = names.real, names.name
    return (
        f"void {name}_batch(int64_t first, int64_t last, int32_t steps, const {name}_column *given,\n"
        f"  {real} *const *found, int32_t *status)"
    )


def batch_source(program, names: Names) -> str:
    """The source of the function for many lanes."""
    parts, called, writers = inner(program.graph, names.name)
    places = {"steps": ("SPLATI(steps)", False)}
    fields = [(f"{g}.{f.name}", f) for g, some in program.inputs.items() for f in some]
    for i, (key, field) in enumerate(fields):
        load = f"load(&given[{i}], at, last, {{0}})"
        places[key] = (load if field.kind == "real" else f"vint({load})", True)
    writer = VectorWriter(program.graph, program.ends, places, called)
    lines = writer.statements()
    stores = []
    found = 0
    for field, nodes in program.outputs["output"]:
        values = [writer.of(node) for node in nodes]
        if field.name == "status":
            stores.append(f"  store_status(status, at, last, {values[0]});")
        else:
            stores += [f"  store(found[{found}], at, last, {field.size}, {i}, {v});" for i, v in enumerate(values)]
            found += 1
    writers.append(writer)
    has_status = any(field.name == "status" for field, _ in program.outputs["output"])
    lines += ["  (void)status;"] * (not has_status) + ["  (void)found;"] * (found == 0)
    block = (
        f"static void lanes_at(int64_t at, int64_t last, int32_t steps, const {names.name}_column *given,\n"
        f"  {names.real} *const *found, int32_t *status)\n{{\n" + "\n".join([*lines, *stores]) + "\n}\n"
    )
    every = f"""{_signature(names)}
{{
  int64_t at;
  for (at = first; at < last; at += W) {{
    lanes_at(at, last, steps, given, found, status);
  }}
}}
"""
    head = f"/* Written by cnclik {__version__}; see {names.name}_batch.h. Vectors of lanes: GCC or Clang. */\n"
    head += f'#include "{names.name}_batch.h"\n\n'
    head += prelude(names.dtype, writers)
    head += _LOAD.replace("@COLUMN@", f"{names.name}_column")
    text = "\n".join([head, *parts, block, every])
    return text.replace("@REAL@", names.real)


_LOAD = """static inline V load(const @COLUMN@ *column, int64_t at, int64_t last, int64_t place)
{
  V r = {0};
  for (int i = 0; i < W; ++i) {
    const int64_t lane = at + i < last ? at + i : last - 1;
    r[i] = column->data[lane * column->stride + place];
  }
  return r;
}

static inline void store(@REAL@ *found, int64_t at, int64_t last, int64_t size, int64_t place, V x)
{
  if (found != NULL) {
    for (int i = 0; i < W && at + i < last; ++i) found[(at + i) * size + place] = x[i];
  }
}

static inline void store_status(int32_t *status, int64_t at, int64_t last, I x)
{
  if (status != NULL) {
    for (int i = 0; i < W && at + i < last; ++i) status[at + i] = (int32_t)x[i];
  }
}
"""
