"""Example: test vectors, a C program that runs them, and the README of an export."""

import jax
import numpy as np

from cnclik.export.source import GROUPS, has_status
from cnclik.export.trace import place, targets
from cnclik.law.law import Law
from cnclik.law.reference import by_target, hold_at
from cnclik.measure.files import markdown
from cnclik.robot.posture import start_posture
from cnclik.version import __version__

BUILD = "cc -std=c99 -O2 -ffp-contract=off -fno-math-errno {name}.c example.c -lm -o example"
COUNT = 8
TOLERANCE = {8: 1e-9, 4: 1e-3}  # {bytes of a number: tolerance}, as other compilers round differently
ROUNDED = "least", "contraction"  # the root of a rounding where it is 0; a ratio of two where an iteration arrives
SPARE = 10  # what all roundings of a step move a number by, over what eight of its q do


def inputs(request, program) -> dict:
    """Return {"group.name": (count, size)}: postures with targets nearby; the last has a NaN."""
    random = np.random.default_rng(0)
    if isinstance(request.of, Law):
        values = _of_step(request.of, program, random)
    else:
        values = {"q": random.uniform(-1, 1, (COUNT, request.of.n))}
    values["q"][-1, 0] = np.nan
    given = {}
    for group, fields in program.inputs.items():
        for f in fields:
            value = values[f.name] if group == "input" else np.ravel(f.value)
            dtype = request.dtype if f.kind == "real" else np.int32
            given[f"{group}.{f.name}"] = np.broadcast_to(value, (COUNT, f.size)).astype(dtype)
    return given


def _of_step(law, program, random) -> dict:
    """Return the arguments of a step by name, around a good posture."""
    chain, task = law.chain, law.task
    q = np.asarray(start_posture(chain, task), float) + random.uniform(-0.2, 0.2, (COUNT, chain.n))
    values = {"q": q, "t": np.linspace(0, 1, COUNT)[:, None], "Ts": np.full((COUNT, 1), 0.01)}
    if all(f.name in values for f in program.inputs["input"]):
        return values
    held = [by_target(hold_at(chain, task, row + random.uniform(-0.05, 0.05, chain.n)), task) for row in q]
    for i, (before, parts) in enumerate(targets(task)):
        for part in parts.parts:
            which = "rotation" if part.turns else "position"
            values[before + place(part)] = np.array([np.ravel(getattr(row[i][0].curve, which)) for row in held])
        values[f"{before}velocity"] = random.uniform(-0.1, 0.1, (COUNT, parts.m))
    return values


def results(program, given) -> dict:
    """Return {"group.name": (count, size)} of all results."""
    flat = [given[f"{group}.{f.name}"].reshape(-1, *f.shape) for group, some in program.inputs.items() for f in some]
    with jax.enable_x64(any(x.dtype == np.float64 for x in flat)):
        one = jax.jit(program.fn, compiler_options={"xla_backend_optimization_level": 0})  # a batch takes XLA longer
        values = zip(*[one(*row) for row in zip(*flat, strict=True)], strict=True)
    keys = [f"{group}.{f.name}" for group, some in program.outputs.items() for f in some]
    return {key: np.stack(x).reshape(COUNT, -1) for key, x in zip(keys, values, strict=True)}


def reliable(program, given, near) -> tuple:
    """Return the results, with NaN for numbers that rounding decides, where those of q move them; and how many."""
    made, q, random = results(program, given), given["input.q"], np.random.default_rng(1)
    wanted = dict(made)
    for _ in range(16):
        moved = q + (8 * np.finfo(q.dtype).eps * random.uniform(-1, 1, q.shape) * (1 + abs(q))).astype(q.dtype)
        for key, other in results(program, given | {"input.q": moved}).items():
            if other.dtype.kind == "f" and key.partition(".")[2] not in ROUNDED:
                wanted[key] = np.where(np.isclose(other, made[key], near / SPARE, near / SPARE), wanted[key], np.nan)
    return wanted, sum(int(np.sum(np.isnan(wanted[key]) & np.isfinite(made[key]))) for key in made)


def example(request, program, names) -> str:
    """Return `example.c`: its main returns the number of test vectors that do not agree."""
    given, tolerance = inputs(request, program), TOLERANCE[names.dtype.itemsize]
    wanted, unsure = reliable(program, given, tolerance)
    but = f", but for {unsure} numbers that rounding decides" * (unsure > 0)
    name, near = names.name, names.number(tolerance)
    outputs = [f for f in program.outputs["output"] if f.name not in ROUNDED]
    groups = [group for group in GROUPS if program.inputs[group]]
    tables = [_table(names, f"in_{f.name}", f, given[f"input.{f.name}"]) for f in program.inputs["input"]]
    tables += [_table(names, f"out_{f.name}", f, wanted[f"output.{f.name}"]) for f in outputs]
    lines = [f"    {names.type(group)} {group};" for group in (*groups, "output")]
    if "parameters" in groups:
        lines.append(f"    {name}_defaults(&parameters);")
    lines += [_copy(f"input.{f.name}", f"in_{f.name}[i]", f) for f in program.inputs["input"]]
    lines.append(f"    {name}({', '.join(f'&{group}' for group in (*groups, 'output'))});")
    numbers = [(f"{'' if f.shape else '&'}output.{f.name}", f) for f in outputs if f.kind == "real"]
    lines += [f"    wrong += differs({number}, out_{f.name}[i], {f.size});" for number, f in numbers]
    if has_status(program):  # where a NaN is expected, other bits than its own may differ
        lost = f"{name.upper()}_NON_FINITE"
        found, expected = "output.status", "out_status[i][0]"
        lines.append(f"    wrong += {expected} & {lost} ? !({found} & {lost}) : {found} != {expected};")
    return f"""/* Runs test vectors through {name} and returns 0 if all agree. Written by cnclik {__version__}. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "{name}.h"

{"".join(tables)}
/* How many numbers differ; NaN is not compared: how far it spreads, and what rounding decides, as at a singularity. */
static int differs(const {names.real} *found, const {names.real} *wanted, int size)
{{
  int i, wrong = 0;
  for (i = 0; i < size; ++i) {{
    wrong += !isnan(wanted[i]) && !(fabs(found[i] - wanted[i]) <= {near} * (1 + fabs(wanted[i])));
  }}
  return wrong;
}}

int main(void)
{{
  int i, failed = 0;
  for (i = 0; i < {COUNT}; ++i) {{
    int wrong = 0;
{chr(10).join(lines)}
    if (wrong) {{
      printf("vector %d: %d numbers differ\\n", i, wrong);
    }}
    failed += wrong != 0;
  }}
  printf("%d of {COUNT} vectors agree{but}\\n", {COUNT} - failed);
  return failed;
}}
"""


def _table(names, name, field, values) -> str:
    kind = names.real if field.kind == "real" else "int32_t"
    rows = (", ".join(names.number(v, field.kind) for v in row) for row in values.tolist())
    lines = ",\n".join(f"  {{{row}}}" for row in rows)
    return f"static const {kind} {name}[{len(values)}][{field.size}] = {{\n{lines}\n}};\n"


def _copy(place, table, field) -> str:
    return f"    memcpy({place}, {table}, sizeof {place});" if field.shape else f"    {place} = {table}[0];"


def readme(program, names, configuration) -> str:
    """Return the README: how to build the files, and the meaning of each number."""
    groups = {**program.inputs, "output": program.outputs["output"]}
    rows = [(f"`{group}->{f.name}`", f.about, f.size) for group, fields in groups.items() for f in fields]
    build = BUILD.format(name=names.name)
    return f"""# {names.name}

Written by cnclik {__version__}. Do not edit: export again.

{chr(10).join(f"- {line}" for line in configuration)}

Build and test: `{build} && ./example` (it prints how many test vectors agree, and returns 0 if all do;
numbers that rounding decides, as near a singularity, are counted and not compared).
For speed add `-O3 -march=native -ffp-contract=fast`; without `-ffast-math`, which would let NaN pass for a result.
GCC builds a step of tens of thousands of operations in a third of the time with `-fno-thread-jumps`.

The code is C99, and C++17 without changes. It has no allocation, no recursion and no variables outside the functions;
every loop of cnclik's own has a known bound.

{markdown(("what", "meaning", "entries"), rows, left=2)}"""
