"""Reach source: the search for one target, around the traced look.

From where the arm is, then from the posture whose tip is nearest to the target, then from the next nearest: each by
careful steps, until one arrives. Where none does, the nearest pose found is told. Lengths are in the chain's own unit
inside, see `reaching.units`.
"""

import math

from cnclik.export.cost import operations
from cnclik.export.reach_trace import Reaching
from cnclik.export.source import Names, body, signature, struct
from cnclik.reaching.seeds import TURN

STEPS, TOGETHER, ROUNDS_FAR = 40, 8, 3  # steps of a try; tries where the target is farther off than the arm is long
MORE = 5  # times as many steps from the nearest pose found, where none is an answer


def most_operations(reaching: Reaching) -> dict:
    """Operations of a call at most."""
    looks = (len(reaching.postures) + 1 + MORE) * STEPS
    return {what: count * looks for what, count in operations(reaching.look).items()}


def reach_source(reaching: Reaching, names: Names) -> tuple:
    """The text of all functions, and what `helpers` are for."""
    name, groups = names.name, reaching.look.inputs
    given = ", ".join(f"const {names.type(g)} *{g}" for g in ("parameters", "input", "bounds"))
    text, used = body(reaching.look, names, f"static void {name}_look({given}, {names.type('search')} *search)")
    parts = [
        struct(names, "bounds", groups["bounds"]),
        "/* Where a search stands: `best` is the posture of the least error so far, `steep` the slope there. */",
        struct(names, "search", groups["search"]),
        text,
        _nearest(reaching, names),
        _search(reaching, names),
    ]
    return "\n".join(parts), used


def _nearest(reaching, names) -> str:
    """Chooses a posture to start from."""
    count, columns = reaching.tips.shape
    turned = any(f.name == "rotation" for f in reaching.call.inputs["input"])
    p = columns - 9 * turned
    parts = []
    if p:
        factor = names.number(reaching.scale)
        parts.append(f"""    for (i = 0; i < {p}; ++i) {{
      const {names.real} d = {factor} * input->position[i] - tips[k][i];
      far += d * d;
    }}""")
    if turned:
        factor = names.number(TURN)
        parts.append(f"""    for (i = 0; i < 9; ++i) {{
      const {names.real} d = {factor} * input->rotation[i] - tips[k][{f"{p} + " * bool(p)}i];
      far += d * d;
    }}""")
    return f"""/* The number of the posture, of those not tried yet, whose tip is nearest to the target. */
static int {names.name}_nearest(const {names.type("input")} *input, const unsigned char *tried)
{{
  static const {names.real} tips[{count}][{columns}] = {names.rows(reaching.tips, indent="    ")};
  {names.real} least = INFINITY;
  int found = 0, k, i;
  for (k = 0; k < {count}; ++k) {{
    {names.real} far = 0;
{chr(10).join(parts)}
    if (!tried[k] && far < least) {{
      least = far;
      found = k;
    }}
  }}
  return found;
}}
"""


def _search(reaching, names) -> str:
    """The exported function."""
    (count, n), real, f = reaching.postures.shape, names.real, names.suffix
    inputs = reaching.call.inputs["input"]
    c = names.number

    finite = "\n".join(
        f"  for (i = 0; i < {field.size}; ++i) {{\n    sum += 0 * input->{field.name}[i];\n  }}" for field in inputs
    )
    turn = c(2 * math.pi)
    turns = "\n".join(
        f"  output->q[{i}] -= {turn} * floor{f}((output->q[{i}] - input->q[{i}]) / {turn} + {c(0.5)});"
        for i in reaching.turns
    )
    word, far, few = names.name.upper(), "", ""
    unit = "" if reaching.unit == 1.0 else f"{c(reaching.unit)} * "
    if reaching.center:
        away = " + ".join(
            f"(input->position[{i}] - {c(x)}) * (input->position[{i}] - {c(x)})" for i, x in enumerate(reaching.center)
        ).replace("- -", "+ ")
        far = f"\n  far = sqrt{f}({away}) > {c(reaching.length)} + parameters->tolerance[0];"
        few = f" && !(far && k > {ROUNDS_FAR * TOGETHER})"
    units, metres = _units(reaching, names, inputs)
    return f"""{signature(reaching.call, names)}
{{
  static const {names.type("bounds")} bounds = {{
    {{{", ".join(map(c, reaching.lower.tolist()))}}},
    {{{", ".join(map(c, reaching.upper.tolist()))}}}
  }};
  static const {real} postures[{count}][{n}] = {names.rows(reaching.postures, indent="    ")};
  unsigned char tried[{count}] = {{0}};
  {names.type("search")} at, best;
  {real} sum = 0, turn;
  int32_t looks = 0, status;
  int far = 0, k, i;
{units}{finite}{far}
  memset(&best, 0, sizeof best);
  for (i = 0; i < {n}; ++i) {{
    best.best[i] = input->q[i];
  }}
  best.squares[0] = best.squares[1] = best.cost = INFINITY;
  for (k = 0; (k == 0 || k < parameters->tries) && k <= {count} && !best.arrived && sum == 0{few}; ++k) {{
    const {real} *start = input->q;
    int step;
    if (k > 0) {{
      const int chosen = {names.name}_nearest(input, tried);
      tried[chosen] = 1;
      start = postures[chosen];
    }}
    memset(&at, 0, sizeof at);
    at.squares[0] = at.squares[1] = at.cost = at.steep = INFINITY;
    at.trust = 1;
    for (i = 0; i < {n}; ++i) {{
      at.q[i] = start[i] < bounds.low[i] ? bounds.low[i] : start[i] > bounds.high[i] ? bounds.high[i] : start[i];
      at.best[i] = at.q[i];
    }}
    for (step = 0; step < {STEPS} && !at.arrived; ++step) {{
      {names.name}_look(parameters, input, &bounds, &at);
      ++looks;
    }}
    if (at.arrived || at.cost < best.cost) {{
      best = at;
    }}
  }}
  /* No answer: on towards the nearest pose, to tell whether there is none. */
  for (k = 0; k < {MORE * STEPS} && !best.arrived && sum == 0; ++k) {{
    {names.name}_look(parameters, input, &bounds, &best);
    ++looks;
  }}
  for (i = 0; i < {n}; ++i) {{
    output->q[i] = best.best[i];
  }}
{turns}
{metres}  turn = sqrt{f}(best.squares[1]) / 2;
  output->position_error = {unit}sqrt{f}(best.squares[0]);
  output->orientation_error = 2 * asin{f}(turn < 1 ? turn : 1);
  output->evaluations = looks;
  status = {word}_OUT_OF_BUDGET;
  if (best.arrived) {{
    status = {word}_SOLVED;
  }} else if (sum != 0) {{
    status = {word}_NON_FINITE;
    for (i = 0; i < {n}; ++i) {{
      output->q[i] = NAN;
    }}
    output->position_error = output->orientation_error = NAN;
  }} else if (far) {{ /* nothing else is known: other postures might lead there */
    status = {word}_OUT_OF_REACH;
  }}
  output->status = status;
  return status;
}}
"""


def _units(reaching, names, inputs) -> tuple:
    """Statements that bring what is given into the chain's unit, and joint values back; nothing where that is 1 m."""
    if reaching.unit == 1.0:
        return "", ""
    c = names.number

    slides = [(i, own) for i, own in enumerate(reaching.own) if own != 1.0]
    lines = [
        f"  {names.type('parameters')} inner = *parameters;",
        f"  {names.type('input')} given = *input;",
        f"  inner.tolerance[0] *= {c(1 / reaching.unit)};",
        *(f"  given.q[{i}] *= {c(1 / own)};" for i, own in slides),
    ]
    for field in inputs:
        if field.name == "position":
            lines += [f"  given.position[{i}] *= {c(1 / reaching.unit)};" for i in range(field.size)]
    lines += ["  parameters = &inner;", "  input = &given;"]
    return "\n".join(lines) + "\n", "".join(f"  output->q[{i}] *= {c(own)};\n" for i, own in slides)
