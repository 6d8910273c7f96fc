"""Specs: what they mean, and that everything wrong with one is said before anything runs."""

import copy
import dataclasses
import tomllib
import warnings

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.problem import problem_from
from cnclik.sweeps import check, expression, files, grid
from cnclik.sweeps.labels import coordinates

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
start = [1, 1]
target = [0, "1 + lift"]

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
    s = check.parse(written())
    assert s.grid().shape == (2, 3, 3, 2)
    p = s.build(method="CN", M=np.int64(2), z=0.3, lift=0.1)
    reference, stage = p.reference, p.stage
    assert float(p.law.alpha) == pytest.approx(3.0, rel=1e-15) and (p.Ts, p.N, p.method) == (0.1, 4, ck.CN)
    np.testing.assert_allclose(p.q0, [0, -np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(reference.curve.end, [0, 1.1], rtol=1e-15)
    assert float(reference.curve.duration) == pytest.approx(0.4)  # the run's length, when nothing is said
    assert stage.M == 2 and stage.maximum == 2


def test_what_the_number_of_steps_depends_on_is_compiled_in():
    s = check.parse(written(fixed__N="round(span/Ts)", fixed__span=1.0, fixed__Ts=None, axes__Ts=[0.1, 0.25]))
    of = s.grid()
    assert [a.name for a in of.outer] == ["method", "Ts"]
    assert [s.values(**p, **s.first())["N"] for p in of.programs] == [10, 4, 10, 4]


def test_cases_are_an_axis_and_samples_fit_every_arm():
    cases = {
        "two": {"robot": "planar:1,1", "target": [0, 1]},
        "three": {"robot": "planar:1,1,1", "target": [0, 2]},
    }
    w = written(fixed__q0=None, fixed__target=None, fixed__robot=None, axes__lift=None, cases=cases, figure=[])
    w["axes"]["q0"] = {"samples": 5, "low": "-pi", "high": "pi", "seed": 3}
    s = check.parse(w)
    assert s.grid().axes[0].labels == ("two", "three")
    starts = s.axes["q0"].values
    assert starts.shape == (5, 3) and np.abs(starts).max() <= np.pi and len(np.unique(starts)) == 15
    np.testing.assert_array_equal(check.parse(copy.deepcopy(w)).axes["q0"].values, starts)  # the seed says it all
    assert s.build(case="two", **s.first(), method="EE").q0.shape == (2,)
    w["axes"]["q0"]["seed"] = 4
    assert not np.array_equal(check.parse(w).axes["q0"].values, starts)


def test_changes_on_the_command_line(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(TEXT)
    s = files.read(path, ["z=0.25", "axes.M=[5]", "method=RK4", "lift={linspace=[0, 1, 9]}", "tolerance=0.5"])
    assert list(s.axes) == ["lift", "M"] or list(s.axes) == ["M", "lift"]
    assert s.fixed["z"] == 0.25 and s.fixed["method"] == "RK4" and s.tolerance == 0.5 and len(s.axes["lift"]) == 9
    for changes, words in (
        (["cases={a=3}", "cases.a.N=2"], "`a` must be a table"),
        (["axes=3", "z=1"], "`axes` must be a table"),
        (["figure=[{kind='heat', x=['z'], select=3}]", "z=1"], r"`figure\[0\].x` must be a name"),
    ):
        with pytest.raises(ArgumentError, match=words):
            files.read(path, changes)


def same(one, other):
    """Whether two trees have the same literals and, leaf by leaf, the same numbers."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


LIMITED = {"damping": 0.05, "threshold": 0.1, "limits": "bounded"}
TABLES = [
    {},
    {"start": [1, 1], "target": [0, 1], "reference": "line", "period": 2.0, "feedforward": 0.5},
    {"reference": "circle", "radius": 0.1, "phase": 0.3, "period": -2.0, "posture": [0.1, 0.2], "alpha": [2.0, 3.0]}
    | {"future": "unknown"},
    {
        "reference": "lissajous",
        "frequency": [1, 2],
        "error_clamp": [0.1, 0.5],
        "damping": 0.1,
        "stage": "chord",
        "M": 2,
    },
    {"target": [1, 0.5], "posture": [0.1, 0.5], "method": "CN", "Ts": 0.1, "N": 7, "q0": [0.1, 1.0]} | LIMITED,
    {"robot": "planar-clockwise:1,2", "task": "xy", "M": 3, "lag": 0.1},
]


@pytest.mark.parametrize("table", TABLES, ids=lambda t: t.get("reference", t.get("robot", t.get("limits", "none"))))
def test_a_spec_and_the_command_line_build_the_same_loop(table):
    from cnclik.cli import arguments
    from cnclik.cli.problem import ProblemOptions, problem

    table = {"robot": "planar:1,1", "task": "position"} | table
    made = problem_from(**table)
    words, told = [table["robot"]], []
    for name, value in table.items():
        if name != "robot":
            words += ["--" + name.replace("_", "-"), *map(str, value if isinstance(value, list) else [value])]
    if set(table) <= {field.name for field in dataclasses.fields(ProblemOptions)}:
        told = [problem(arguments.parse(ProblemOptions, words, prog="x", description="x"))]
    w = {"question": "?", "expectation": "!", "fixed": table}
    for found in (*told, check.parse(w).build()):
        same(found.law, made.law)
        same(found.reference, made.reference)
        for name in ("q0", "Ts", "N", "method", "stage"):
            same(getattr(found, name), getattr(made, name))


def test_bundles_are_axes_beside_the_cases():
    bundles = {"damper": {"none": {}, "damped": {"damping": 0.1}}}
    s = check.parse(written(bundles=bundles, cases={"a": {"Ts": 0.1}, "b": {"Ts": 0.2}}, fixed__Ts=None))
    of = s.grid()
    assert [a.name for a in of.axes[:2]] == ["case", "damper"] and of.axes[1].labels == ("none", "damped")
    values = {"method": "EE"} | s.first()
    laws = {d: s.build(case="b", damper=d, **values).law for d in ("none", "damped")}
    assert not hasattr(laws["none"].inverse, "damping") and float(laws["damped"].inverse.damping) == 0.1
    assert s.build(case="b", damper="none", **values).Ts == 0.2
    assert s.all_units()["damper"] == "1"


def test_samples_per_joint_are_as_many_as_the_robot_has():
    cases = {"two": {"robot": "planar:1,1", "rest": [0, 1]}, "three": {"robot": "planar:1,1,1", "rest": [0, 1, 1]}}
    w = written(fixed__robot=None, cases=cases, fixed__q0="rest + 0.1*turn")
    w["axes"]["turn"] = {"samples": 4, "low": -1, "high": 1, "per": "joint"}
    s = check.parse(w)
    turn = s.axes["turn"].values
    assert turn.shape == (4, 3)
    q0 = s.build(case="two", method="EE", **s.first() | {"turn": turn[2]}).q0
    np.testing.assert_allclose(q0, [0, 1] + 0.1 * turn[2, :2], rtol=1e-15)


def test_the_linear_limit_is_a_value():
    s = check.parse(written(fixed__alpha="z*min(limit, 10)/Ts", fixed__stage="picard", axes__method=["EE", "IE", "CN"]))
    gains = {m: float(s.build(method=m, M=np.int64(2), z=0.5, lift=0.0).law.alpha) / 5 for m in ("EE", "IE")}
    assert gains == pytest.approx({"EE": 2.0, "IE": 1.3532}, abs=1e-4)  # IE: docs/gains.md
    traced = jax.jit(lambda M: s.build(method="CN", M=M, z=0.5, lift=0.0).law.alpha / 5)
    assert float(traced(2)) == pytest.approx(1.4780, abs=1e-4)
    s = check.parse(written(fixed__alpha="z*min(limit, 10)/Ts", fixed__stage="chord", axes__method=["IE"]))
    assert float(s.build(method="IE", M=1, z=0.5, lift=0.0).law.alpha) == pytest.approx(50.0)  # no limit


def test_files_are_beside_the_spec_and_part_of_what_the_numbers_depend_on(tmp_path):
    (tmp_path / "way.csv").write_text("0,1,1\n1,0,1\n")
    path = tmp_path / "a.toml"
    path.write_text(
        TEXT.replace('"line"', '"way.csv"').replace("start = [1, 1]", "").replace('target = [0, "1 + lift"]', "")
    )
    s = files.read(path, ["lift=0", "alpha=z/Ts + lift"])
    np.testing.assert_allclose(s.build(method="EE", **s.first()).reference.curve(1.0)[0], [0, 1], atol=1e-12)
    before = s.data()["files"]
    (tmp_path / "way.csv").write_text("0,1,1\n1,0,1.1\n")
    assert list(before) == ["way.csv"] and s.data()["files"] != before


@pytest.mark.parametrize(
    ("fixed", "axis", "unit"),
    [
        ({"task": "xy"}, {"damping": [0.1]}, "m"),
        ({"task": "rz"}, {"damping": [0.1]}, "1"),
        ({"task": "xy", "damping": 0.1}, {"threshold": [0.1]}, "m"),
        ({"task": "xy"}, {"target": [[1.0, 1.0]]}, "m"),
        ({"task": "rz"}, {"target": [[1.0, 0, 0, 0]]}, "1"),
        ({"task": "xyrz"}, {"target": [[1.0, 1.0, 1.0, 0, 0, 0]]}, "m, 1"),
        ({"task": "xy", "reference": "circle"}, {"period": [-1.0, 1.0]}, "s"),
        ({"task": "xy"}, {"q0": {"samples": 2}}, "rad"),
    ],
)
def test_units_follow_the_task(fixed, axis, unit):
    s = check.parse({"question": "?", "expectation": "!", "fixed": {"robot": "planar:1,1,1"} | fixed, "axes": axis}
                    | {"metrics": ["final_error"]})  # fmt: skip
    assert s.all_units()[next(iter(axis))] == unit


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"qestion": 1}, "`SPEC` must hold known keys, but holds 'qestion' (did you mean 'question'?)"),
        ({"question": None}, "`question` must be a sentence, but is missing"),
        ({"fixed__dampin": 0.1}, "holds 'dampin' (did you mean 'damping'?)"),
        ({"axes__alpah": [1.0]}, "holds 'alpah' (did you mean 'alpha'?)"),
        ({"fixed__alpha": "zz/Ts"}, "uses 'zz' (did you mean 'z'?)"),
        (
            {"fixed__metrics": ["mean_error"]},
            "`metrics` must stand above all tables, before [fixed], but stands in [fixed]",
        ),
        ({"axes__tolerance": [1e-3, 1e-4]}, "`tolerance` must stand above all tables, before [axes]"),
        ({"fixed__alpha": "z/"}, "`alpha` must be a number or a short expression"),
        ({"fixed__alpha": "__import__('os')"}, "`alpha` must be a number or a short expression"),
        ({"fixed__Ts": "alpha*1"}, "not depend on itself"),
        ({"fixed__Ts": 0}, "`Ts` must be positive"),
        ({"fixed__Ts": True}, "`fixed.Ts` must be a number"),
        ({"fixed__N": 2.5}, "`N` must be an integer"),
        ({"fixed__robot": None}, "`fixed` must give robot"),
        ({"fixed__q0": [0.0]}, "`q0` must have 2 joint values, but has 1"),
        ({"fixed__target": None}, "defaults"),
        ({"fixed__radius": 1.0}, "`radius` must be left out for the reference 'line'"),
        ({"fixed__robot": "plnar:1"}, "`robot` must"),
        ({"axes__method": ["EE", "RK5"]}, "`method` must be one of"),
        ({"axes__method": ["EE", 3]}, "`axes.method` must be a list of names"),
        ({"axes__z": {"linspase": [0, 1, 2]}}, "`axes.z` must be a list or a table with one of"),
        ({"axes__z": {"geomspace": [0, 1, 2]}}, "ends of one sign"),
        ({"axes__z": {"linspace": [0, 1]}}, "[first, last, count]"),
        ({"axes__z": []}, "`axes.z` must"),
        ({"axes__z": {"linspace": [0, 1, 10**12]}}, "at most 10,000,000 values, but asks for 1,000,000,000,000"),
        ({"axes__z": {"range": [10**30, 10**30 + 3]}}, "`axes.z` must have a range within"),
        ({"axes__z": {"range": [0, 10**12]}}, "at most 10,000,000 values"),
        ({"axes__lift": {"linspace": [[0.0] * 1000, [1.0] * 1000, 10**5]}}, "but asks for 100,000,000"),
        ({"axes__q0": {"samples": 10**7}, "fixed__q0": None}, "at most 10,000,000 values, but asks for 20,000,000"),
        ({"axes__z": {"samples": 10**12}}, "at most 10,000,000 values"),
        ({"axes__M": [-1, 2]}, "at least 0"),
        ({"fixed__period": "2*lift"}, "`period` must be positive"),
        ({"fixed__damping": "z", "axes__damping": [0.1, -0.1]}, "`axes.damping` must not be in [fixed]"),
        ({"axes__damping": [0.1, -0.1]}, "`axes.damping` must hold values that are positive, but holds -0.1"),
        ({"axes__period": [1.0, 0.0]}, "`axes.period` must hold values that are other than 0, but holds 0"),
        ({"fixed__limit": 2.0}, "`fixed.limit` must not be given"),
        ({"fixed__alpha": "limit/Ts", "axes__limit": [1.0]}, "`axes.limit` must have a name of its own"),
        ({"fixed__alpha": "z*limit/Ts", "fixed__M": "round(alpha)", "axes__M": None}, "not depend on itself"),
        ({"fixed__q0": ["(-1)**0.5", 0]}, "the result is complex"),
        ({"fixed__q0": ["round((-8)**0.5)", 0]}, "the result is complex"),
        ({"fixed__q0": ["method + 1", 0]}, "'method + 1' is not: method is a name, not a number"),
        ({"fixed__q0": [[0], [0, 0]]}, "`q0` must hold numbers or vectors of one length"),
        ({"fixed__q0": [True, 0]}, "`q0` must hold numbers or vectors of one length"),
        ({"fixed__q0": None, "axes__q0": {"samples": 2, "low": [0, 0], "high": [1, 1, 1]}}, "must have low ≤ high"),
        ({"fixed__q0": None, "axes__q0": {"samples": 2, "high": [1, 1, 1]}}, "must have low ≤ high"),
        ({"axes__z": {"linspace": [{}, 1, 3]}}, "`axes.z` must hold numbers"),
        ({"bundles": {"law": {"a": {"dampin": 0.1}}}}, "`bundles.law.a` must hold known keys, but holds 'dampin'"),
        ({"bundles": {"z": {"a": {}}}}, "`axes.z` must have a name of its own"),
        ({"bundles": {"law": {}}}, "`bundles.law` must hold tables"),
        ({"bundles": {"alpha": {"a": {}}}}, "`bundles.alpha` must have a name of its own"),
        ({"bundles": {"law": {"a": {"z": 1.0}}}}, "`axes.z` must not be in [bundles.law.a] as well"),
        ({"fixed__limits": "sns"}, "`limits` must be one of"),
        ({"fixed__threshold": 0.1}, "`threshold` must come with `damping`"),
        ({"fixed": {"robot": "planar:1,1", "reference": "no.csv"}, "axes": {}, "figure": []}, "no.csv: No such file"),
        ({"axes__Ts": [0.1]}, "`axes.Ts` must not be in [fixed] as well"),
        ({"axes__tasks.hands.alpha": [1, 2]}, "'tasks.hands.alpha' (write it without quotes)"),
        ({"metrics": ["mean_eror"]}, "did you mean 'mean_error'"),
        ({"metrics": ["rms_rotation_error"]}, "be ones of the task"),
        ({"figure": [{"kind": "heatmap"}]}, "`figure[0].kind` must be one of"),
        ({"units": {"z": 3}}, "`units.z` must be a unit's name"),
        ({"fixed__alpha": "z*(method*1000000000)"}, "method is a name, not a number"),
        ({"fixed__q0": [0, 10**400]}, "`q0` must hold numbers or vectors of one length"),
        ({"axes__z": ["(zz/3)", "1"]}, "`z` must use names that have a value, but uses 'zz'"),
        ({"axes__z": {"linspace": [-1e308, 1e308, 5]}}, "`axes.z` must hold finite values"),
        ({"axes__delay": {"range": [0, 100_000]}}, "`axes.delay` must hold at most 1,000 values, as each is compiled"),
        ({"fixed__N": None, "axes__N": {"range": [1, 100_000]}}, "`axes.N` must hold at most 1,000 values"),
        ({"fixed__N": "10*lift + 1", "axes__lift": {"linspace": [0, 1, 10**6]}}, "hold at most 1,000 values"),
        ({"lanes": 1, "axes__z": {"linspace": [0.1, 1, 10**6]}}, "span at most 1,000,000 blocks, of so many `lanes`"),
        ({"bundles": {f"b{k}": {"a": {}, "b": {}} for k in range(40)}}, "span at most 1,000 combinations"),
        (
            {f"fixed__z{k}": f"z{k - 1} + z{k - 2}" for k in range(2, 60)}
            | {"fixed__z0": 1.0, "fixed__z1": 1.0, "fixed__alpha": "z*z59"},
            "numbers in fewer than 30 steps",
        ),
        ({"figure": [3]}, "`figure[0]` must be a table, but is 3"),
        ({"figure": [{"kind": ["heat"]}]}, "`figure[0].kind` must be a name"),
        ({"figure": [{"kind": "heat", "select": 3}]}, "`figure[0].select` must be a table"),
        ({"figure": [{"kind": "heat", "limits": [1]}]}, "`figure[0].limits` must be [least, greatest]"),
        ({"figure": [{"kind": "heat", "reduce": "sum"}]}, "`figure[0].reduce` must be median, mean"),
        ({"figure": [{"kind": "heat", "xx": "z"}]}, "holds 'xx'"),
        ({"figure": [{"kind": "heat", "name": "../up"}]}, "`figure[0].name` must be a file's name without a folder"),
        ({"figure": [{"kind": "heat", "name": ".."}]}, "`figure[0].name` must be a file's name without a folder"),
        ({"figure": [{"kind": "heat", "select": {"z": 1e9}}]}, "`figure[0].select.z` must lie between"),
        ({"figure": [{"kind": "heat", "select": {"z": "a"}}]}, "`figure[0].select.z` must be a number, but is 'a'"),
        ({"figure": [{"kind": "heat", "x": "zz"}]}, "`figure[0].x` must be one of"),
        ({"figure": [{"kind": "heat", "value": "rms_error"}]}, "`figure[0].value` must be one of"),
    ],
)
def test_everything_wrong_is_said_in_one_line(changes, words):
    w = written(**changes)
    if words == "defaults":  # a line without its end goes where the tip is led by default
        w["axes"].pop("lift"), w.pop("figure")
        check.parse(w)
        return
    with pytest.raises(ArgumentError) as error:
        check.parse(w)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["question = ", "\x00", "a = 1\na = 2"])
def test_files_that_are_no_toml(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ArgumentError, match="must be a TOML file"):
        files.read(path)
    with pytest.raises(ArgumentError, match="No such file"):
        files.read(tmp_path / "none.toml")
    path.write_text(TEXT)
    with pytest.raises(ArgumentError, match="`robot` must be a URDF or MJCF file"):  # and no name is too long for it
        files.read(path, ["robot=" + "a" * 5000])


def test_an_axis_may_have_any_name():
    """Those of the functions' own arguments, too."""
    for name in ("N", "law", "self"):
        w = written(fixed__N=None, fixed__alpha=f"{name} + 1", axes__N=[4], axes__z=None, figure=[])
        w["axes"][name] = [4, 5]
        s = check.parse(w)
        lane = s.grid().programs[0] | s.first()
        assert float(s.build(**lane).law.alpha) == 5.0


def test_nested_too_deeply(tmp_path):
    path = tmp_path / "deep.toml"
    for text in ("a = " + "[" * 5000 + "]" * 5000, TEXT.replace("alpha = ", "alpha = " + "[" * 200 + "]" * 200 + " #")):
        path.write_text(text)
        with pytest.raises(ArgumentError):
            files.read(path)
    path.write_text(TEXT)
    with pytest.raises(ArgumentError, match="nested less deeply"):
        files.read(path, ["alpha=" + "{a=" * 500 + "1" + "}" * 500])


def test_no_grid_beyond_what_can_be_stored():
    with pytest.raises(
        ArgumentError, match="span at most 10,000,000,000 points, but span 9,000,000 of a × 9,000,000 of b"
    ):
        grid.Grid(tuple(grid.axis(name, np.arange(9e6)) for name in "ab"), 1)


def test_an_integer_of_thousands_of_digits(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text("question = " + "9" * 5000)
    with pytest.raises(ArgumentError, match="`SPEC` must be a TOML file"):
        files.read(path)


def test_expressions_are_arithmetic():
    known = {"a": 2.0, "n": 3}.__getitem__
    assert expression.evaluate("x", "-a**2 + 3*sqrt(4)/n - +1", known) == -4 + 2 - 1
    assert expression.evaluate("x", "round(a/0.7)", known) == 3
    assert expression.evaluate("x", "min(a, n) + max(1, 0.5)", known) == 3
    assert expression.names("x", ["a + b", 3, "sin(c)*pi"]) == {"a", "b", "c"}
    with pytest.raises(ArgumentError, match="worked out"):
        expression.evaluate("x", "a/0", known)
    for huge in ("9**9**9", "(2**900)**900", "n**9**9"):
        with pytest.raises(ArgumentError, match="a power is too large"):
            expression.evaluate("x", huge, known)
    assert expression.evaluate("x", "2**10 + 10**-2 + (-1)**3", known) == 1024 + 0.01 - 1
    with pytest.raises(ArgumentError, match="be a number or a short expression"):
        expression.parse("x", "1" + "0" * 400)
    with pytest.raises(ArgumentError, match="be a number or a short expression"):
        expression.parse("x", "(" * 150 + "a" + ")**2" * 150)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ArgumentError):
            expression.evaluate("x", "0in a", known)
        assert np.isnan(expression.evaluate("x", "a*z", {"a": np.float64(np.inf), "z": 0}.__getitem__))
    for bad in ("a.b", "a[0]", "lambda: 1", "f(a)", "sin(a, a)", "a if a else a", "'s'", "1j", "sin", "a and a"):
        with pytest.raises(ArgumentError, match="be a number or a short expression"):
            expression.parse("x", bad)


def test_a_spec_without_axes_is_one_loop_and_no_sweep():
    w = written(axes=None, figure=None)
    w["fixed"] |= {"M": 2, "z": 0.5, "lift": 0.1, "method": "CN"}
    spec = check.parse(w)
    assert float(spec.build().Ts) == 0.1
    with pytest.raises(ArgumentError, match="`axes` must hold at least one axis"):
        spec.grid()


@pytest.mark.parametrize(("values", "told"), [([[1, 2, 3, 4]], "hold one number each"), ([True, 2], "hold numbers")])
def test_passes_are_single_numbers(values, told):
    with pytest.raises(ArgumentError, match=f"`axes.M` must {told}"):
        check.parse(written(axes__M=values))


def test_the_rounded_end_of_an_axis_can_be_selected():
    """linspace(0.1, 0.7, 4) ends at 0.7 − 1e-16, or 0.7 + 1e-16."""
    for first, last in ((0.1, 0.7), (0.1, 0.3), (0.7, 0.1)):
        axis = {"linspace": [first, last, 3]}
        for end in (np.nextafter(last, 9), np.nextafter(last, -9), first):
            check.parse(written(axes__z=axis, figure=[{"kind": "slices", "x": "lift", "select": {"z": float(end)}}]))


def test_numbers_have_units_as_on_the_command_line():
    w = written(fixed__Ts="4ms", fixed__delay="34ms", fixed__measurement_delay="8 ms", fixed__lag="20ms",
                fixed__q0="0 -90 deg", fixed__start=["100cm", 1], axes__method=["EE"], axes__M=[1])  # fmt: skip
    s = check.parse(w)
    made = s.build(method="EE", M=1, z=0.2, lift=0.0)
    assert (made.Ts, made.drive.delay, made.drive.measurement_delay, made.drive.lag) == (0.004, 8.5, 2, 0.02)
    assert float(made.law.alpha) == pytest.approx(50.0)  # of an expression of Ts
    np.testing.assert_allclose(made.q0, [0, -np.pi / 2])
    np.testing.assert_allclose(made.reference.curve.start, [1, 1])


def test_a_dead_time_follows_from_the_sampling_time_of_its_loop():
    s = check.parse(written(fixed__Ts=None, axes__Ts=[0.01, 0.02], axes__delay=["20ms", "40ms"], axes__M=[1]))
    assert [a.name for a in s.grid().outer] == ["method", "Ts", "delay"]
    delays = [s.values(**p, **s.first())["delay"] for p in s.grid().programs if p["method"] == "EE"]
    assert delays == [2, 4, 1, 2]
    assert coordinates(s.grid(), s.all_units())["delay"][2]["units"] == "1"  # it was "delay 20ms samples"


def test_an_axis_of_numbers_with_units_is_one_of_numbers():
    s = check.parse(written(fixed__Ts=None, axes__Ts=["10 ms", "0.02"], axes__z=["pi/2", 1]))
    axes = {a.name: a for a in s.grid().axes}
    np.testing.assert_array_equal(axes["Ts"].values, [0.01, 0.02])
    np.testing.assert_array_equal(axes["z"].values, [np.pi / 2, 1.0])


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("delay", "34kg", r"but is '34kg' \(units: s, ms, us, sample, samples\)"),
        ("q0", "0deg 90", "write a unit behind each number, or once at the end, apart"),
        ("q0", "100mm 200mm", "`q0` must have the units of what it is for, but joint 'q1' is in rad, and m is given"),
        ("q0", ["100mm", 1], "joint 'q1' is in rad, and m is given"),
        ("damping", "1kg", "`damping` must be a number"),
        ("mine", "4ms", "`mine` must be a number or a short expression"),
    ],
)
def test_what_has_no_such_unit_is_refused(name, value, told):
    with pytest.raises(ArgumentError, match=told):
        check.parse(written(**{f"fixed__{name}": value}))
