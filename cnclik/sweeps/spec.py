"""Spec: a question about many loops, as one TOML file.

Everything a loop depends on is a named value. `[fixed]` gives some, `[axes]` varies others, `[cases.NAME]`
holds bundles of them (an arm with its start and target) that make an axis of their own. A value may be an
expression of others: period = "N*Ts", alpha = "z/Ts", target = ["2 - distance", 0].
"""

import dataclasses
import difflib
import json
import pathlib
import tomllib

import numpy as np

from cnclik import errors
from cnclik.integrate.method import METHODS
from cnclik.integrate.solve import evaluations_per_step, solve
from cnclik.law.law import Law
from cnclik.measure import metrics
from cnclik.problem.build import inverse_from, reference_from, robot_from, stage_from, task_from
from cnclik.robot.chain import planar_arm
from cnclik.sweeps import expression
from cnclik.sweeps.sweep import UNITS, Axis, Grid, axis

# --- what may be written ------------------------------------------------------------------------------

NAMES = ("robot", "tip", "base", "task", "reference", "method", "stage", "inverse")  # never expressions
PATHS = {
    "hold": ("target",),
    "line": ("from", "to", "period"),
    "circle": ("center", "radius", "normal", "period"),
    "lissajous": ("center", "amplitude", "frequency", "period"),
}
_PATH = tuple(dict.fromkeys(p for parts in PATHS.values() for p in parts))
PARAMETERS = (
    *(*NAMES, "alpha", "Ts", "N", "M", "q0", "damping", "feedforward", "near_singular", "lengths"),
    *_PATH,
)
REQUIRED = ("robot", "task", "reference", "alpha", "Ts", "N", "q0")
DEFAULTS = {"method": "EE", "stage": "picard", "M": 5}
POSITIVE = ("Ts", "damping", "period", "radius")
KEYS = ("question", "expectation", "tolerance", "lanes", "metrics", "fixed", "axes", "cases", "units", "figure")
AXES = {"linspace": (), "geomspace": (), "range": (), "samples": ("low", "high", "seed")}
FIGURES = {
    "heat": ("value", "x", "y", "boundary", "contours"),
    "best": ("value", "x", "y", "among", "boundary"),
    "slices": ("value", "x", "lines"),
    "convergence": ("value", "lines"),
    "distribution": ("value", "over", "lines"),
    "work": ("value", "lines", "over"),
}
_ROLES = ("x", "y", "lines", "panels", "rows", "over", "among")  # keys of a figure that name an axis
_EVERY_FIGURE = ("kind", "name", "title", "panels", "rows", "select", "reduce", "log", "limits")


def _are_numbers(value, count=None):
    return (
        isinstance(value, list) and len(value) == (count or len(value)) and all(type(v) in (int, float) for v in value)
    )


_FIGURE_TYPES = {  # of a figure's keys that aren't names
    "select": (lambda v: isinstance(v, dict), "be a table of an axis' name and value"),
    "limits": (lambda v: _are_numbers(v, 2), "be [least, greatest]"),
    "contours": (lambda v: isinstance(v, bool) or _are_numbers(v), "be true, false or a list of levels"),
    "log": (lambda v: isinstance(v, bool), "be true or false"),
    "boundary": (lambda v: isinstance(v, bool), "be true or false"),
    "reduce": (lambda v: v in ("median", "mean", "min", "max"), "be median, mean, min or max"),
}


@dataclasses.dataclass(frozen=True)
class Spec:
    """A validated spec. `grid()` is what it runs over, `study` what is run."""

    name: str
    question: str
    expectation: str
    tolerance: float
    lanes: int | None
    metrics: tuple
    fixed: dict
    axes: dict  # name -> Axis
    written: dict  # name -> the axis as written
    cases: dict
    units: dict
    figures: tuple

    def grid(self) -> Grid:
        """The grid over the cases and the axes, in the order written."""
        axes = [axis("case", {name: name for name in self.cases})] if self.cases else []
        found = Grid((*axes, *self.axes.values()), 1)
        size = int(np.prod([len(a) for a in found.inner])) if found.inner else 1
        # Blocks of a power of two that long loops make smaller.
        steps = max((self._steps(p) for p in found.programs), default=1)
        lanes = self.lanes or 2 ** int(np.clip(np.log2(2**21 / max(steps, 1)), 6, 16))
        return dataclasses.replace(found, lanes=min(lanes, size))

    def _steps(self, program):
        return int(self.values(**program, **self._first())["N"])

    def _first(self, last=False) -> dict:
        return {a.name: a.values[-1 if last else 0] for a in self.axes.values() if a.inner}

    def lookup(self, case=None, **values):
        """A function of a name that gives its value in one loop, expressions worked out."""
        known = DEFAULTS | self.fixed | self.cases.get(case, {}) | values
        found = {}

        def look(name):
            if name not in found:
                value = known[name]
                found[name] = value if name in NAMES else expression.evaluate(name, value, look)
            return found[name]

        return known, look

    def values(self, **values) -> dict:
        """All parameters of one loop."""
        known, look = self.lookup(**values)
        return {name: look(name) for name in known if name in PARAMETERS}

    def build(self, **values):
        """Everything `solve` needs for one loop: (law, reference, q0, Ts, N, method, stage)."""
        v = self.values(**values)
        errors.number("Ts", v["Ts"], positive=True)
        chain = _robot(v)
        task = task_from(v["task"], chain)
        q0 = v["q0"]
        if "q0" in self.axes and q0.shape[0] > chain.n:
            q0 = q0[: chain.n]  # samples are as wide as the widest arm among the cases
        q0 = errors.array("q0", q0, (chain.n,))
        law = Law(
            chain,
            task,
            alpha=v["alpha"],
            inverse=inverse_from(v.get("inverse"), v.get("damping")),
            **{name: v[name] for name in ("feedforward", "near_singular") if name in v},
        )
        path = {{"from": "start", "to": "end"}.get(name, name): v[name] for name in _PATH if name in v}
        reference = reference_from(v["reference"], chain, task, q0, horizon=v["N"] * v["Ts"], **path)
        M = self.axes.get("M")
        most = {} if M is None or not M.inner else {"maximum": int(M.values.max())}
        return law, reference, q0, v["Ts"], v["N"], METHODS[v["method"]], stage_from(v["stage"], v["M"], **most)

    def study(self, **values) -> metrics.Metrics:
        """One loop: its metrics. What the sweep batches."""
        law, reference, q0, Ts, N, method, stage = self.build(**values)
        run = solve(law, reference, q0, Ts, N, method, stage)
        return metrics.measure_run(run, law, reference, self.metrics, tolerance=self.tolerance)

    def evaluations(self, program: dict) -> float:
        """Evaluations of f that one lane of a program costs, masked passes included."""
        law, _, _, _, N, method, stage = self.build(**program, **self._first(last=True))
        stage = dataclasses.replace(stage, M=getattr(stage, "maximum", stage.M))
        return N * float(evaluations_per_step(method, stage, law.chain.n))

    def all_units(self) -> dict:
        """Units of the axes, given or known."""
        joints = metrics.unit("q", self.build(**self.grid().programs[0], **self._first())[0])
        known = UNITS | {"q0": joints, "case": "1", "damping": "m", "feedforward": "1", "lengths": "m"}
        known |= {name: "m" for name in ("target", "from", "to", "center", "radius", "amplitude")}
        return known | self.units

    def data(self) -> dict:
        """What the numbers depend on: for JSON, the same for the same data."""
        return {
            "tolerance": self.tolerance,
            "metrics": list(self.metrics),
            "fixed": self.fixed,
            "axes": self.written,
            "cases": self.cases,
        }


def _robot(v):
    if v["robot"] == "planar":
        return planar_arm(v["lengths"])
    return robot_from(v["robot"], v.get("tip"), v.get("base"))


# --- reading ------------------------------------------------------------------------------------------


def read(path, changes=()) -> Spec:
    """Read a spec and validate it whole.

    Args:
      path: of the TOML file.
      changes: strings "name=value" that override it; the value is TOML.

    Raises: ArgumentError, one line, for what can't be read, is unknown (the nearest name is suggested), is
    missing, or can't be built into loops.
    """
    path = pathlib.Path(path)
    try:
        with path.open("rb") as file:
            written = tomllib.load(file)
    except OSError as error:
        raise errors.fail("SPEC", "be a file that can be read", f"{str(path)!r} is not: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise errors.fail("SPEC", "be a TOML file", f"{str(path)!r} is not: {error}") from None
    for change in changes:
        _change(written, change)
    return parse(written, path.stem)


def _change(written, change):
    name, equals, text = change.partition("=")
    name = name.strip()
    if not equals or not name:
        raise errors.fail("set", "be NAME=VALUE", f"is {change!r}")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a bare word, such as CN, or an expression
    head, _, rest = name.partition(".")
    if head in ("fixed", "axes", "units") and rest:
        room, name = head, rest
    elif head == "cases" and rest.count(".") == 1:
        case, name = rest.split(".")
        written.setdefault("cases", {}).setdefault(case, {})[name] = value
        return
    elif name in KEYS:
        written[name] = value
        return
    else:
        room = "axes" if name in written.get("axes", {}) and isinstance(value, (list, dict)) else "fixed"
    written.setdefault(room, {})[name] = value
    if room in ("fixed", "axes"):
        taken = written.get("axes" if room == "fixed" else "fixed", {}).pop(name, None)
        if room == "fixed" and taken is not None and isinstance(written.get("figure"), list):
            # Figures over an axis that is gone go with it.
            written["figure"] = [f for f in written["figure"] if not isinstance(f, dict) or name not in _dims_named(f)]


def _dims_named(figure) -> set:
    return {figure.get(k) for k in _ROLES} | set(figure.get("select", ()))


def parse(written: dict, name="spec") -> Spec:
    """A spec from what a TOML file holds; see `read`."""
    _known("SPEC", written, KEYS)
    for key in ("question", "expectation"):
        if not isinstance(written.get(key), str) or not written[key].strip():
            raise errors.fail(key, "be a sentence", "is missing" if key not in written else f"is {written[key]!r}")
    fixed, axes = _table(written, "fixed"), _table(written, "axes")
    cases = {name: _table(_table(written, "cases"), name, "cases.") for name in _table(written, "cases")}
    for both in fixed.keys() & axes.keys():
        raise errors.fail(f"axes.{both}", "not be in [fixed] as well", "is in both")
    _check_names(fixed, axes, cases)
    widest = 0
    if isinstance(axes.get("q0"), dict):
        # Every robot there may be: starts are sampled for the widest, each arm takes what it has joints for.
        robots = [DEFAULTS | fixed | c for c in (cases.values() or [{}])]
        choices = axes.get("robot", [None])
        widest = max(_robot(_plain(r | ({"robot": c} if c else {}))).n for r in robots for c in choices)
    units = _table(written, "units")
    for named, unit in units.items():
        if not isinstance(unit, str):
            raise errors.fail(f"units.{named}", "be a unit's name", f"is {unit!r}")
    spec = Spec(
        name=name,
        question=written["question"].strip(),
        expectation=written["expectation"].strip(),
        tolerance=float(errors.number("tolerance", written.get("tolerance", 1e-3), positive=True)),
        lanes=errors.integer("lanes", written["lanes"], at_least=1) if "lanes" in written else None,
        metrics=_metrics(written.get("metrics", list(metrics.DEFAULT))),
        fixed=fixed,
        axes={n: _axis(n, v, widest) for n, v in axes.items()},
        written=axes,
        cases=cases,
        units=units,
        figures=(),
    )
    spec = dataclasses.replace(spec, axes=_compiled_in(spec))
    _check_loops(spec)
    return dataclasses.replace(spec, figures=_figures(written.get("figure", []), spec))


def _plain(values):
    """Values with numbers where they can be had, to build a robot from."""
    return {
        k: v if k in NAMES else expression.evaluate(k, v, values.get)
        for k, v in values.items()
        if k == "lengths" or k in NAMES
    }


def _known(where, table, names):
    for key in table:
        if key not in names:
            raise _unknown(where, key, names)


def _unknown(where, key, names):
    near = difflib.get_close_matches(key, list(names), n=1, cutoff=0.4)
    hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
    return errors.ArgumentError(f"Argument `{where}` must hold known keys, but holds {key!r} ({hint}).")


def _table(parent, key, prefix=""):
    table = parent.get(key, {})
    if not isinstance(table, dict):
        raise errors.fail(prefix + key, "be a table", f"is {table!r}")
    return dict(table)


def _metrics(names):
    if not isinstance(names, list) or not names:
        raise errors.fail("metrics", "be a list of names", f"is {names!r}")
    for name in names:
        errors.one_of("metrics", name, metrics.METRICS)
    return tuple(dict.fromkeys(names))


def _axis(name, value, widest) -> Axis:
    where = f"axes.{name}"
    if isinstance(value, list):
        if name in NAMES:
            return (
                axis(name, {v: v for v in value})
                if all(isinstance(v, str) for v in value)
                else _not_names(where, value)
            )
        if name == "M" and all(type(v) is int for v in value) and value:
            return Axis(name, np.asarray(value), None)  # one program, passes masked
        if all(type(v) in (int, float) for v in value) and value and name != "N":
            return Axis(name, np.asarray(value, float), None)
        try:
            return axis(where, value)._replace(name=name)
        except (TypeError, ValueError) as error:
            if isinstance(error, errors.ArgumentError):
                raise
            raise errors.fail(where, "be a list of numbers, vectors or names", f"is {value!r}") from None
    if not isinstance(value, dict) or len(found := [k for k in AXES if k in value]) != 1:
        raise errors.fail(where, f"be a list or a table with one of {', '.join(AXES)}", f"is {value!r}")
    kind = found[0]
    _known(where, value, (kind, *AXES[kind]))
    if kind == "samples":
        return Axis(name, _samples(where, value, widest if name == "q0" else 0), None)
    numbers = value[kind]
    if kind == "range":
        if not isinstance(numbers, list) or len(numbers) != 2 or any(type(v) is not int for v in numbers):
            raise errors.fail(where, "be range = [first, last] of two integers", f"is {numbers!r}")
        return _axis(name, list(range(numbers[0], numbers[1] + 1)), widest)
    if not isinstance(numbers, list) or len(numbers) != 3 or type(numbers[2]) is not int or numbers[2] < 1:
        raise errors.fail(where, f"be {kind} = [first, last, count]", f"is {numbers!r}")
    first, last = (_numbers(where, v) for v in numbers[:2])
    if first.shape != last.shape:
        raise errors.fail(where, "have ends of one shape", f"is {numbers!r}")
    if kind == "geomspace" and not (np.all(first * last > 0)):
        raise errors.fail(where, "have ends of one sign, not 0, for geomspace", f"is {numbers!r}")
    return Axis(name, getattr(np, kind)(first, last, numbers[2]), None)


def _not_names(where, value):
    raise errors.fail(where, "be a list of names", f"is {value!r}")


def _numbers(where, value):
    """A number or vector, expressions of pi included."""
    for name in expression.names(where, value):
        raise errors.fail(where, "be numbers", f"refers to {name!r}")
    return np.asarray(expression.evaluate(where, value, None), float)


def _samples(where, value, widest):
    count = errors.integer(f"{where}.samples", value["samples"], at_least=1)
    seed = errors.integer(f"{where}.seed", value.get("seed", 0), at_least=0)
    low, high = (_numbers(f"{where}.{k}", value.get(k, default)) for k, default in (("low", 0.0), ("high", 1.0)))
    if low.ndim > 1 or high.ndim > 1 or not np.all(low <= high):
        raise errors.fail(where, "have low ≤ high", f"is {value!r}")
    shape = np.broadcast_shapes(low.shape, high.shape, (widest,) if widest else ())
    return low + (high - low) * np.random.default_rng(seed).random((count, *shape))


# --- validating ---------------------------------------------------------------------------------------


def _check_names(fixed, axes, cases):
    """Every name is a parameter or used by an expression; every name used is defined."""
    for where, table in (("fixed", fixed), *((f"cases.{c}", t) for c, t in cases.items())):
        for name, value in table.items():
            if not isinstance(value, (str, int, float, list)) or isinstance(value, bool):
                raise errors.fail(f"{where}.{name}", "be a number, a name, an expression or a list", f"is {value!r}")
    everywhere = set(fixed) | set(axes) | set(DEFAULTS)
    shared = set.intersection(*(set(c) for c in cases.values())) if cases else set()
    used = set()
    for table in (fixed, *cases.values()):
        for name, value in table.items():
            if name in NAMES:
                continue
            needs = expression.names(name, value)
            used |= needs
            for need in needs - everywhere - (set(table) if table is not fixed else shared):
                near = difflib.get_close_matches(need, sorted(everywhere | set(table)), n=1, cutoff=0.4)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                raise errors.fail(name, "use names that have a value", f"uses {need!r}{hint}")
    for where, table in (("fixed", fixed), ("axes", axes), *((f"cases.{c}", t) for c, t in cases.items())):
        for name in table:
            if name not in PARAMETERS and name not in used:
                raise _unknown(where, name, (*PARAMETERS, *sorted(used)))
    for case, table in cases.items() or [("", {})]:
        missing = [n for n in REQUIRED if n not in fixed and n not in axes and n not in table]
        if missing:
            where = f"cases.{case}" if case else "fixed"
            raise errors.fail(where, f"give {', '.join(missing)}", "does not (nor do [axes])")
        both = set(table) & set(axes)
        if both:
            raise errors.fail(f"axes.{min(both)}", "not be given by a case as well", f"is given by {case!r}")
    _check_cycles(fixed, cases)


def _check_cycles(fixed, cases):
    for table in cases.values() or [{}]:
        known = fixed | table

        def walk(name, seen, known=known):
            if name in seen:
                raise errors.fail(name, "not depend on itself", f"does, through {' -> '.join([*seen, name])}")
            value = known.get(name)
            if name not in NAMES and value is not None:
                for need in expression.names(name, value):
                    walk(need, [*seen, name])

        for name in known:
            walk(name, [])


def _compiled_in(spec: Spec) -> dict:
    """Axes on which the number of steps depends run as one program per value."""
    wanted, queue = set(), ["N", *NAMES]
    tables = (spec.fixed, *spec.cases.values())
    while queue:
        name = queue.pop()
        wanted.add(name)
        for table in tables:
            if name in table and name not in NAMES:
                queue += [n for n in expression.names(name, table[name]) if n not in wanted]
    out = {}
    for name, one in spec.axes.items():
        if one.inner and name in wanted:
            if one.values.ndim != 1:
                raise errors.fail(f"axes.{name}", "hold single numbers where N depends on it", "holds vectors")
            values = tuple(v.item() for v in one.values)
            one = Axis(name, values, values)
        out[name] = one
    return out


def _check_loops(spec: Spec):
    """Build the first and the last loop of every case and of every value of the outer axes."""
    for name, one in spec.axes.items():
        if name in POSITIVE and not np.all(np.asarray(one.values) > 0):
            raise errors.fail(f"axes.{name}", "hold positive values", f"holds {np.min(np.asarray(one.values)):g}")
        if one.inner and not np.all(np.isfinite(one.values)):
            raise errors.fail(f"axes.{name}", "hold finite values", "does not")
        if name == "M" and np.min(np.asarray(one.values)) < 0:
            raise errors.fail("axes.M", "hold values of at least 0", f"holds {np.min(np.asarray(one.values))}")
    outer = {a.name: a.values for a in spec.axes.values() if not a.inner}
    if spec.cases:
        outer = {"case": tuple(spec.cases)} | outer
    base = {name: values[0] for name, values in outer.items()}
    tried = [base] + [base | {name: v} for name, values in outer.items() for v in values[1:]]
    for program in tried:
        for last in (False, True):
            _check_loop(spec, {**program, **spec._first(last=last)})


def _check_loop(spec, values):
    known, _ = spec.lookup(**values)
    errors.one_of("method", known["method"], METHODS)
    errors.one_of("reference", known["reference"], PATHS)
    wanted = PATHS[known["reference"]]
    for name in _PATH:
        if name in known and name not in wanted:
            raise errors.fail(name, f"belong to the reference {known['reference']!r} ({', '.join(wanted)})", "does not")
    if ("lengths" in known) != (known["robot"] == "planar"):
        raise errors.fail("lengths", "come with robot = 'planar', and only with it", f"robot is {known['robot']!r}")
    law, reference, q0, Ts, N, method, stage = spec.build(**values)
    from cnclik.integrate import solve as solving

    errors.integer("N", N, at_least=1)
    solving._arguments(law, reference, q0, Ts, method, stage)
    metrics.check(spec.metrics, law)


def _figures(figures, spec: Spec) -> tuple:
    if not isinstance(figures, list):
        raise errors.fail("figure", "be a list of tables, [[figure]]", f"is {figures!r}")
    dims = [a.name for a in spec.grid().axes]
    for i, figure in enumerate(figures):
        where = f"figure[{i}]"
        if not isinstance(figure, dict):
            raise errors.fail(where, "be a table", f"is {figure!r}")
        for key, value in figure.items():
            fits, words = _FIGURE_TYPES.get(key, (lambda v: isinstance(v, str), "be a name"))
            if not fits(value):
                raise errors.fail(f"{where}.{key}", words, f"is {value!r}")
        kind = errors.one_of(f"{where}.kind", figure.get("kind"), FIGURES)
        _known(where, figure, (*_EVERY_FIGURE, *FIGURES[kind]))
        if "value" in figure:
            errors.one_of(f"{where}.value", figure["value"], spec.metrics)
        for key in _ROLES:
            if key in figure:
                errors.one_of(f"{where}.{key}", figure[key], dims)
        for key in figure.get("select", {}):
            errors.one_of(f"{where}.select", key, dims)
    return tuple(figures)


def to_json(spec: Spec) -> str:
    """The spec as one line of JSON, for a dataset's attributes."""
    about = {"name": spec.name, "question": spec.question, "expectation": spec.expectation}
    return json.dumps(about | spec.data() | {"figures": spec.figures}, ensure_ascii=False)
