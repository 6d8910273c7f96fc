"""Spec: a study of many loops, as one TOML file.

Everything a loop depends on is a named value, by the names of `problem_from`'s arguments. `[fixed]` gives some values,
`[axes]` varies others. An axis is a list, a table such as { geomspace = [1, 40, 20] }, or tables [axes.AXIS.LABEL] of
values that belong together: an arm with its start and its target. A value may be an expression of others: period =
"N*Ts", alpha = "z/Ts", target = ["2 - distance", 0]. `limit` is linear theory's largest stable z = alpha·Ts of the
loop's method, stage and drive: alpha = "0.5*limit/Ts".
"""

import contextlib
import dataclasses
import functools
import itertools
import json
import math
import os
import pathlib
import tomllib
import zlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.measure.dataset import provenance
from cnclik.measure.metrics import DEFAULT, Metrics, measure_run, unit_of
from cnclik.measure.metrics import check as check_metrics
from cnclik.problem import options
from cnclik.problem.build import Problem, problem_from
from cnclik.problem.names import load, stage_from
from cnclik.problem.reference import OPTIONS as OF_PATHS
from cnclik.reading import read_toml
from cnclik.stability.advice import mixed
from cnclik.stability.maps import largest_stable
from cnclik.sweeps import axes as forms
from cnclik.sweeps.axes import COMPILED_IN, NAMES, Axis, compiled_in, known_keys
from cnclik.sweeps.grid import UNITS, Grid

LIMIT, Z = "limit", "alpha_Ts"  # coordinates of the data: the largest stable z, and z
KEYS: dict[str, Any] = {"question": "", "expectation": "", "tolerance": 1e-3, "lanes": 0, "metrics": [*DEFAULT]}
KEYS |= {"fixed": {}, "axes": {}, "units": {}, "figure": []}  # of a spec, with their defaults
WORDS: dict[Any, str] = {str: "be a text", list: "be a list", dict: "be a table"}
FILES = ("robot", "reference")  # options that may name a file
COUNTS = ("M", "seed")  # on an axis of their own they need not be compiled in
PIECES = 8  # blocks of a program, at least, if there are enough lanes
OPTIONS = options.OPTIONS
WHOLE = {name for name, option in OPTIONS.items() if option.kind == options.INTEGER}
DEFAULTS = options.DEFAULTS | {"delay": 0, "measurement_delay": 0}
TIMED = {"lag", "natural_frequency", "cutoff"}  # options of a drive with which the largest stable z depends on Ts
DIGITS = 10  # to which the limit is accurate, and equal on every machine
MOST = {LIMIT: 1000, "alpha": 10_000, "Ts": 10_000}  # values that are looked at: a limit takes some milliseconds


@dataclasses.dataclass(frozen=True)
class Spec:
    """A checked spec. `grid()` is what it runs over, `study` what runs at each point."""

    name: str  # of the file
    question: str  # as written, as are expectation, fixed, units and figures
    expectation: str
    tolerance: float  # largest final error of a loop that has converged [m, rad]
    lanes: int  # 0: chosen by `grid`
    metrics: tuple  # names of what is measured
    fixed: dict
    written: dict  # {axis: as written}
    tables: dict  # {axis: {label: {name: value}}}, of axes of tables
    units: dict
    figures: list
    folder: pathlib.Path  # where files named in the spec are searched first
    axes: tuple = ()  # of `Axis`, those of tables first
    metric_units: dict = dataclasses.field(default_factory=dict)  # where loops differ in one, all of theirs
    limited: bool = True  # whether theory gives a largest stable z: not where drives and gains differ

    def grid(self) -> Grid:
        """Return the axes, cut into blocks: a power of two, smaller for long loops, enough to keep the cores busy."""
        of = Grid(self.axes, more=self.draws)
        steps = max(int(self.loop(program)["N"]) for program in of.programs)
        size = int(np.prod([len(a) for a in of.inner], dtype=float))
        lanes = self.lanes or 2 ** int(np.clip(np.log2(min(2**21 / max(steps, 1), size / PIECES)), 6, 16))
        return dataclasses.replace(of, lanes=min(lanes, size))

    def loop(self, values: dict, end=np.argmin, column=0) -> "Loop":
        """Return the values of one loop. Args: values: of axes; of numeric ones the least, or the end=np.argmax, of
        vectors by a column."""
        inner = [(a, a.values.reshape(len(a), -1).T) for a in self.axes if a.inner]
        ends = {a.name: a.values[end(columns[column % len(columns)])] for a, columns in inner}
        return Loop(self, ends | values)

    def study(self, /, draws=None, **values) -> Metrics:
        """Return the metrics of one loop. The sweep batches this function. Args: draws: see `Spec.draws`."""
        problem = self.loop(values).build()
        run = problem.run(draws)
        tolerance, drive = self.tolerance, problem.drive
        values = measure_run(run, problem.law, problem.reference, self.metrics, tolerance=tolerance, drive=drive)
        return Metrics(values.values(), self.metric_units)

    def draws(self, program: dict, lanes: dict) -> dict:
        """Return the standard normal numbers (lanes, N, m) of noise whose seed is an axis."""
        if "seed" not in lanes or (problem := self.loop(program).build()).noise is None:
            return {}
        seeds, which = np.unique(lanes["seed"], return_inverse=True)
        size = problem.N, problem.law.task.m
        return {"draws": np.stack([np.random.default_rng(int(seed)).standard_normal(size) for seed in seeds])[which]}

    @property
    def drawn(self) -> list:
        """The axes of samples: a value per joint of whichever robot."""
        return [axis for axis, value in self.written.items() if isinstance(value, dict) and "samples" in value]

    def programs(self):
        """Yield the combinations of tables and expressions, and what differs from the first along one other outer axis.

        A table or an expression may give another one names to use, and only together may they use an axis.
        """
        outer = Grid(self.axes).outer if self.axes else ()  # refuses too many
        first = {a.name: a.values[0] for a in outer}
        using = [a for a in outer if a.name not in NAMES and isinstance(a.values[0], str)]
        for values in itertools.product(*(a.values for a in using)):
            yield first | dict(zip([a.name for a in using], values, strict=True))
        yield from (first | {a.name: value} for a in outer if a not in using for value in a.values[1:])

    def needs(self, *names) -> set:
        """Return the names that some values depend on, these included."""
        used: set = set()
        for loop in map(self.loop, self.programs()):
            for name in names:
                if name in loop.given or name == LIMIT:
                    loop[name]
            used |= set(loop)
        return used

    def all_units(self) -> dict:
        """Return the units of the axes, given or known."""
        joints = ", ".join(dict.fromkeys(self.loop(next(self.programs())).build().law.chain.units))
        known = {name: {"q": joints, "x": "m"}.get(option.unit, option.unit) for name, option in OPTIONS.items()}
        return known | UNITS | dict.fromkeys(self.tables, "1") | self.units

    def places(self) -> dict:
        """Return the tables that give values, {name of the table: {name: value}}."""
        of_axes = {f"axes.{axis}.{label}": t for axis, labels in self.tables.items() for label, t in labels.items()}
        return {"fixed": self.fixed} | of_axes

    def data(self) -> dict:
        """Return what the numbers depend on, for JSON; equal for equal data."""
        about = {"tolerance": self.tolerance, "metrics": list(self.metrics), "fixed": self.fixed}
        about["axes"] = self.tables | self.written
        named = [table[name] for table in self.places().values() for name in FILES if name in table]
        named += [value for axis in self.axes if axis.name in FILES for value in axis.values]
        files = {str(text): zlib.crc32(path.read_bytes()) for text in named if (path := self.file(text))}
        return about | ({"files": files} if files else {})

    def fingerprint(self) -> dict:
        """Return what a block's numbers depend on, as JSON returns it."""
        return json.loads(json.dumps({"data": self.data(), "environment": provenance(float)}))

    def attributes(self, of: Grid, outputs) -> dict:
        """Return attributes of the data: the question, and in `config` all that the numbers depend on."""
        asked = {name: text for name in ("question", "expectation") if (text := getattr(self, name))}
        axes = [[a.name, len(a), a.inner] for a in of.axes]
        config = self.fingerprint() | {"lanes": of.lanes, "variables": [o.name for o in outputs], "axes": axes}
        spec = {"name": self.name} | asked | self.data() | {"figures": self.figures}
        texts = {name: json.dumps(value, ensure_ascii=False) for name, value in (("spec", spec), ("config", config))}
        return provenance(float) | asked | texts

    def coordinates(self, of: Grid) -> dict:
        """Return the coordinates of the data: the axes, the largest stable z, and z = alpha·Ts, of several gains the
        largest; these two over the axes that they depend on, and not for too many values.

        The limit holds at any posture, exactly where J# is exact; with damping a little more may be stable. inf: any z.
        There is none where joints differ in their drives and rates in size.
        """
        with jax.enable_x64(True):
            limit, alpha, Ts = (self._over(of, name, most) for name, most in MOST.items())
        z = None if alpha is None or Ts is None else alpha * Ts
        each = {LIMIT: (limit if self.limited else None, "largest stable z of linear theory"), Z: (z, "z = α·Ts")}
        coords = of.coordinates(self.all_units())
        about = {name: {"units": "1", "long_name": words} for name, (_, words) in each.items()}
        return coords | {name: (v.dims, v.values, about[name]) for name, (v, _) in each.items() if v is not None}

    def _over(self, of: Grid, name, most):
        """Return the largest entry of a value over the axes that it depends on; None for more than `most` of them."""
        import xarray

        needs, first = self.needs(name), of.programs[0]
        axes = [a for a in of.axes if a.name in needs or needs & set().union(*self.tables.get(a.name, {}).values())]
        if math.prod(map(len, axes)) > most:
            return None
        points = itertools.product(*(a.values for a in axes))
        loops = (self.loop(first | dict(zip([a.name for a in axes], point, strict=True))) for point in points)
        values = [float(f"{np.max(loop[name]):.{DIGITS}g}") for loop in loops]
        return xarray.DataArray(np.reshape(values, [len(a) for a in axes]), dims=[a.name for a in axes])

    def file(self, text) -> pathlib.Path | None:
        """Return the file of a name, relative to the spec's folder, or None."""
        path = self.folder / str(text)
        return path if os.path.isfile(path) else None  # unlike pathlib's, it accepts names of any length


class Loop(dict):
    """The values of one loop by name, each evaluated when it is first asked for."""

    def __init__(self, spec: Spec, values: dict):
        super().__init__()
        self.spec, self.begun = spec, []  # names whose values are being evaluated
        self.counts = next((a.values for a in spec.axes if a.name == "M" and a.inner), None)
        self.given = DEFAULTS | spec.fixed
        for name, value in values.items():
            self.given |= spec.tables[name][value] if name in spec.tables else {name: value}

    def __missing__(self, name):
        if name in self.begun:
            raise errors.fail(name, "not depend on itself", f"does, through {' -> '.join([*self.begun, name])}")
        if name not in self.given and name != LIMIT:
            near, used = errors.nearest(name, (*self.given, LIMIT)), self.begun[-1]
            option = "" if used in OPTIONS else f"be an option{errors.nearest(used, OPTIONS)}, or "
            raise errors.fail(used, f"{option}use names that have a value", f"uses {name!r}{near}")
        self.begun.append(name)
        self[name] = value = self._limit() if name == LIMIT else self._value(name, self.given[name])
        self.begun.pop()
        return value

    def _value(self, name, written):
        value = written if name in NAMES else forms.evaluate(name, written, self.__getitem__)
        if name in WHOLE and isinstance(value, float) and value.is_integer():
            return int(value)
        return value[: self.joints()] if name in self.spec.drawn else value

    def joints(self) -> int:
        """Return the number of joints of the robot, which samples are cut to."""
        robot = self.spec.file(self.given.get("robot")) or self.given.get("robot")
        return load(robot, self.given.get("tip")).n

    def build(self) -> Problem:
        """Return the loop."""
        made = {}
        for name, written in self.given.items():
            if name in OPTIONS:
                quantity = name not in NAMES and forms.is_quantity(written)
                made[name] = written if quantity else self[name]  # its unit must fit
            if name in FILES:
                made[name] = str(self.spec.file(written) or written)
        if "robot" not in made:
            raise errors.fail("robot", "be given in [fixed] or [axes]", "is not")
        most = {"maximum": int(self.counts.max())} if self.counts is not None else {}
        return problem_from(**made | {"stage": stage_from(made.pop("stage"), made.pop("M"), **most)})

    def _limit(self):
        """Return linear theory's largest stable z, inf if there is none; for a traced M, from a table."""
        drive = {name: self[name] for name in options.DRIVE if name in self.given}
        hashed = tuple((name, tuple(np.ravel(v)) if np.ndim(v) else v) for name, v in drive.items())
        Ts = float(self["Ts"]) if TIMED & set(drive) else 1.0
        of = functools.partial(_largest_z, self["method"], self["stage"], hashed, Ts)
        if errors.concrete(M := self["M"]):
            return of(int(M))
        table = np.full(self.counts.max() + 1, np.nan)
        table[self.counts] = [of(int(m)) for m in self.counts]
        return jnp.asarray(table)[M]


@functools.cache
def _largest_z(method, stage, drive, Ts, M) -> float:
    passes = M if stage == "picard" else None
    return Ts * largest_stable(method, passes, options.drive_from(dict(drive)) or Drive(), Ts=Ts)


# --- reading ------------------------------------------------------------------------------------------


def read(path, changes=()) -> Spec:
    """Read a spec and check it whole.

    Args:
      path: of the TOML file.
      changes: strings "name=value" that override it; the value is TOML.

    Raises: ArgumentError, one line, for what cannot be read, is unknown (the nearest name is suggested), is missing, or
      cannot be built into loops.
    """
    path = errors.path("SPEC", path)
    written = read_toml("SPEC", path)
    for change in changes:
        _change(written, change)
    return parse(written, path.stem, path.parent)


def _change(written, change):
    """Set NAME=VALUE, a value of [fixed] or [axes], or a path such as axes.case.panda.q0."""
    name, equals, text = map(str.strip, change.partition("="))
    if not equals or not name:
        raise errors.fail("set", "be NAME=VALUE", f"is {change!r}")
    value: Any = text  # a bare word, such as CN, or an expression
    with contextlib.suppress(ValueError, RecursionError):
        value = tomllib.loads(f"value = {text}")["value"]
    fixed, axes = (_inner(written, table) for table in ("fixed", "axes"))
    *path, key = name.split(".")
    if not path and key not in KEYS:
        path = ["axes" if key in axes and isinstance(value, (list, dict)) else "fixed"]
    functools.reduce(_inner, path, written)[key] = value
    if path == ["axes"]:
        fixed.pop(key, None)
    elif path == ["fixed"] and axes.pop(key, None):  # figures of this axis have nothing to show
        written["figure"] = [figure for figure in written.get("figure", ()) if repr(key) not in repr(figure)]


def _inner(table, name) -> dict:
    return errors.kind(name, table.setdefault(name, {}), dict, "be a table")


def parse(written: dict, name="spec", folder=pathlib.Path()) -> Spec:
    """Return the spec of a TOML file's contents, checked whole; see `read`.

    Args: folder: where files named in the spec are searched first.
    """
    known_keys("SPEC", written, KEYS)
    given = KEYS | written
    for key, default in KEYS.items():
        if type(default) in WORDS:
            errors.kind(key, given[key], type(default), WORDS[type(default)])
    for key, value in given["units"].items():
        errors.kind(f"units.{key}", value, str, "be a text")
    if not all(isinstance(figure, dict) for figure in given["figure"]):
        raise errors.fail("figure", "be a list of tables, [[figure]]", f"is {given['figure']!r}")
    named = {axis: value for axis, value in given["axes"].items() if isinstance(value, dict) and value}
    tables = {axis: value for axis, value in named.items() if all(isinstance(table, dict) for table in value.values())}
    spec = Spec(
        name=name,
        question=given["question"].strip(),
        expectation=given["expectation"].strip(),
        tolerance=float(errors.number("tolerance", given["tolerance"], positive=True)),
        lanes=errors.integer("lanes", given["lanes"], at_least=0),
        metrics=tuple(dict.fromkeys(map(str, given["metrics"]))),
        fixed=given["fixed"],
        tables=tables,
        written={axis: value for axis, value in given["axes"].items() if axis not in tables},
        units=given["units"],
        figures=given["figure"],
        folder=pathlib.Path(folder),
    )
    _check_names(spec)
    spec = dataclasses.replace(spec, axes=_axes(spec))
    places = spec.places() | {"axes": spec.written}
    used = [forms.names(n, v) for table in places.values() for n, v in table.items() if n not in NAMES]
    for where, table in places.items():
        known_keys(where, table, (*OPTIONS, *sorted(set().union(*used))))
    widest = max((a.values[0].size for a in spec.axes if a.inner and a.name not in spec.drawn), default=1)
    ends = list(itertools.product((np.argmin, np.argmax, lambda v: np.argmin(np.abs(v))), range(widest)))
    made = [spec.loop(program, *end).build() for program in spec.programs() for end in ends]
    for one in made:
        check_metrics(spec.metrics, one.law)
    each = {name: " or ".join(dict.fromkeys(unit_of(name, one.law) for one in made)) for name in spec.metrics}
    limited = not any(one.drive is not None and mixed(one.law, one.drive) for one in made)
    return dataclasses.replace(spec, metric_units=each, limited=limited)


def _check_names(spec: Spec):
    """Raise ArgumentError for a value that is none, or a name that has another meaning or is given twice."""
    for name in (*spec.written, *spec.tables, *(name for table in spec.places().values() for name in table)):
        if name in KEYS:
            raise errors.fail(name, "stand above all tables", "is in one")  # TOML counts lines below its header to it
        if name in (LIMIT, Z) or (name in spec.tables and name in OPTIONS):
            raise errors.fail(f"axes.{name}", "have another name", "has one that means something else")
    giver: dict = {}  # {name: the axis of tables that gives it}
    for where, table in spec.places().items():
        for name, value in table.items():
            if not isinstance(value, (str, int, float, list)) or isinstance(value, bool):
                raise errors.fail(f"{where}.{name}", "be a number, a name, an expression or a list", f"is {value!r}")
            axis = where.split(".")[1] if where != "fixed" else None
            if name in spec.written or (axis and giver.setdefault(name, axis) != axis):
                raise errors.fail(f"{where}.{name}", "be given once", "is given by another axis, too")


def _axes(spec: Spec) -> tuple:
    """Return all axes: those of tables, then the others as written, with what must be concrete compiled in: names, N,
    dead times, what M, the seed or the linear limit depend on, and a path on which loops begin, whose start is searched
    for.

    Samples are drawn for the widest robot, and each arm uses the first ones.
    """
    tables = tuple(Axis(name, tuple(labels), tuple(labels)) for name, labels in spec.tables.items())
    joints = None
    for _ in range(2):  # the second time with the number of joints known
        plain = [forms.read(name, value, joints) for name, value in spec.written.items()]
        spec = dataclasses.replace(spec, axes=(*tables, *plain))
        if not spec.drawn:
            break
        joints = max(spec.loop(program).joints() for program in spec.programs())
    wanted = spec.needs(*COMPILED_IN, *NAMES) | (spec.needs(*COUNTS) - {*COUNTS})
    if LIMIT in spec.needs(*(name for table in spec.places().values() for name in table)):
        wanted |= spec.needs(LIMIT) - {"M"}
    if any(loop["begin"] == "on-path" for loop in map(spec.loop, spec.programs())):
        wanted |= spec.needs("q0", "Ts", *OF_PATHS)
    return *tables, *(compiled_in(a, f"axes.{a.name}") if a.name in wanted else a for a in plain)
