"""Check: makes a spec from the contents of a TOML file and reports every mistake before anything runs."""

import dataclasses
import functools
import itertools
import math
import operator
import pathlib

import numpy as np

from cnclik import errors
from cnclik.law import reference as ref
from cnclik.measure import metrics
from cnclik.sweeps import axes as axis_forms
from cnclik.sweeps import expression
from cnclik.sweeps.axes import NAMES, is_name, known_keys, meant
from cnclik.sweeps.grid import COMPILED_IN, MOST_AXES, MOST_PROGRAMS, Axis, few_enough
from cnclik.sweeps.labels import LIMIT
from cnclik.sweeps.spec import DEFAULTS, KEYS, OPTIONS, TABLES, Spec, joints_of

REQUIRED = ("robot",)
STEPS = 30  # longest chain of values that refer to each other
OF_LIMIT = ["M", "delay", "measurement_delay"]  # what it depends on, besides method and stage, which depend on nothing
RESERVED = (LIMIT, "progress")  # other names in a store
FIGURES = {
    "heat": ("value", "x", "y", "boundary"),
    "best": ("value", "x", "y", "among", "boundary"),
    "slices": ("value", "x", "lines"),
    "distribution": ("value", "over", "lines"),
    "work": ("value", "lines", "over"),
}
_EVERY_FIGURE = ("kind", "name", "title", "panels", "rows", "select", "reduce", "across", "log", "limits")
ROLES = ("x", "y", "lines", "panels", "rows", "over", "among", "across")  # keys of a figure that name an axis


def _are_two_numbers(value):
    return isinstance(value, list) and len(value) == 2 and all(type(v) in (int, float) for v in value)


_FIGURE_TYPES = {  # of a figure's keys that are not names
    "select": (lambda v: isinstance(v, dict), "be a table of an axis' name and value"),
    "limits": (_are_two_numbers, "be [least, greatest]"),
    "log": (lambda v: isinstance(v, bool), "be true or false"),
    "boundary": (lambda v: isinstance(v, bool), "be true or false"),
    "reduce": (lambda v: v in ("median", "mean", "min", "max"), "be median, mean, min or max"),
}


def parse(written: dict, name="spec", folder=pathlib.Path()) -> Spec:
    """A spec from the contents of a TOML file; see `cnclik.sweeps.spec.read`.

    Args:
      folder: where files named in the spec are searched first.
    """
    known_keys("SPEC", written, (*KEYS, *TABLES))
    for key in ("question", "expectation"):
        if not isinstance(written.get(key), str) or not written[key].strip():
            raise errors.fail(key, "be a sentence", "is missing" if key not in written else f"is {written[key]!r}")
    fixed, bundles = _table(written, "fixed"), _bundles(written)
    axes = _table(written, "axes")
    _check_names(fixed, axes, bundles)
    unit_names = _table(written, "units")
    for named, unit in unit_names.items():
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
        axes={},
        written=axes,
        bundles=bundles,
        units=unit_names,
        figures=(),
        folder=pathlib.Path(folder),
    )
    wide = any(axis_forms.per_joint(n, value) for n, value in axes.items())
    joints = _widest(spec) if wide else 0
    spec = dataclasses.replace(spec, axes={n: axis_forms.read(n, value, joints) for n, value in axes.items()})
    spec = dataclasses.replace(spec, axes=_compiled_in(spec))
    spec.shape()  # refuse too many programs before trying each
    _check_loops(spec)
    return dataclasses.replace(spec, figures=_figures(written.get("figure", []), spec))


def axes_named(figure) -> list:
    """Names that a figure, checked or not, uses as axes."""
    selected = figure.get("select")
    return [*map(figure.get, ROLES), *(selected if isinstance(selected, dict) else ())]


# --- tables and names ---------------------------------------------------------------------------------


def _table(parent, key, prefix=""):
    table = parent.get(key, {})
    if not isinstance(table, dict):
        raise errors.fail(prefix + key, "be a table", f"is {table!r}")
    return dict(table)


def _bundles(written) -> dict:
    """{axis: {label: table}} of [cases.LABEL] and [bundles.AXIS.LABEL]."""
    cases, others = _table(written, "cases"), _table(written, "bundles")
    found = {"case": {label: _table(cases, label, "cases.") for label in cases}} if cases else {}
    for name in others:
        if name in OPTIONS or name == "case":
            raise errors.fail(f"bundles.{name}", "have a name of its own", f"is called {name!r}")
        labels = _table(others, name, "bundles.")
        found[name] = {label: _table(labels, label, f"bundles.{name}.") for label in labels}
        if not labels:
            raise errors.fail(f"bundles.{name}", "hold tables", "is empty")
    if math.prod(map(len, found.values())) > MOST_PROGRAMS or len(found) > MOST_AXES:
        counts = " × ".join(f"{len(labels)} of {name}" for name, labels in found.items())
        raise errors.fail("bundles", f"span at most {MOST_PROGRAMS:,} combinations", f"span {counts}")
    return found


def _where(name, label):
    return f"cases.{label}" if name == "case" else f"bundles.{name}.{label}"


def _metrics(names):
    if not isinstance(names, list) or not names:
        raise errors.fail("metrics", "be a list of names", f"is {names!r}")
    for name in names:
        metrics.named(name)
    return tuple(dict.fromkeys(names))


def _check_names(fixed, axes, bundles):
    """Check that every name is an option or used, and that every used name is defined once, without a cycle."""
    tables = {_where(n, label): table for n, labels in bundles.items() for label, table in labels.items()}
    for where, table in {"fixed": fixed, "axes": axes, **tables}.items():
        for name in set(table) & {*KEYS, *TABLES}:  # TOML counts lines below its header to it
            raise errors.fail(name, f"stand above all tables, before [{where}]", f"stands in [{where}]")
    for where, table in {"fixed": fixed, **tables}.items():
        for name, value in table.items():
            if not isinstance(value, (str, int, float, list)) or isinstance(value, bool):
                raise errors.fail(f"{where}.{name}", "be a number, a name, an expression or a list", f"is {value!r}")
            if name == LIMIT:
                must = "not be given: it follows from method, stage and delay"
                raise errors.fail(f"{where}.{name}", must, f"is {value!r}")
            if name in axes:
                raise errors.fail(f"axes.{name}", f"not be in [{where}] as well", "is in both")
    for name in (*axes, *bundles):
        if name in RESERVED or (name in axes and name in bundles):
            raise errors.fail(f"axes.{name}", "have a name of its own", f"is called {name!r}")
    for (one, first), (two, second) in itertools.combinations(bundles.items(), 2):
        both = {n for table in first.values() for n in table} & {n for table in second.values() for n in table}
        if both:
            raise errors.fail(f"bundles.{two}", f"leave to {one} what that gives", f"holds {min(both)!r} too")
    # Names that every loop has: given outside of bundles, or by each label of one.
    shared = {name: set.intersection(*map(set, labels.values())) for name, labels in bundles.items()}
    everywhere = set(fixed) | set(axes) | set(DEFAULTS) | {LIMIT} | set().union(*shared.values())
    used = set()

    def use(where, needs, here=()):
        used.update(needs)
        for need in needs - everywhere - set(here):
            hint = meant(need, sorted(everywhere | set(here)))
            raise errors.fail(where, "use names that have a value", f"uses {need!r}{hint}")

    for table in (fixed, axes, *tables.values()):
        for name, value in table.items():
            if not is_name(name) and (table is not axes or isinstance(value, list)):
                use(name, expression.names(name, value), table)
    for where, table in {"fixed": fixed, "axes": axes, **tables}.items():
        for name in table:
            known_keys(where, (name,), (*OPTIONS, *sorted(used)))
    for name in REQUIRED:
        if name not in everywhere:
            lacking = next((where for where, table in tables.items() if name not in table), "fixed")
            raise errors.fail(lacking, f"give {name}", "does not (nor do [axes])")
    written = {name: value for name, value in axes.items() if isinstance(value, list)}
    for known in _given(fixed, bundles):
        _check_cycles(known | written)


def _given(fixed, bundles):
    """The names that are given for each combination of the bundles' labels."""
    for tables in itertools.product(*(labels.values() for labels in bundles.values())):
        yield functools.reduce(operator.or_, tables, fixed)


def _check_cycles(known):
    steps = {}  # {name: the numbers it depends on}

    def walk(name, seen):
        if name in seen:
            raise errors.fail(name, "not depend on itself", f"does, through {' -> '.join([*seen, name])}")
        if name not in steps:
            value = OF_LIMIT if name == LIMIT else known.get(name)
            needs = set() if is_name(name) or value is None else expression.names(name, value)
            if len(seen) < STEPS:
                steps[name] = max((1 + walk(need, [*seen, name]) for need in needs), default=0)
        if steps.get(name, STEPS) >= STEPS:
            raise errors.fail(name, f"follow from numbers in fewer than {STEPS} steps", "does not")
        return steps[name]

    for name in known:
        walk(name, [])


def _widest(spec) -> int:
    """Joints of the widest robot: samples per joint are drawn for it, and each arm uses the first ones."""
    axes, named = spec.written, [name for name in ("robot", "stack") if name in spec.written]
    every = [[(name, v) for v in axis_forms.read(name, axes[name], 0).values] for name in named]
    most = 0
    for known, *chosen in itertools.product(_given(spec.fixed, spec.bundles), *every):
        lengths = known.get("lengths", axes.get("lengths"))
        # Only their number matters.
        count = {"lengths": np.ones(np.shape(lengths)[-1])} if isinstance(lengths, list) else {}
        known = known | dict(chosen) | count
        most = max(most, joints_of(known, known.get, spec))
    return most


# --- loops --------------------------------------------------------------------------------------------


def _compiled_in(spec: Spec) -> dict:
    """Axes that determine the number of steps, as outer axes with one program per value."""
    wanted, queue = set(), {*COMPILED_IN, *NAMES}
    while queue:
        name = queue.pop()
        wanted.add(name)
        needs = set(OF_LIMIT) if name == LIMIT else set()
        if not is_name(name):
            tables = (*spec.tables(), spec.written)
            needs = needs.union(*(expression.names(name, t[name]) for t in tables if name in t))
        queue |= needs - wanted
    out = dict(spec.axes)
    for name in wanted & out.keys():
        if out[name].inner:
            few_enough(f"axes.{name}", out[name].values)
            if out[name].values.ndim != 1:
                raise errors.fail(f"axes.{name}", "hold single numbers where N or delay depends on it", "holds vectors")
            values = tuple(v.item() for v in out[name].values)
            out[name] = Axis(name, values, values)
    return out


def _check_loops(spec: Spec):
    """Build the first and the last loop for every label and every value of the outer axes."""
    outer = {name: tuple(labels) for name, labels in spec.bundles.items()}
    outer |= {a.name: a.values for a in spec.axes.values() if not a.inner}
    base = {name: values[0] for name, values in outer.items()}
    tried = [base] + [base | {name: v} for name, values in outer.items() for v in values[1:]]
    for program in tried:
        for last in (False, True):
            lane = program | spec.first(last=last)
            made = spec.build(**lane)
            ref.check(made.reference, made.law.task)
            metrics.check(spec.metrics, made.law)


# --- figures ------------------------------------------------------------------------------------------


def _check_selected(where, value, axis):
    """Raise ArgumentError unless a figure selects a value on the axis; for numbers the nearest counts."""
    if not axis.inner:
        errors.one_of(where, value if isinstance(value, str) else str(value), list(map(str, axis.labels)))
    elif np.ndim(axis.values) == 1:
        least, most = axis.values.min(), axis.values.max()
        slack = 1e-9 * max(abs(least), abs(most))  # computed ends are rounded
        if not least - slack <= errors.number(where, value) <= most + slack:
            raise errors.fail(where, f"lie between {least:g} and {most:g}", f"is {value:g}")


def _figures(figures, spec: Spec) -> tuple:
    if not isinstance(figures, list):
        raise errors.fail("figure", "be a list of tables, [[figure]]", f"is {figures!r}")
    axes = {a.name: a for a in (spec.grid().axes if spec.shape().axes else ())}  # grid() checks the blocks
    dims = list(axes)
    for i, figure in enumerate(figures):
        where = f"figure[{i}]"
        if not isinstance(figure, dict):
            raise errors.fail(where, "be a table", f"is {figure!r}")
        for key, value in figure.items():
            fits, words = _FIGURE_TYPES.get(key, (lambda v: isinstance(v, str), "be a name"))
            if not fits(value):
                raise errors.fail(f"{where}.{key}", words, f"is {value!r}")
        kind = errors.one_of(f"{where}.kind", figure.get("kind"), FIGURES)
        known_keys(where, figure, (*_EVERY_FIGURE, *FIGURES[kind]))
        if "value" in figure:
            errors.one_of(f"{where}.value", figure["value"], spec.metrics)
        for key in ROLES:
            if key in figure:
                errors.one_of(f"{where}.{key}", figure[key], dims)
        if set(figure.get("name", "")) & set("/\\") or figure.get("name", "x") in ("", ".", ".."):
            raise errors.fail(f"{where}.name", "be a file's name without a folder", f"is {figure['name']!r}")
        for key, value in figure.get("select", {}).items():
            errors.one_of(f"{where}.select", key, dims)
            _check_selected(f"{where}.select.{key}", value, axes[key])
    return tuple(figures)
