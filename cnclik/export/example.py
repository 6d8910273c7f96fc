"""Example: a C program that runs the test vectors, and the README that goes with it."""

from cnclik.export.source import GROUPS
from cnclik.export.vectors import TOLERANCE, inputs, results
from cnclik.integrate.status import Status
from cnclik.measure.files import markdown
from cnclik.version import __version__

BUILD = "cc -std=c99 -O2 -ffp-contract=off -fno-math-errno {sources} -lm -o example"


def example(asked, program, names) -> str:
    """`example.c`: its main returns 0 where all vectors agree, else how many do not."""
    given = inputs(asked, program)
    wanted = results(program, given)
    count, name = len(given["input.q"]), names.name
    outputs = [(key, f) for f in program.outputs["output"] if (key := f"output.{f.name}") in wanted]
    tables = [_table(names, f"in_{f.name}", f, given[f"input.{f.name}"]) for f in program.inputs["input"]]
    tables += [_table(names, f"out_{f.name}", f, wanted[key]) for key, f in outputs]
    fill = [_copy(f"input.{f.name}", f"in_{f.name}[i]", f) for f in program.inputs["input"]]
    checks = [
        f"    wrong += differs({f'output.{f.name}' if f.shape else f'&output.{f.name}'}, out_{f.name}[i], {f.size});"
        for _, f in outputs
        if f.kind == "real"
    ]
    checks += [f"    wrong += {_is_another(names, f)};" for _, f in outputs if f.kind != "real"]
    begin = [f"    {names.type(g)} {g};" for g in (*(g for g in GROUPS if program.inputs[g]), "output")]
    if program.inputs["parameters"]:
        begin.append(f"    {name}_defaults(&parameters);")
    if program.inputs["history"]:
        begin.append("    memset(&history, 0, sizeof history);")
    called = ", ".join(f"&{g}" for g in (*(g for g in GROUPS if program.inputs[g]), "output"))
    near = names.number(TOLERANCE[names.dtype.itemsize])
    compare = _differs(names, near) if any(f.kind == "real" for _, f in outputs) else ""
    return f"""/* Runs test vectors through {name} and returns 0 where all agree. Written by cnclik {__version__}. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "{name}.h"

{"".join(tables)}
{compare}int main(void)
{{
  int i, failed = 0;
  for (i = 0; i < {count}; ++i) {{
    int wrong = 0;
{chr(10).join([*begin, *fill])}
    {names.entry}({called});
{chr(10).join(checks)}
    if (wrong) {{
      printf("vector %d: %d numbers differ\\n", i, wrong);
    }}
    failed += wrong != 0;
  }}
  printf("%d of {count} vectors agree\\n", {count} - failed);
  return failed;
}}
"""


def _is_another(names, field) -> str:
    """Whether a whole number is another; where numbers are lost, whether the status doesn't tell."""
    other = f"output.{field.name} != out_{field.name}[i][0]"
    if names.statuses is not Status:
        return other
    lost = f"{names.name.upper()}_NON_FINITE"
    return f"out_{field.name}[i][0] & {lost} ? !(output.{field.name} & {lost}) : {other}"


def _differs(names, near) -> str:
    """The function that compares numbers; how far a NaN spreads is not held, as the status tells of it."""
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
    """What the files are, how to build them, and what each number means. `counted`: operations at most."""
    ops = ", ".join(f"{n} {what}" for what, n in counted.items())
    groups = {**program.inputs, "output": program.outputs["output"]}
    rows = [(f"`{g}->{f.name}`", f.about, f.size) for g, fields in groups.items() for f in fields]
    table = markdown(("what", "meaning", "entries"), rows, left=2)
    build = BUILD.format(sources=f"{names.name}.c example.c")
    return f"""# {names.name}

Written by cnclik {__version__}. Do not edit: export again.

{chr(10).join(f"- {line}" for line in configuration)}

Build and test: `{build} && ./example` (it prints how many test vectors agree, and returns 0 where all do).
For speed add `-O3 -march=native -ffp-contract=fast`; leave out `-ffast-math`, with which NaN would pass for a result.

C99, and C++17 as it is. No allocation, no recursion, no variables outside the functions; every loop has a known bound.
A call takes at most {ops} functions of libm (sine and cosine are counted as such).

{table}

{_SINGLE if names.real == "float" and any(f.name == "qdot" for f in program.outputs["output"]) else ""}
{"Fill `history` with zeros before the first call, and after every pause." if program.inputs["history"] else ""}
Files: {", ".join(f"`{f}`" for f in files)}. `export.json` tells `cnclik.export.load` what the functions take.
""".replace("\n\n\n", "\n\n")
