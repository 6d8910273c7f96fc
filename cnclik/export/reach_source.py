"""Reach source: the search of `cnclik.reach` for one target: reaching/c/search.c, with a few of its seeds.

From where the arm is, then from the nearest seed of ever another set, then from any; where no try arrives, downhill to
the nearest pose. Lengths are in the chain's own unit inside, see `reaching.units`.
"""

from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.engine.routine import INT, Field, Routine
from cnclik.export.cost import operations
from cnclik.export.source import Names, signature, statements
from cnclik.export.trace import Request
from cnclik.reaching import asked, strategy
from cnclik.reaching.native_source import lanes_of, look_of, search_source
from cnclik.reaching.seeds import SETS, SIZE, compared, seeds
from cnclik.reaching.units import of_joints
from cnclik.robot.chain import REVOLUTE, with_one_tip
from cnclik.robot.posture import arm_length

SEEDS = 64  # postures that are written into the source, by default
SHIPPED = (4, 3, 2, 1)  # sets of them: the first that so many can be dealt out to
TOLERANCE = (1e-6, 1e-6)  # [m], [rad]
LEAST = 64.0  # roundings, that a tolerance is at least


class Reaching(NamedTuple):
    """What the C is written from."""

    asked: asked.Asked  # in the chain's own unit
    look: Routine  # of a lane of the search: look, and step on
    call: Routine  # what the exported function takes and gives, without a graph
    postures: np.ndarray  # (K, n) to start from
    features: np.ndarray  # (sets, 13, K / sets) their tips, as `seeds.Compared` has them


def trace_reach(request: Request, count: int) -> Reaching:
    """The look and the tables. Raises: ArgumentError, `UnsupportedError` naming what has no C form."""
    errors.integer("seeds", count, at_least=1, at_most=SETS * SIZE)
    law, least = request.law, LEAST * np.finfo(request.dtype).eps
    with_one_tip(law.chain)
    search = asked.asked_of(law.chain, law.task, TOLERANCE, None, None, count + 1, strategy.ENDLESS, 0, True, True)
    chain, task, sets = search.chain, search.task, next(sets for sets in SHIPPED if count % sets == 0)
    n, p, turned, units = chain.n, len(task.position), bool(task.orientation), ", ".join(dict.fromkeys(law.chain.units))
    features = compared(chain, task).features[0].transpose(0, 2, 1).reshape(-1, 13)[:count]
    parameters = [
        Field("tolerance", (2,), about="of position [m] and orientation [rad]", value=np.maximum(TOLERANCE, least)),
        Field("tries", (), INT, about="starts, at most", value=count + 1),
    ]
    given = [Field("q", (n,), about=f"joint values to search from first, such as where the arm is [{units}]")]
    given += [Field("position", (p,), about="the target's, in the task's coordinates [m]")] * bool(p)
    given += [Field("rotation", (3, 3), about="the target's, row by row", value=np.eye(3))] * turned
    told = [
        Field("q", (n,), about=f"joint values of the answer, else of the nearest pose found [{units}]"),
        Field("position_error", (), about="[m]"),
        Field("orientation_error", (), about="[rad]"),
        Field("evaluations", (), INT, "looks at a posture that it took"),
        Field("status", (), INT, "how it went"),
    ]
    return Reaching(
        asked=search,
        look=look_of(chain, task, request.dtype),
        call=Routine({"parameters": parameters, "input": given, "history": []}, {"output": told}),
        postures=seeds(chain).postures[:count],
        features=features.reshape(sets, -1, 13).transpose(0, 2, 1),
    )


def most_operations(reaching: Reaching) -> dict:
    """Operations of a call at most."""
    tries = reaching.call.inputs["parameters"][-1].value
    looks = tries * (strategy.CAREFUL + strategy.SLOW) + strategy.PLACES * strategy.DOWNHILL
    return {what: count * looks for what, count in operations(reaching.look).items()}


def reach_source(reaching: Reaching, names: Names) -> tuple:
    """The text of all functions, and what `helpers` are for."""
    of, (sets, _, size) = reaching.asked, reaching.features.shape
    lines, used = statements(reaching.look, names, lambda _, f: f"s->{f.name}")
    told = {"W": 1, "LANE(v, i)": "(*(&(v) + (i)))", "SPLAT(x)": "(x)", "ENTRY": "static"}
    told["LIBM(name)"] = f"name##{names.suffix}" if names.suffix else "name"
    look = "\n".join(["static void look(Lanes *s)", "{", *lines, "}", ""])
    search = search_source(of.chain, of.task, names.real, sets, size, 1, told)
    return "\n".join([lanes_of(reaching.look, names.real, "int32_t"), look, search, _call(reaching, names)]), used


def _call(reaching, names) -> str:
    """The exported function."""
    of, c, known = reaching.asked, names.number, seeds(reaching.asked.chain)
    (lower, upper), own = of.limited(), np.array(of_joints(of.chain, of.unit))
    roots = np.sqrt(np.asarray(of.task.weight_of_each, float))
    tables = {"lower": lower, "upper": upper, "jump": np.full(of.chain.n, np.inf), "periods": of.periods}
    tables |= {"turns": of.turns(), "middle": known.middle, "width": known.width, "roots": roots}
    tables |= {"postures": reaching.postures, "own": own}
    factors = compared(of.chain, of.task).factors[0]
    written = [_table(names, "Real", name, values) for name, values in tables.items()]
    written += [_table(names, "float", name, v) for name, v in (("features", reaching.features), ("factors", factors))]
    pose = [f"  pose[{axis}] = input->position[{k}] * {c(1 / of.unit)};" for k, axis in enumerate(of.task.linear)]
    if of.task.orientation:
        pose.append("  for (int i = 0; i < 9; ++i) pose[3 + i] = input->rotation[i];")
    arrays = {name: name for name in (*tables, "features", "factors", "pose", "near") if name != "own"}
    arrays |= {"low": "lower", "high": "upper", "made": "&made"}
    pointers = [f"  a.{name} = {value};" for name, value in arrays.items()]
    return f"""{signature(reaching.call, names)}
{{
{chr(10).join(written)}
  Real pose[12] = {{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}}, near[N], row[2 * N + 5], away = 0;
  Found made;
  Asked a;
  int far;
  memset(&a, 0, sizeof a);
  memset(&made, 0, sizeof made);
{chr(10).join(pose + pointers)}
  a.tolerance[0] = parameters->tolerance[0] * {c(1 / of.unit)};
  a.tolerance[1] = 2 * LIBM(sin)(least(parameters->tolerance[1], {c(np.pi)}) / 2);
  for (int i = 0; i < N; ++i) near[i] = input->q[i] / own[i];
{_far(reaching, names)}
  a.tries = parameters->tries > 1 ? parameters->tries : 1;
  if (far && a.tries > {strategy.FIRST}) a.tries = {strategy.FIRST};
  a.budget = {strategy.ENDLESS};
  search(&a, 0, 1);
  if (made.found == 0) {{ /* on to the nearest pose */
    a.downhill = {strategy.DOWNHILL};
    a.tries = PLACES;
    search(&a, 0, 1);
  }}
  a.rows = row;
  tell(&a, 0);
  for (int i = 0; i < N; ++i) output->q[i] = made.looks > 0 ? row[i] * own[i] : NAN;
  output->position_error = made.looks > 0 ? row[N + 1] * {c(of.unit)} : NAN;
  output->orientation_error = made.looks > 0 ? row[N + 2] : NAN;
  output->evaluations = (int32_t)made.looks;
  output->status = {names.name.upper()}_OUT_OF_BUDGET;
  if (made.looks == 0) {{
    output->status = {names.name.upper()}_NON_FINITE;
  }} else if (made.found != 0) {{
    output->status = {names.name.upper()}_SOLVED;
  }} else if (far) {{ /* nothing else is known: other postures might lead there */
    output->status = {names.name.upper()}_OUT_OF_REACH;
  }}
  return output->status;
}}
"""


def _table(names, real, name, values) -> str:
    rows = np.asarray(values, float).reshape(-1, np.shape(values)[-1]).tolist()
    lines = ",\n    ".join(", ".join(map(names.number, row)) for row in rows)
    return f"  static const {real} {name}[] = {{{lines}}};"


def _far(reaching, names) -> str:
    """Statements that tell whether the target is farther from the first joint than the stretched arm is long."""
    of, c = reaching.asked, names.number
    if not all(joint.kind == REVOLUTE for joint in of.chain.joints):
        return "  far = away > 0;"
    least, center = LEAST * np.finfo(names.dtype).eps, of.chain.joints[0].origin.position
    lines = [
        f"  away += (pose[{k}] - {c(float(center[k]))}) * (pose[{k}] - {c(float(center[k]))});" for k in of.task.linear
    ]
    length = c((1 + least) * float(arm_length(of.chain)))
    return "\n".join([*lines, f"  far = LIBM(sqrt)(away) > {length} + a.tolerance[0];"]).replace("- -", "+ ")
