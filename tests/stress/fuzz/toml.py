"""Specs of sweeps: valid ones with keys, types, values, nesting and sizes changed, and what `--set` may say of them."""

import contextlib
import copy
import functools
import json
import math
import pathlib
import tomllib

import jax
import numpy as np

from cnclik.problem.options import OPTIONS
from cnclik.sweeps import labels, spec
from tests.specs import reaching
from tests.stress.fuzz.expressions import draw as expression
from tests.stress.fuzz.nasty import TEXTS, VALUES, any_of, chance, damaged, slipped

SHIPPED = pathlib.Path(__file__).parents[3] / "sweeps"
BASES = tuple(map(tomllib.loads, (
    reaching(["final_error"], alpha="[1.0, 5.0]"),
    reaching(["mean_error", "ok"], method='["EE", "HEUN"]', alpha="{ linspace = [1, 20, 30] }", Ts="[0.01, 0.1]"),
    reaching(["mean_error"], more='[units]\ngain = "1/s"', alpha='["gain"]', gain="{ geomspace = [1, 9, 3] }"),
    reaching(["final_error"], M="[0, 1, 2]")
    + '[axes.case.a]\nstage = "chord"\nmethod = "IE"\n[axes.case.b]\nalpha = "2*M"\n',
    reaching(["final_error"], q0="{ samples = 3, seed = 1 }").replace('q0 = [0, "-pi/2"]\n', ""),
    reaching(["final_error"], turn="{ samples = 3 }").replace('"-pi/2"]', '0]\nposture = "turn*pi"'),
    reaching(["final_error"], z="[0.1, 0.2]") + '[axes.law.a]\nalpha = "z/Ts"\n[axes.law.b]\nalpha = "2*z/Ts"\n',
    reaching(["max_error"], N="[5, 7]", delay="[0, 1]")
    + '[[figure]]\nkind = "slices"\nx = "delay"\nvalue = "max_error"\n',
    reaching(["mean_error"], radius="[0.1, 0.2]").replace('"hold"\ntarget = [1, 0]', '"circle"\nperiod = "N*Ts"'),
)))  # fmt: skip
NAMES = (*OPTIONS, "z", "w", "limit", "pi", "case", "progress", "question", "metrics", "time", "step", "joint", "lanes")
ROOMS = ("fixed", "axes", "units", "figure")


@functools.cache
def _shipped():
    return tuple(tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(SHIPPED.glob("*.toml")))


def draw(rng):
    """(the spec's bytes, the strings of --set)."""
    written = copy.deepcopy(any_of(rng, _shipped() if chance(rng, 0.005) else BASES))
    for _ in range(int(rng.integers(4))):
        mutate(rng, written)
    data = as_toml(written).encode("utf-8", "surrogatepass")
    changes = [_change(rng) for _ in range(int(rng.integers(1, 3)))] if chance(rng, 0.3) else []
    return damaged(rng, data) if chance(rng, 0.1) else data, changes


def _places(table) -> list:
    """Every (table or list, key) inside, however deep."""
    found, todo = [], [table]
    while todo:
        one = todo.pop()
        found += [(one, key) for key in (one if isinstance(one, dict) else range(len(one)))]
        todo += [v for v in (one.values() if isinstance(one, dict) else one) if isinstance(v, (dict, list))]
    return found


def mutate(rng, written, names=NAMES, rooms=ROOMS):
    """One change, anywhere: of a value, a key, a table; names of options and tables that it may bring in."""
    if chance(rng, 0.02):
        _grow(rng, written)
        return
    where, key = any_of(rng, _places(written) or [(written, "fixed")])
    where.setdefault(key, {}) if isinstance(where, dict) else None
    match int(rng.integers(10)):
        case 0 | 1:
            where[key] = _value(rng)
        case 2:
            where[key] = expression(rng)
        case 3:
            where[key] = slipped(rng, where[key]) if isinstance(where[key], str) else [where[key]]
        case 4:
            where[key] = {"a": where[key]}
        case 5:
            del where[key]
        case 6 if isinstance(where, dict):
            where[slipped(rng, key) if chance(rng, 0.3) else any_of(rng, names)] = where.pop(key)
        case 7:
            room = written.setdefault(any_of(rng, rooms), {})
            if isinstance(room, dict):
                room[any_of(rng, names)] = _value(rng)
        case 8:
            there, other = any_of(rng, _places(written))
            with contextlib.suppress(RecursionError):  # too deep to be copied: it stands once
                where[key] = copy.deepcopy(there[other])
        case _:
            written.setdefault("fixed", {})
            if isinstance(written["fixed"], dict):
                written["fixed"][any_of(rng, names)] = _value(rng)


def _value(rng):
    if chance(rng, 0.3):
        return any_of(rng, TEXTS)
    if chance(rng, 0.3):
        names = (
            "EE",
            "CN",
            "newton",
            "planar:1,1",
            "panda",
            "damped",
            "bounded",
            "line",
            "lissajous",
            "xyrz",
            "pose",
        )
        return any_of(
            rng, (*names, "planar:1e308,1", "planar:nan", "/dev/zero", "no.csv", "no.urdf", "z/Ts", "v*2", "M")
        )
    return copy.deepcopy(any_of(rng, VALUES))


def _grow(rng, written):
    """Many, deep or long."""
    count = int(10 ** rng.uniform(0.5, 3.5))
    fixed, axes = {"z0": 1.0}, {}
    match int(rng.integers(7)):
        case 0:  # each value follows from the one before it
            fixed |= {f"z{k}": f"z{k - 1} + 1" for k in range(1, count)} | {"alpha": f"z{count - 1}"}
        case 1:  # and from the one before that
            fixed |= (
                {"z1": 1.0} | {f"z{k}": f"z{k - 1} + z{k - 2}" for k in range(2, count)} | {"alpha": f"z{count - 1}"}
            )
        case 2:
            axes = {f"b{k}": {"a": {}, "b": {}} for k in range(count)}
        case 3:
            axes = {any_of(rng, ("N", "delay", "M", "alpha")): {"linspace": [1, count * count, count * count]}}
        case 4:
            axes = {f"z{k}": [1.0, 2.0] for k in range(count)}
        case 5:
            axes = {"case": {f"c{k}": {} for k in range(count)}}
        case _:
            deep = {}
            for _ in range(count):
                deep = {"a": deep} if chance(rng, 0.5) else [deep]
            fixed = {"alpha": deep}
    for room, more in (("fixed", fixed), ("axes", axes)):
        if isinstance(written.setdefault(room, {}), dict):
            written[room] |= more


def _change(rng):
    name = any_of(rng, NAMES) if chance(rng, 0.7) else any_of(rng, ("", "a.b", "axes", "axes.a.N", "fixed."))
    name = any_of(rng, ("", "", "axes.", "fixed.", "units.", "axes.law.a.", ".", "x.y.z.")) + name
    value = _toml_value(_value(rng)) if chance(rng, 0.7) else any_of(rng, TEXTS)
    text = f"{name}={value}" if chance(rng, 0.9) else f"{name}{value}"
    return slipped(rng, text) if chance(rng, 0.2) else text


# --- TOML as text -------------------------------------------------------------------------------------


def as_toml(written) -> str:
    """Tables as TOML."""
    lines = [f"{_key(key)} = {_toml_value(value)}" for key, value in written.items()]
    return "\n".join(lines) + "\n"


def _key(key):
    return json.dumps(key)


def _toml_value(value) -> str:
    """A value in one line, in brackets as deep as it is; not by recursion, as it may be very deep."""
    out, todo = [], [value]
    while todo:
        value = todo.pop()
        match value:
            case _Raw():
                out.append(value)
            case bool():
                out.append("true" if value else "false")
            case float() if not math.isfinite(value):
                out.append(str(value))
            case int() | float():
                out.append(hex(value) if isinstance(value, int) and value.bit_length() > 1000 else repr(value))
            case str():
                out.append(json.dumps(value).replace("\x7f", "\\u007F"))
            case dict():
                parts = [p for k, v in value.items() for p in (_Raw(f"{_key(k)} = "), v, _Raw(", "))][:-1]
                todo += [_Raw("}"), *reversed(parts), _Raw("{")]
            case _:
                parts = [p for v in value for p in (v, _Raw(", "))]
                todo += [_Raw("]"), *reversed(parts), _Raw("[")]
    return "".join(out)


class _Raw(str):
    """A piece of TOML as it is."""


def attempt(made, folder) -> None:
    """All that happens to a spec before anything is traced; the loop of its first point is finite."""
    data, changes = made
    file = folder / "a.toml"
    file.write_bytes(data)
    found = spec.read(file, changes)
    of = found.grid()
    of.blocks(), labels.coordinates(of, found.all_units()), labels.fingerprint(found)
    loop = found.build(of.programs[0])
    said = loop.law, loop.reference, loop.q0, loop.drive
    for leaf in jax.tree.leaves(said):
        assert not np.isnan(np.asarray(leaf, float)).any(), f"NaN in {said}"
