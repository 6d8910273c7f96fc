"""Specs: what they mean, and that everything wrong with one is said before anything runs."""

import copy
import tomllib

import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.sweeps import expression, spec

TEXT = """
question = "Is it so?"
expectation = "It is."
metrics = ["mean_error", "evaluations"]

[fixed]
task = "xy"
robot = "planar:1,1"
q0 = [0, "-pi/2"]
N = 4
Ts = 0.1
alpha = "z/Ts"
reference = "line"
from = [1, 1]
to = [0, "1 + lift"]

[axes]
method = ["EE", "CN"]
M = { range = [0, 2] }
z = { linspace = [0.1, 0.5, 3] }
lift = [0.0, 0.1]

[[figure]]
kind = "heat"
x = "z"
y = "lift"
"""


def written(**changes):
    """The spec with dotted changes; None takes away."""
    out = copy.deepcopy(tomllib.loads(TEXT))
    for name, value in changes.items():
        *rooms, key = name.split("__")
        table = out
        for room in rooms:
            table = table.setdefault(room, {})
        if value is None:
            del table[key]
        else:
            table[key] = value
    return out


def test_values_follow_from_expressions():
    s = spec.parse(written())
    assert s.grid().shape == (2, 3, 3, 2)
    law, reference, q0, Ts, N, method, stage = s.build(method="CN", M=np.int64(2), z=0.3, lift=0.1)
    assert float(law.alpha) == pytest.approx(3.0, rel=1e-15) and (Ts, N, method) == (0.1, 4, ck.CN)
    np.testing.assert_allclose(q0, [0, -np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(reference.curve.end, [0, 1.1], rtol=1e-15)
    assert float(reference.curve.duration) == pytest.approx(0.4)  # the run's length, when nothing is said
    assert stage.M == 2 and stage.maximum == 2


def test_what_the_number_of_steps_depends_on_is_compiled_in():
    s = spec.parse(written(fixed__N="round(span/Ts)", fixed__span=1.0, fixed__Ts=None, axes__Ts=[0.1, 0.25]))
    of = s.grid()
    assert [a.name for a in of.outer] == ["method", "Ts"]
    assert [s.values(**p, **s._first())["N"] for p in of.programs] == [10, 4, 10, 4]


def test_cases_are_an_axis_and_samples_fit_every_arm():
    cases = {
        "two": {"robot": "planar:1,1", "to": [0, 1]},
        "three": {"robot": "planar:1,1,1", "to": [0, 2]},
    }
    w = written(fixed__q0=None, fixed__to=None, fixed__robot=None, axes__lift=None, cases=cases, figure=[])
    w["axes"]["q0"] = {"samples": 5, "low": "-pi", "high": "pi", "seed": 3}
    s = spec.parse(w)
    assert s.grid().axes[0].labels == ("two", "three")
    starts = s.axes["q0"].values
    assert starts.shape == (5, 3) and np.abs(starts).max() <= np.pi and len(np.unique(starts)) == 15
    np.testing.assert_array_equal(spec.parse(copy.deepcopy(w)).axes["q0"].values, starts)  # the seed says it all
    assert s.build(case="two", **s._first(), method="EE")[2].shape == (2,)
    w["axes"]["q0"]["seed"] = 4
    assert not np.array_equal(spec.parse(w).axes["q0"].values, starts)


def test_changes_on_the_command_line(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(TEXT)
    s = spec.read(path, ["z=0.25", "axes.M=[5]", "method=RK4", "lift={linspace=[0, 1, 9]}", "tolerance=0.5"])
    assert list(s.axes) == ["lift", "M"] or list(s.axes) == ["M", "lift"]
    assert s.fixed["z"] == 0.25 and s.fixed["method"] == "RK4" and s.tolerance == 0.5 and len(s.axes["lift"]) == 9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"qestion": 1}, "`SPEC` must hold known keys, but holds 'qestion' (did you mean 'question'?)"),
        ({"question": None}, "`question` must be a sentence, but is missing"),
        ({"fixed__dampin": 0.1}, "holds 'dampin' (did you mean 'damping'?)"),
        ({"axes__alpah": [1.0]}, "holds 'alpah' (did you mean 'alpha'?)"),
        ({"fixed__alpha": "zz/Ts"}, "uses 'zz' (did you mean 'z'?)"),
        ({"fixed__alpha": "z/"}, "`alpha` must be a number or an expression"),
        ({"fixed__alpha": "__import__('os')"}, "`alpha` must be a number or an expression"),
        ({"fixed__Ts": "alpha*1"}, "not depend on itself"),
        ({"fixed__Ts": 0}, "`Ts` must be positive"),
        ({"fixed__Ts": True}, "`fixed.Ts` must be a number"),
        ({"fixed__N": 2.5}, "`N` must be an integer"),
        ({"fixed__N": None}, "`fixed` must give N"),
        ({"fixed__q0": [0.0]}, "`q0` must have shape (2,)"),
        ({"fixed__to": None}, "defaults"),
        ({"fixed__radius": 1.0}, "`radius` must belong to the reference 'line'"),
        ({"fixed__robot": "plnar:1"}, "`robot` must"),
        ({"fixed__lengths": [1, 1]}, "`lengths` must come with robot = 'planar'"),
        ({"axes__method": ["EE", "RK5"]}, "`method` must be one of"),
        ({"axes__method": ["EE", 3]}, "`axes.method` must be a list of names"),
        ({"axes__z": {"linspase": [0, 1, 2]}}, "`axes.z` must be a list or a table with one of"),
        ({"axes__z": {"geomspace": [0, 1, 2]}}, "ends of one sign"),
        ({"axes__z": {"linspace": [0, 1]}}, "[first, last, count]"),
        ({"axes__z": []}, "`axes.z` must"),
        ({"axes__M": [-1, 2]}, "at least 0"),
        ({"axes__Ts": [0.1]}, "`axes.Ts` must not be in [fixed] as well"),
        ({"metrics": ["mean_eror"]}, "did you mean 'mean_error'"),
        ({"metrics": ["rms_rotation_error"]}, "be ones of the task"),
        ({"figure": [{"kind": "heatmap"}]}, "`figure[0].kind` must be one of"),
        ({"units": {"z": 3}}, "`units.z` must be a unit's name"),
        ({"figure": [3]}, "`figure[0]` must be a table, but is 3"),
        ({"figure": [{"kind": ["heat"]}]}, "`figure[0].kind` must be a name"),
        ({"figure": [{"kind": "heat", "select": 3}]}, "`figure[0].select` must be a table"),
        ({"figure": [{"kind": "heat", "limits": [1]}]}, "`figure[0].limits` must be [least, greatest]"),
        ({"figure": [{"kind": "heat", "reduce": "sum"}]}, "`figure[0].reduce` must be median, mean"),
        ({"figure": [{"kind": "heat", "xx": "z"}]}, "holds 'xx'"),
        ({"figure": [{"kind": "heat", "x": "zz"}]}, "`figure[0].x` must be one of"),
        ({"figure": [{"kind": "heat", "value": "rms_error"}]}, "`figure[0].value` must be one of"),
    ],
)
def test_everything_wrong_is_said_in_one_line(changes, words):
    w = written(**changes)
    if words == "defaults":  # a line without its end goes where the tip is led by default
        w["axes"].pop("lift"), w.pop("figure")
        spec.parse(w)
        return
    with pytest.raises(ArgumentError) as error:
        spec.parse(w)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["question = ", "\x00", "a = 1\na = 2"])
def test_files_that_are_no_toml(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ArgumentError, match="must be a TOML file"):
        spec.read(path)
    with pytest.raises(ArgumentError, match="No such file"):
        spec.read(tmp_path / "none.toml")


def test_expressions_are_arithmetic():
    known = {"a": 2.0, "n": 3}.__getitem__
    assert expression.evaluate("x", "-a**2 + 3*sqrt(4)/n - +1", known) == -4 + 2 - 1
    assert expression.evaluate("x", "round(a/0.7)", known) == 3
    assert expression.names("x", ["a + b", 3, "sin(c)*pi"]) == {"a", "b", "c"}
    with pytest.raises(ArgumentError, match="worked out"):
        expression.evaluate("x", "a/0", known)
    for bad in ("a.b", "a[0]", "lambda: 1", "f(a)", "sin(a, a)", "a if a else a", "'s'", "1j", "sin", "a and a"):
        with pytest.raises(ArgumentError, match="be a number or an expression"):
            expression.parse("x", bad)
