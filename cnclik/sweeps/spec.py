"""Spec: a question about many loops, as one TOML file.

Everything a loop depends on is a named value, by the names of `cnclik.problem.OPTIONS`. `[fixed]` gives some,
`[axes]` varies others; `[cases.NAME]` holds bundles of them (an arm with its start and target) that make an axis of
their own, `case`, and `[bundles.AXIS.NAME]` the same for an axis of any other name. A value may be an expression of
others: period = "N*Ts", alpha = "z/Ts", target = ["2 - distance", 0]. `limit` is the linear theory's largest
stable z for the loop's method, stage and delays: alpha = "0.5*limit/Ts". `delay`, `noise` and `seed` define how
the error is measured that is fed back.
"""

import dataclasses
import functools
import math
import operator
import os
import pathlib
import zlib

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import evaluations_per_step, named
from cnclik.measure import metrics
from cnclik.measure.metrics import Metrics
from cnclik.problem import options
from cnclik.problem.build import Problem, problem_from
from cnclik.problem.names import robot_and_tip, stage_from
from cnclik.problem.options import check_units
from cnclik.stability.gain import stable_share
from cnclik.stability.linear import gain_removing
from cnclik.sweeps import expression
from cnclik.sweeps.axes import NAMES, is_name, per_joint
from cnclik.sweeps.grid import MOST_POINTS, Grid, axis
from cnclik.sweeps.labels import LIMIT, UNITS

KEYS = ("question", "expectation", "tolerance", "lanes", "metrics")
TABLES = ("fixed", "axes", "cases", "bundles", "units", "figure")
FILES = ("robot", "reference")  # options that may name a file
PIECES = 8  # blocks of a program, at least, if there are enough lanes
OPTIONS = options.OPTIONS
DEFAULTS = options.DEFAULTS | {
    "delay": 0,
    "measurement_delay": 0,
}


@dataclasses.dataclass(frozen=True)
class Spec:
    """A validated spec. `grid()` is what it runs over, `study` what runs."""

    name: str
    question: str
    expectation: str
    tolerance: float
    lanes: int | None
    metrics: tuple
    fixed: dict
    axes: dict  # name -> Axis
    written: dict  # name -> the axis as written
    bundles: dict  # axis -> {label: {name: value}}; "case" first
    units: dict
    figures: tuple
    folder: pathlib.Path = pathlib.Path()  # where files named in the spec are searched first

    def shape(self) -> Grid:
        """The grid over the cases, the other bundles and the axes, in the order written; not yet cut."""
        axes = [axis(name, {label: label for label in labels}) for name, labels in self.bundles.items()]
        return Grid((*axes, *self.axes.values()), MOST_POINTS)

    def grid(self) -> Grid:
        """The grid, cut into blocks."""
        found = self.shape()
        if not found.axes:
            raise errors.fail("axes", "hold at least one axis, such as alpha = [1, 5, 10]", "holds none")
        size = math.prod(len(a) for a in found.inner)
        # Blocks are a power of two, smaller for long loops, and enough to keep the cores busy.
        steps = max(int(self.values(**program, **self.first())["N"]) for program in found.programs)
        lanes = self.lanes or 2 ** int(np.clip(np.log2(min(2**21 / max(steps, 1), size / PIECES)), 6, 16))
        return dataclasses.replace(found, lanes=min(lanes, size), more=self.draws)

    def tables(self) -> list:
        """[fixed], and the tables of all bundles."""
        return [self.fixed, *(table for labels in self.bundles.values() for table in labels.values())]

    def first(self, last=False) -> dict:
        """The first, or last, value of every numeric axis."""
        return {a.name: a.values[-1 if last else 0] for a in self.axes.values() if a.inner}

    def lookup(self, /, **values):
        """(all known values of one loop, a function from a name to its value, with expressions evaluated)."""
        chosen = [labels[values.pop(name)] for name, labels in self.bundles.items() if name in values]
        known = functools.reduce(operator.or_, chosen, DEFAULTS | self.fixed) | values

        @functools.cache
        def look(name):
            if name == LIMIT:
                return self._limit(look)
            if is_name(name):
                return known[name]
            value = expression.evaluate(name, known[name], look)
            # Samples have values for the widest arm.
            return value[: joints_of(known, look, self)] if per_joint(name, self.written.get(name)) else value

        return known, look

    def values(self, /, **values) -> dict:
        """All options of one loop's problem that have a value."""
        known, look = self.lookup(**values)
        return {name: look(name) for name in known if name in OPTIONS}

    def build(self, /, **values) -> Problem:
        """One loop."""
        known, _ = self.lookup(**values)
        v = self.values(**values)
        for name in FILES:
            if name in v:
                v[name] = str(self.file(v[name]) or v[name])
        M = self.axes.get("M")
        most = {} if M is None or not M.inner else {"maximum": int(M.values.max())}
        v["stage"] = stage_from(v["stage"], v.pop("M"), **most)
        made = problem_from(**v)
        written = {name: expression.units(name, known[name]) for name in v if name not in NAMES}
        check_units(made.law.chain, made.law.task, written)
        return made

    def file(self, text) -> pathlib.Path | None:
        """The file of a name, relative to the spec's folder, or None."""
        path = self.folder / str(text)
        return path if os.path.isfile(path) else None  # unlike Path.is_file, it accepts names of any length

    def _limit(self, look):
        """The linear theory's largest stable z, inf if there is none; for a traced M, from a table."""
        M = look("M")
        of = functools.partial(_stable, look("method"), look("stage"), float(look("delay") + look("measurement_delay")))
        if errors.concrete(M):
            return of(int(M))
        counts = [int(m) for m in self.axes["M"].values]
        table = np.full(max(counts) + 1, np.nan)
        table[counts] = [of(m) for m in counts]
        return jnp.asarray(table)[M]

    def study(self, /, draws=None, **values) -> Metrics:
        """One loop: its metrics. The sweep batches this function. `draws`: see `Spec.draws`."""
        made = self.build(**values)
        run = made.run(draws)
        return metrics.measure_run(run, made.law, made.reference, self.metrics, tolerance=self.tolerance)

    def draws(self, program: dict, lanes: dict) -> dict:
        """The standard normal numbers (lanes, N, m) of noise whose seed is an axis; a program draws none itself."""
        if "seed" not in lanes or (made := self.build(**program, **self.first())).noise is None:
            return {}
        seeds, which = np.unique(lanes["seed"], return_inverse=True)
        size = made.N, made.law.task.m
        return {"draws": np.stack([np.random.default_rng(int(seed)).standard_normal(size) for seed in seeds])[which]}

    def evaluations(self, program: dict) -> float:
        """Evaluations of f that one lane of a program costs, masked passes included."""
        return _evaluations(self.build(**program, **self.first(last=True)))

    def all_units(self) -> dict:
        """Units of the axes, given or known."""
        law = self.build(**self.grid().programs[0], **self.first()).law
        known = UNITS | {name: "1" for name in self.bundles}
        for name, one in self.axes.items():
            width = one.values.shape[-1] if one.inner and one.values.ndim > 1 else None
            known[name] = options.units(law, law.task, width).get(name, known.get(name, ""))
        return known | self.units

    def data(self) -> dict:
        """What the numbers depend on, for JSON; equal for equal data."""
        about = {
            "tolerance": self.tolerance,
            "metrics": list(self.metrics),
            "fixed": self.fixed,
            "axes": self.written,
            "cases": self.bundles.get("case", {}),
        }
        bundles = {name: labels for name, labels in self.bundles.items() if name != "case"}
        named = [table[name] for table in self.tables() for name in FILES if name in table]
        of_files = (a for name, a in self.axes.items() if name.rpartition(".")[2] in FILES)
        named += [v for a in of_files for v in a.values]
        files = {str(text): zlib.crc32(path.read_bytes()) for text in named if (path := self.file(text))}
        return about | ({"bundles": bundles} if bundles else {}) | ({"files": files} if files else {})


def _evaluations(p) -> float:
    stage = dataclasses.replace(p.stage, M=getattr(p.stage, "maximum", p.stage.M))
    return p.N * float(evaluations_per_step(p.method, stage, p.law.chain.n))


def joints_of(known, look, spec) -> int:
    """Number of joints of a loop's robot, which must not depend on the number of joints itself."""
    return robot_and_tip(known["robot"], known.get("tip"), known.get("base"))[0].n


@functools.cache
def _stable(method, stage, delay, M) -> float:
    M = M if named(method).implicit and stage == "picard" else None
    return gain_removing(stable_share(Drive(delay=delay), 1.0), method, M)
