"""Reach source: the search of `cnclik.reach` for one target: reaching/c/search.c with a few of its seeds.

It starts from the current posture, then from the nearest seed of each set in turn, then from any seed. If no try
arrives, it descends to the nearest pose. Lengths inside are in the chain's own unit, see `reaching.units`.
"""

from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.engine.routine import INT, Field, Routine
from cnclik.export.cost import operations
from cnclik.export.source import Names, signature, statements
from cnclik.export.trace import Request, targets
from cnclik.reaching import asked, strategy
from cnclik.reaching.native import lanes_of, look_of, search_source
from cnclik.reaching.seeds import SETS, SIZE, compared, seeds
from cnclik.reaching.targets import WIDTH, aims, of_tips
from cnclik.reaching.units import of_joints
from cnclik.robot.chain import REVOLUTE
from cnclik.robot.posture import arm_length

SEEDS = 64  # default number of postures in the source
SHIPPED = (4, 3, 2, 1)  # number of sets: the first that divides the number of postures
TOLERANCE = (1e-6, 1e-6)  # [m], [rad]
LEAST = 64.0  # smallest tolerance, in roundings


class Reaching(NamedTuple):
    asked: asked.Asked  # in the chain's own unit
    look: Routine  # one evaluation and step of the search
    call: Routine  # arguments and results of the exported function, without a graph
    postures: np.ndarray  # (K, n) start postures
    features: np.ndarray  # (aims, sets, 13, K / sets) their tips, in the form of `seeds.Compared`
    before: tuple[str, ...]  # prefix of the names of each aim's arguments


def trace_reach(request: Request, count: int) -> Reaching:
    """The evaluation and the tables. Raises: ArgumentError, `UnsupportedError` naming what has no C form."""
    errors.integer("seeds", count, at_least=1, at_most=SETS * SIZE)
    law, least = request.law, LEAST * np.finfo(request.dtype).eps
    search = asked.asked_of(
        law.chain, of_tips(law.task), TOLERANCE, None, None, count + 1, strategy.ENDLESS, 0, True, True
    )
    chain, task, sets = search.chain, search.task, next(sets for sets in SHIPPED if count % sets == 0)
    n, every, units = chain.n, aims(task), ", ".join(dict.fromkeys(law.chain.units))
    before = tuple(word for word, parts in targets(law.task) if hasattr(parts.parts[0], "axes"))
    features = compared(chain, task).features.transpose(0, 1, 3, 2).reshape(len(every), -1, 13)[:, :count]
    parameters = [
        Field("tolerance", (2,), about="of position [m] and orientation [rad]", value=np.maximum(TOLERANCE, least)),
        Field("tries", (), INT, about="starts, at most", value=count + 1),
    ]
    given = [Field("q", (n,), about=f"joint values to search from first, such as where the arm is [{units}]")]
    for word, aim in zip(before, every, strict=True):
        of, p = f" of {word[:-1]}" if word else "", len(aim.linear)
        about = f"the target's{of}, in the task's coordinates [m]"
        given += [Field(f"{word}position", (p,), about=about)] * bool(p)
        turn = Field(f"{word}rotation", (3, 3), about=f"the target's{of}, row by row", value=np.eye(3))
        given += [turn] * bool(aim.angular)
    results = [
        Field("q", (n,), about=f"joint values of the answer, else of the nearest pose found [{units}]"),
        Field("position_error", (), about="[m]"),
        Field("orientation_error", (), about="[rad]"),
        Field("evaluations", (), INT, "looks at a posture that it took"),
        Field("status", (), INT, "how it went"),
    ]
    return Reaching(
        asked=search,
        look=look_of(chain, task, request.dtype),
        call=Routine({"parameters": parameters, "input": given, "history": []}, {"output": results}),
        postures=seeds(chain).postures[:count],
        features=features.reshape(len(every), sets, -1, 13).transpose(0, 1, 3, 2),
        before=before,
    )


def most_operations(reaching: Reaching) -> dict:
    tries = reaching.call.inputs["parameters"][-1].value
    looks = tries * (strategy.CAREFUL + strategy.SLOW) + strategy.PLACES * strategy.DOWNHILL
    return {what: count * looks for what, count in operations(reaching.look).items()}


def reach_source(reaching: Reaching, names: Names) -> tuple:
    """The text of all functions, and the `functions` for `helpers`."""
    of, (_, sets, _, size) = reaching.asked, reaching.features.shape
    lines, used = statements(reaching.look, names, lambda _, f: f"s->{f.name}")
    defined = {"W": 1, "LANE(v, i)": "(*(&(v) + (i)))", "SPLAT(x)": "(x)", "ENTRY": "static"}
    defined["LIBM(name)"] = f"name##{names.suffix}" if names.suffix else "name"
    look = "\n".join(["static void look(Lanes *s)", "{", *lines, "}", ""])
    search = search_source(of.chain, of.task, names.real, sets, size, 1, defined)
    return "\n".join([lanes_of(reaching.look, names.real, "int32_t"), look, search, _call(reaching, names)]), used


def _call(reaching, names) -> str:
    of, c, known, bit = reaching.asked, names.number, seeds(reaching.asked.chain), names.name.upper()
    (lower, upper), own = of.limited(), np.array(of_joints(of.chain, of.unit))
    roots = np.sqrt(np.asarray(of.task.weight_of_each, float))
    tables = {"lower": lower, "upper": upper, "jump": np.full(of.chain.n, np.inf), "periods": of.periods}
    tables |= {"turns": of.turns(), "middle": known.middle, "width": known.width, "roots": roots}
    tables |= {"postures": reaching.postures, "own": own}
    factors = compared(of.chain, of.task).factors
    written = [_table(names, "Real", name, values) for name, values in tables.items()]
    written += [_table(names, "float", name, v) for name, v in (("features", reaching.features), ("factors", factors))]
    pose = []
    for a, (word, aim) in enumerate(zip(reaching.before, aims(of.task), strict=True)):
        at = WIDTH * a
        pose += [f"  pose[{at + i}] = input->{word}position[{k}] * {c(1 / of.unit)};" for k, i in enumerate(aim.linear)]
        turn = f"input->{word}rotation[i]" if aim.angular else "i % 4 == 0"
        pose.append(f"  for (int i = 0; i < 9; ++i) pose[{at + 3} + i] = {turn};")
    arrays = {name: name for name in (*tables, "features", "factors", "pose", "near") if name != "own"}
    arrays |= {"low": "lower", "high": "upper", "made": "&made"}
    pointers = [f"  a.{name} = {value};" for name, value in arrays.items()]
    return f"""{signature(reaching.call, names)}
{{
{chr(10).join(written)}
  Real pose[12 * AIMS] = {{0}}, near[N], row[2 * N + 5];
  Found made;
  Asked a;
  int far = 0;
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
  /* Beyond the arm's length nothing else is known: other postures might lead there. */
  output->status = made.looks == 0 ? {bit}_NON_FINITE : made.found != 0 ? {bit}_SOLVED
    : far ? {bit}_OUT_OF_REACH : {bit}_OUT_OF_BUDGET;
  return output->status;
}}
"""


def _table(names, real, name, values) -> str:
    rows = np.asarray(values, float).reshape(-1, np.shape(values)[-1]).tolist()
    lines = ",\n    ".join(", ".join(map(names.number, row)) for row in rows)
    return f"  static const {real} {name}[] = {{{lines}}};"


def _far(reaching, names) -> str:
    """Statements that test whether a target is farther from the first joint than the stretched arm is long."""
    of, c, lines = reaching.asked, names.number, []
    least, chain = LEAST * np.finfo(names.dtype).eps, reaching.asked.chain
    for a, aim in enumerate(aims(of.task)):
        number = chain.tip_number(aim.tip)
        way = [chain.joints[i] for i in chain.way(number)]
        if not aim.linear or aim.to is not None or not all(joint.kind == REVOLUTE for joint in way):
            continue
        center, length = way[0].origin.position, c((1 + least) * float(arm_length(chain, number=number)))
        off = [f"(pose[{WIDTH * a + k}] - {c(float(center[k]))})" for k in aim.linear]
        away = " + ".join(f"{one} * {one}" for one in off).replace("- -", "+ ")
        lines.append(f"  far |= LIBM(sqrt)({away}) > {length} + a.tolerance[0];")
    return "\n".join(lines)
