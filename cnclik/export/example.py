"""Example: test vectors, a C program that runs them, and the README of an export."""

import jax
import numpy as np

from cnclik.export.source import GROUPS
from cnclik.export.trace import place, targets
from cnclik.hints import QUICK_COMPILE, known_options
from cnclik.integrate.status import Status
from cnclik.law.paths import hold_at
from cnclik.law.reference import by_target
from cnclik.measure.files import markdown
from cnclik.reaching.result import ReachStatus
from cnclik.robot.posture import start_posture
from cnclik.version import __version__

BUILD = "cc -std=c99 -O2 -ffp-contract=off -fno-math-errno {sources} -lm -o example"
COUNT = 8
TOLERANCE = {8: 1e-9, 4: 1e-3}  # {bytes of a number: tolerance}, as other compilers round differently


def inputs(request, program) -> dict:
    """{"group.name": (count, size)}: postures around a good one with targets nearby; the last has a NaN."""
    random, chain, task = np.random.default_rng(0), request.law.chain, request.law.task
    start = np.asarray(start_posture(chain, task), float)
    q = start + random.uniform(-0.2, 0.2, (COUNT, chain.n))
    known = {"q": q, "t": np.linspace(0, 1, COUNT)[:, None], "Ts": np.full((COUNT, 1), 0.01)}
    if any(f.name not in known for f in program.inputs["input"]):
        held = [by_target(hold_at(chain, task, row + random.uniform(-0.05, 0.05, chain.n)), task) for row in q]
        for i, (before, parts) in enumerate(targets(task)):
            for part in parts.parts:
                which = "rotation" if part.turns else "position"
                known[before + place(part)] = np.array([np.ravel(getattr(one[i][0].curve, which)) for one in held])
            known[f"{before}velocity"] = random.uniform(-0.1, 0.1, (COUNT, parts.width))
    made = {}
    for group, fields in program.inputs.items():
        for f in fields:
            value = known[f.name] if group == "input" else np.broadcast_to(np.ravel(f.value), (COUNT, f.size))
            value = value.astype(request.dtype if f.kind == "real" else np.int32)
            made[f"{group}.{f.name}"] = value
    made["input.q"][-1, 0] = np.nan
    return made


def results(program, given) -> dict:
    """{"group.name": (count, size)} of all results; for a search only the status."""
    if program.fn is None:
        lost = np.isnan(given["input.q"]).any(1, keepdims=True)
        return {"output.status": np.where(lost, int(ReachStatus.NON_FINITE), int(ReachStatus.SOLVED))}
    fields = [(f"{g}.{f.name}", f) for g, some in program.inputs.items() for f in some]
    flat = [given[key].reshape(-1, *f.shape) for key, f in fields]
    for i, value in sorted(program.fixed.items()):
        flat.insert(i, np.broadcast_to(value, (len(flat[0]), *value.shape)))
    with jax.enable_x64(any(x.dtype == np.float64 for x in flat)):
        found = jax.jit(jax.vmap(program.fn), compiler_options=known_options(QUICK_COMPILE))(*flat)
    keys = [f"{g}.{f.name}" for g, some in program.outputs.items() for f in some]
    return {key: np.asarray(x).reshape(len(x), -1) for key, x in zip(keys, found, strict=True)}


def example(request, program, names) -> str:
    """`example.c`: its main returns the number of test vectors that do not agree."""
    given = inputs(request, program)
    wanted = results(program, given)
    name = names.name
    outputs = [(key, f) for f in program.outputs["output"] if (key := f"output.{f.name}") in wanted]
    tables = [_table(names, f"in_{f.name}", f, given[f"input.{f.name}"]) for f in program.inputs["input"]]
    tables += [_table(names, f"out_{f.name}", f, wanted[key]) for key, f in outputs]
    fill = [_copy(f"input.{f.name}", f"in_{f.name}[i]", f) for f in program.inputs["input"]]
    near = names.number(TOLERANCE[names.dtype.itemsize])
    checks = [f"    wrong += {_differs(f, near)};" for _, f in outputs if f.kind == "real"]
    checks += [f"    wrong += {_is_another(names, f)};" for _, f in outputs if f.kind != "real"]
    begin = [f"    {names.type(g)} {g};" for g in (*(g for g in GROUPS if program.inputs[g]), "output")]
    if program.inputs["parameters"]:
        begin.append(f"    {name}_defaults(&parameters);")
    called = ", ".join(f"&{g}" for g in (*(g for g in GROUPS if program.inputs[g]), "output"))
    compare = _comparison(names, near) if any(f.kind == "real" for _, f in outputs) else ""
    return f"""/* Runs test vectors through {name} and returns 0 if all agree. Written by cnclik {__version__}. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "{name}.h"

{"".join(tables)}
{compare}int main(void)
{{
  int i, failed = 0;
  for (i = 0; i < {COUNT}; ++i) {{
    int wrong = 0;
{chr(10).join([*begin, *fill])}
    {names.entry}({called});
{chr(10).join(checks)}
    if (wrong) {{
      printf("vector %d: %d numbers differ\\n", i, wrong);
    }}
    failed += wrong != 0;
  }}
  printf("%d of {COUNT} vectors agree\\n", {COUNT} - failed);
  return failed;
}}
"""


def _is_another(names, field) -> str:
    """C: whether a whole number differs; if NaN is expected, whether the status does not report it."""
    other = f"output.{field.name} != out_{field.name}[i][0]"
    if names.statuses is not Status:
        return other
    lost = f"{names.name.upper()}_NON_FINITE"
    return f"out_{field.name}[i][0] & {lost} ? !(output.{field.name} & {lost}) : {other}"


def _differs(field, near) -> str:
    """C: how many numbers of a result differ. Of `least` it compares squares, as it is the root of a rounding at 0."""
    if field.name == "least":
        off = "fabs(output.least * output.least - out_least[i][0] * out_least[i][0])"
        return f"!isnan(out_least[i][0]) && !({off} <= {near})"
    return f"differs({'' if field.shape else '&'}output.{field.name}, out_{field.name}[i], {field.size})"


def _comparison(names, near) -> str:
    """The C function that compares numbers; how far a NaN spreads is not compared, as the status reports it."""
    return f"""static int differs(const {names.real} *found, const {names.real} *wanted, int size)
{{
  int i, wrong = 0;
  for (i = 0; i < size; ++i) {{
    wrong += !isnan(wanted[i]) && !(fabs(found[i] - wanted[i]) <= {near} * (1 + fabs(wanted[i])));
  }}
  return wrong;
}}

"""


def _table(names, name, field, values) -> str:
    kind = "int32_t" if field.kind != "real" else names.real
    table = names.rows(values, field.kind)
    return f"static const {kind} {name}[{len(values)}][{field.size}] = {table};\n"


def _copy(place, table, field) -> str:
    if field.shape:
        return f"    memcpy({place}, {table}, sizeof {place});"
    return f"    {place} = {table}[0];"


_SINGLE = """In single precision a joint stops short of its target by half a spacing of `q` over alpha·Ts: by 1.2e-5 rad
at 2 rad, 10 1/s and 1 kHz, as smaller steps are rounded away. To go on, keep the joint values in double precision
outside: `q += Ts * output->qdot`, one step a call, and hand them in rounded.
"""


def readme(program, names, configuration, files, counted) -> str:
    """What the files are, how to build them, and the meaning of each number. `counted`: operations at most."""
    ops = ", ".join(f"{n} {what}" for what, n in counted.items())
    groups = {**program.inputs, "output": program.outputs["output"]}
    rows = [(f"`{g}->{f.name}`", f.about, f.size) for g, fields in groups.items() for f in fields]
    table = markdown(("what", "meaning", "entries"), rows, left=2)
    build = BUILD.format(sources=f"{names.name}.c example.c")
    return f"""# {names.name}

Written by cnclik {__version__}. Do not edit: export again.

{chr(10).join(f"- {line}" for line in configuration)}

Build and test: `{build} && ./example` (it prints how many test vectors agree, and returns 0 if all do).
For speed add `-O3 -march=native -ffp-contract=fast`; without `-ffast-math`, which would let NaN pass for a result.
GCC builds a step of tens of thousands of operations in a third of the time with `-fno-thread-jumps`.

The code is C99, and C++17 without changes. It has no allocation, no recursion and no variables outside the functions;
every loop has a known bound.
A call takes at most {ops} operations; sine and cosine count as library functions.

{table}

{_SINGLE if names.real == "float" and any(f.name == "qdot" for f in program.outputs["output"]) else ""}
Files: {", ".join(f"`{f}`" for f in files)}. `cnclik.export.load` reads `export.json`.
""".replace("\n\n\n", "\n\n")
