"""Solve source: N steps in one call, around the exported step."""

import re

from cnclik.export.source import GROUPS, Names, arguments, statements


def solve_header(program, names: Names) -> str:
    rows = "\n".join(
        f"  {'int32_t' if name == 'status' else names.real} *{name}; /* {about} */"
        for name, about in (
            ("q", "steps + 1 rows of joint values"),
            ("x", "steps + 1 rows of task coordinates"),
            ("e", "steps + 1 rows of errors"),
            ("qdot", "steps rows of joint velocities"),
            ("residual", "steps numbers"),
            ("contraction", "steps numbers"),
            ("status", "steps numbers, GROWING among their bits"),
        )
    )
    return f"""/* Where a trajectory goes, row after row; what is NULL is not kept. */
typedef struct {{
{rows}
}} {names.name}_trajectory;

/* So many steps from input->t on; returns the bits of all of them, and leaves where it ends in `output`: its q is
   where the last step led, its e and x are the error and the coordinates there. */
{signature(program, names)};
"""


def signature(program, names) -> str:
    given = arguments(program, names, ("output",))
    return f"int32_t {names.name}({given},\n  int32_t steps, const {names.name}_trajectory *trajectory)"


def _grown(growth, names) -> tuple:
    """The function that tests whether a step grew, the loop's arguments that it takes, and the `functions` for
    `helpers`.
    """
    ends = {"output": "grown", "ends": "{}"}
    lines, functions = statements(growth, names, lambda g, f: ends.get(g, f"{g}->{f.name}").format(f.name))
    used = [g for g in ("parameters", "input") if any(f"{g}->" in line for line in lines)]
    constant = "".join(f"const {names.type(g)} *{g}, " for g in used)
    unused = [] if re.search(r"\bt\[", "".join(lines)) else ["  (void)t;"]
    head = f"static int32_t {names.name}_grown({constant}const {names.real} *t, const {names.real} *e)"
    return "\n".join([head, "{", *unused, "  int32_t grown;", *lines, "  return grown;", "}", ""]), used, functions


def solve_source(program, growth, names: Names, n, m) -> tuple:
    """The loop, the function that tests whether a step grew, and the `functions` for `helpers`."""
    grown, used, functions = _grown(growth, names)
    given = ", ".join([*(g if g != "input" else "&at" for g in GROUPS if program.inputs[g]), "output"])
    of_growth = "".join(f"{'&at' if g == 'input' else g}, " for g in used)
    return (
        f"""{grown}
{signature(program, names)}
{{
  {names.type("input")} at = *input;
  {names.real} t[2] = {{0}}, e[{2 * m}] = {{0}};
  int32_t all = 0, before = 0, k;
  int i;
  for (k = 0; k <= steps; ++k) {{
    int32_t status;
    at.t = input->t + ({names.real})k * input->Ts;
    at.Ts = k < steps ? input->Ts : 0; /* the last one only looks where it is */
    status = {names.name}_step({given});
    t[0] = t[1];
    t[1] = at.t;
    for (i = 0; i < {m}; ++i) {{
      e[i] = e[{m} + i];
      e[{m} + i] = output->e[i];
      if (trajectory->e) trajectory->e[(int64_t)k * {m} + i] = output->e[i];
      if (trajectory->x) trajectory->x[(int64_t)k * {m} + i] = output->x[i];
    }}
    for (i = 0; i < {n}; ++i) {{
      if (trajectory->q) trajectory->q[(int64_t)k * {n} + i] = at.q[i];
    }}
    if (k > 0) {{
      before |= {names.name}_grown({of_growth}t, e);
      all |= before;
      if (trajectory->status) trajectory->status[k - 1] = before;
    }}
    before = status;
    if (k < steps) {{
      for (i = 0; i < {n}; ++i) {{
        if (trajectory->qdot) trajectory->qdot[(int64_t)k * {n} + i] = output->qdot[i];
        at.q[i] = output->q[i];
      }}
      if (trajectory->residual) trajectory->residual[k] = output->residual;
      if (trajectory->contraction) trajectory->contraction[k] = output->contraction;
    }}
  }}
  output->status = all;
  return all;
}}
""",
        functions,
    )
