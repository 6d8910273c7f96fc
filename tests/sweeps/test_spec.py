"""Specs: what they mean, what is wrong with them in a line, and their limits and noise against linear theory."""

import copy
import json
import pathlib
import tomllib

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive
from cnclik.problem import problem_from
from cnclik.show import sweeps as pictures
from cnclik.stability import gains
from cnclik.stability.linear import stability_limit
from cnclik.sweeps import axes as expression
from cnclik.sweeps import run_spec
from cnclik.sweeps.axes import axis
from cnclik.sweeps.grid import Grid
from cnclik.sweeps.spec import parse, read
from tests.refusals import refusals
from tests.specs import reaching

ROOT = pathlib.Path(__file__).parents[2]
TEXT = """
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
M = [0, 1, 2]
z = { linspace = [0.1, 0.5, 3] }
lift = [0.0, 0.1]
[[figure]]
kind = "heat"
x = "z"
y = "lift"
"""


def written(**changes):
    """The spec with changes: a__b=value sets b in the table a; None takes away."""
    out = tomllib.loads(TEXT)
    for name, value in changes.items():
        *path, key = name.split("__")
        table = out
        for part in path:
            table = table.setdefault(part, {})
        if value is None:
            del table[key]
        else:
            table[key] = value
    return out


def build(spec, values):
    """One loop of a spec."""
    return spec.loop(values).build()


def test_values_follow_from_expressions():
    spec = parse(written())
    assert spec.grid().shape == (2, 3, 3, 2) and spec.question == spec.expectation == ""
    made = build(spec, {"method": "CN", "M": np.int64(2), "z": 0.3, "lift": 0.1})
    assert float(made.law.alpha) == pytest.approx(3.0, rel=1e-15)
    assert (made.Ts, made.N, made.method, made.stage.M, made.stage.maximum) == (0.1, 4, ck.METHODS["CN"], 2, 2)
    np.testing.assert_allclose(made.q0, [0, -np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(made.reference.curve.end, [0, 1.1], rtol=1e-15)
    assert float(made.reference.curve.duration) == pytest.approx(0.4)  # the run's length, when nothing is said


def test_what_the_number_of_steps_or_a_dead_time_depends_on_is_compiled_in():
    spec = parse(written(fixed__N="round(span/Ts)", fixed__span=1.0, fixed__Ts=None, axes__Ts=[0.1, 0.25]))
    of = spec.grid()
    assert [a.name for a in of.axes if not a.inner] == ["method", "Ts"]
    assert [spec.loop(program)["N"] for program in of.programs] == [10, 4, 10, 4]
    spec = parse(written(fixed__Ts=None, axes__Ts=[0.01, 0.02], axes__delay=["20ms", "40ms"], axes__M=[1]))
    delays = [spec.loop(p)["delay"] for p in spec.grid().programs if p["method"] == "EE"]
    assert delays == [2, 4, 1, 2]
    assert spec.grid().coordinates(spec.all_units())["delay"][2]["units"] == "1"  # not "20ms samples"
    spec = parse(written(fixed__M="k", fixed__seed="k", fixed__noise=1e-3, axes__M=None, axes__k=[1, 2]))
    assert [build(spec, program).stage.M for program in spec.grid().programs] == [1, 2, 1, 2]
    law, span = {"short": {"steps": 4}, "long": {"steps": "more"}}, {"a": {"more": 5}, "b": {"more": "3*k"}}
    spec = parse(written(fixed__N="steps", axes__law=law, axes__span=span, axes__k=[2, 3]))  # two tables use k together
    counts = [spec.loop(program)["N"] for program in spec.grid().programs if program["method"] == "EE"]
    assert counts == [4, 4, 4, 4, 5, 5, 6, 9]


def test_an_axis_of_tables_and_samples_that_fit_every_arm():
    case = {"two": {"robot": "planar:1,1", "target": [0, 1]}, "three": {"robot": "planar:1,1,1", "target": [0, 2]}}
    law = {"none": {}, "damped": {"damping": 0.1}}
    changes = {"fixed__target": None, "fixed__robot": None, "axes__lift": None, "figure": []}
    given = written(**changes, fixed__q0="0.1*turn", axes__case=case, axes__law=law)
    given["axes"]["turn"] = {"samples": 5, "low": -1, "high": 1, "seed": 3}
    spec = parse(given)
    assert [a.labels for a in spec.grid().axes[:2]] == [("two", "three"), ("none", "damped")]
    turn = next(a.values for a in spec.axes if a.name == "turn")
    assert turn.shape == (5, 3) and np.abs(turn).max() <= 1 and len(np.unique(turn)) == 15
    lane = {"turn": turn[2]}
    np.testing.assert_allclose(build(spec, lane | {"case": "two", "law": "none", "method": "EE"}).q0, 0.1 * turn[2, :2])
    laws = [build(spec, lane | {"case": "three", "law": name, "method": "EE"}).law for name in law]
    assert not hasattr(laws[0].inverse, "threshold") and float(laws[1].inverse.damping) == 0.1
    assert spec.all_units()["law"] == "1"
    arm = {"robot": "planar:1,1"}
    turned = parse({"metrics": ["max_error", "max_qdot"], "fixed": arm, "axes": {"task": ["xy", "rz"]}})
    assert turned.metric_units == {"max_error": "m or rad", "max_qdot": "rad/s"}
    given["axes"]["turn"]["seed"] = 4
    assert not np.array_equal(next(a.values for a in parse(given).axes if a.name == "turn"), turn)
    given["axes"]["turn"] |= {"low": [-1, 2, -3], "high": [1, 2.5, 3]}  # one for every joint
    turn = next(a.values for a in parse(given).axes if a.name == "turn")
    assert turn.shape == (5, 3) and (turn[:, 1] >= 2).all() and np.abs(turn[:, 2]).max() > 1


def test_changes_on_the_command_line(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(TEXT)
    spec = read(path, ["z=0.25", "axes.M=[5]", "method=RK4", "lift={linspace=[0, 1, 9]}", "tolerance=0.5"])
    assert [(a.name, len(a)) for a in spec.axes] == [("M", 1), ("lift", 9)]
    assert spec.fixed["z"] == 0.25 and spec.fixed["method"] == "RK4" and spec.tolerance == 0.5
    assert spec.figures == []  # which had the axis z
    spec = read(path, ["axes.law.damped.damping=0.1", "axes.law.none={}"])
    assert spec.tables == {"law": {"damped": {"damping": 0.1}, "none": {}}}
    for changes, words in ((["axes=3", "z=1"], "`axes` must be a table"), (["z"], "`set` must be NAME=VALUE")):
        with pytest.raises(ArgumentError, match=words):
            read(path, changes)


TABLES = {
    "line": {"start": [1, 1], "target": [0, 1], "period": 2.0, "feedforward": 0.5, "alpha": [2.0, 3.0]},
    "lissajous": {"frequency": [1, 2], "error_clamp": [0.1, 0.5], "damping": 0.1, "stage": "chord", "N": 7},
    "hold": {"target": [1, 0.5], "method": "CN", "Ts": 0.1, "limits": "velocity_scaling", "future": "unknown"},
}


@pytest.mark.parametrize("reference", TABLES)
def test_a_spec_builds_the_loop_of_problem_from(reference):
    table = {"robot": "planar:1,1", "task": "position", "reference": reference} | TABLES[reference]
    wanted, built = problem_from(**table), build(parse({"fixed": table}), {})
    names = ("law", "reference", "q0", "Ts", "N", "method", "stage")
    wanted, built = ({name: getattr(problem, name) for name in names} for problem in (wanted, built))
    assert jax.tree.structure(wanted) == jax.tree.structure(built)
    jax.tree.map(np.testing.assert_array_equal, wanted, built)


def test_a_path_that_depends_on_an_axis_and_is_begun_on_compiles_a_program_for_each_value():
    """Its start is searched for before: traced, the search compiled for minutes."""
    table = {"robot": "planar:1,1", "task": "xy", "reference": "circle", "begin": "on-path", "N": 4}
    spec = parse({"fixed": table, "axes": {"radius": [0.1, 0.2], "alpha": [1.0, 2.0]}})
    assert [a.name for a in spec.axes if not a.inner] == ["radius"]
    with pytest.raises(ArgumentError, match="hold single numbers, as each is compiled in"):
        parse({"fixed": table | {"reference": "line"}, "axes": {"start": [[1.0, 1.0], [1.5, 1.0]]}})


def test_the_linear_limit_is_a_value():
    spec = parse(written(fixed__alpha="z*min(limit, 10)/Ts", axes__method=["EE", "IE", "CN"]))
    lane = {"M": np.int64(2), "z": 0.5, "lift": 0.0}
    gains = {m: float(build(spec, lane | {"method": m}).law.alpha) / 5 for m in ("EE", "IE")}
    assert gains == pytest.approx({"EE": 2.0, "IE": 1.3532}, abs=1e-4)  # IE: docs/gains.md
    traced = jax.jit(lambda M: build(spec, lane | {"method": "CN", "M": M}).law.alpha / 5)
    assert float(traced(2)) == pytest.approx(1.4780, abs=1e-4)
    spec = parse(written(fixed__alpha="z*min(limit, 10)/Ts", fixed__stage="chord", axes__method=["IE"]))
    assert float(build(spec, lane | {"method": "IE"}).law.alpha) == pytest.approx(50.0)  # no limit
    lag = {"fixed__lag": 0.1, "fixed__Ts": None, "axes__Ts": [0.01, 0.1], "axes__method": ["EE"]}
    spec = parse(written(fixed__alpha="z*limit/Ts", **lag))
    assert [a.name for a in spec.axes if not a.inner] == ["method", "Ts"]  # on which the limit of a lag depends
    loop = spec.loop({"method": "EE", "Ts": 0.1})
    gain = ck.gains(Ts=0.1, drive=ck.Drive(lag=0.1), method="EE").largest_stable
    assert loop["alpha"] == pytest.approx(0.1 * gain, rel=1e-9)


def test_files_are_beside_the_spec_and_part_of_what_the_numbers_depend_on(tmp_path):
    (tmp_path / "way.csv").write_text("0,1,1\n1,0,1\n")
    path = tmp_path / "a.toml"
    text = TEXT.replace('"line"', '"way.csv"').replace("start = [1, 1]", "").replace('target = [0, "1 + lift"]', "")
    path.write_text(text)
    spec = read(path, ["lift=0", "alpha=z/Ts + lift"])
    np.testing.assert_allclose(build(spec, {"method": "EE"}).reference.curve(1.0)[0], [0, 1], atol=1e-12)
    before = spec.data()["files"]
    (tmp_path / "way.csv").write_text("0,1,1\n1,0,1.1\n")
    assert list(before) == ["way.csv"] and spec.data()["files"] != before


test_everything_wrong_is_said_in_one_line = refusals(
    ({"qestion": 1}, "`key of SPEC` must be one of question"),
    ({"axes__alpah": [1.0]}, "is 'alpah' (did you mean 'alpha'?)"),
    ({"fixed__tipp": "hand"}, "`tipp` must be an option (did you mean 'tip'?), or use names that have a value"),
    ({"fixed__alpha": "zz/Ts"}, "`alpha` must use names that have a value, but uses 'zz' (did you mean 'z'?)"),
    ({"fixed__metrics": ["mean_error"]}, "`metrics` must stand above all tables"),
    ({"fixed__alpha": "z*(method*1000000000)"}, "method is a name, not a number"),
    ({"fixed__Ts": "alpha*1"}, "not depend on itself, but does, through"),
    ({"fixed__alpha": "z*limit/Ts", "fixed__M": "round(alpha)", "axes__M": None}, "not depend on itself"),
    ({"axes__seed": [0, 0.5]}, "`axes.seed` must hold one whole number each, but is [0, 0.5]"),
    ({"fixed__Ts": True}, "`fixed.Ts` must be a number"),
    ({"fixed__N": 2.5}, "`N` must be an integer"),
    ({"fixed__robot": None}, "`robot` must be given in [fixed] or [axes]"),
    ({"fixed__q0": ["(-1)**0.5", 0]}, "the result is no real number"),
    ({"fixed__q0": [True, 0]}, "`q0` must hold numbers or vectors of one length"),
    ({"axes__method": ["EE", "RK5"]}, "`method` must be one of"),
    ({"axes__z": 3}, "`axes.z` must be a list, labelled tables, or a table with one of linspace, geomspace"),
    ({"axes__z": {"geomspace": [0, 1, 2]}}, "be geomspace = [first, last, count], without 0"),
    ({"axes__z": {"linspace": [0, 1, 10**12]}}, "at most 10,000,000 values, but asks for 1,000,000,000,000"),
    ({"axes__z": {"linspace": [-1e308, 1e308, 5]}}, "`axes.z` must hold finite values"),
    ({"fixed__q0": None, "axes__q0": {"samples": 2, "high": [1, 1, 1]}}, "be samples = count, low and high"),
    ({"axes__damping": [0.1, -0.1]}, "`damping` must be positive, but is -0.1"),
    ({"axes__noise": [[1, 1], [2, -5], [3, 1]]}, "`noise` must be at least 0, but is [2.0, -5.0]"),
    (
        {f"fixed__{name}": None for name in ("start", "target")}
        | {"fixed__reference": "circle", "axes__lift": None, "axes__period": [-1, 0, 1]},
        "`period` must not be 0",
    ),
    ({"axes__M": [1.5]}, "`axes.M` must hold one whole number each"),
    ({"axes__Ts": [0.1]}, "`fixed.Ts` must be given once, but is given by another axis, too"),
    ({"axes__law": {"a": {"N": 3}}, "axes__n": {"b": {"N": 4}}}, "`axes.n.b.N` must be given once"),
    ({"axes__alpha": {"a": {}}, "fixed__alpha": None}, "`axes.alpha` must have another name"),
    ({"axes__limit": [1.0], "fixed__alpha": "limit/Ts"}, "`axes.limit` must have another name"),
    ({"metrics": ["rms_rotation_error"]}, "be ones of the task"),
    ({"units": {"z": 3}}, "`units.z` must be a text"),
    ({"fixed__N": None, "axes__N": {"linspace": [1, 10000, 10000]}}, "span at most 1,000 programs"),
    ({"fixed__delay": "34kg"}, "but is '34kg' (units: s, ms, us, sample, samples)"),
    ({"fixed__q0": "100mm 200mm"}, "joint 'q1' is in rad, and m is given"),
    ({"fixed__mine": "4ms"}, "`mine` must be a number or a short expression"),
    ({"figure": [3]}, "`figure` must be a list of tables"),
    ({"figure": [{"kind": "heatmap"}]}, "`figure[0].kind` must be one of"),
    ({"figure": [{"kind": "heat", "limits": [1]}]}, "`figure[0].limits` must have 2 numbers, but has 1"),
    ({"figure": [{"kind": "heat", "xx": "z"}]}, "but is 'xx' (did you mean 'x'?)"),
    ({"figure": [{"kind": "heat", "name": "../up"}]}, "`figure[0].name` must be a file's name without a folder"),
    of=lambda **changes: pictures.check(parse(written(**changes))),
)


def test_what_cannot_be_read_is_said_in_one_line(tmp_path):
    path = tmp_path / "a.toml"
    for text in ("question = ", "question = " + "9" * 5000, "a = " + "[" * 5000 + "]" * 5000):
        path.write_text(text)
        with pytest.raises(ArgumentError):
            read(path)
    with pytest.raises(ArgumentError, match="No such file"):
        read(tmp_path / "none.toml")
    path.write_text(TEXT)
    with pytest.raises(ArgumentError, match="`robot` must be a URDF or MJCF file"):  # and no name is too long for it
        read(path, ["robot=" + "a" * 5000])
    with pytest.raises(ArgumentError, match="short expression"):
        read(path, ["alpha=" + "{a=" * 500 + "1" + "}" * 500])


def test_no_grid_beyond_what_can_be_stored():
    with pytest.raises(ArgumentError, match=r"span at most 1,000,000,000 points, but span .* 1,001 of a × "):
        Grid(tuple(axis(name, np.arange(1001.0)) for name in "abc"), 1)
    alone = written(axes=None, figure=None)
    alone["fixed"] |= {"M": 2, "z": 0.5, "lift": 0.1, "method": "CN"}
    assert float(build(parse(alone), {}).Ts) == 0.1
    with pytest.raises(ArgumentError, match="`axes` must hold at least one axis"):
        parse(alone).grid()


def test_expressions_are_arithmetic():
    known = {"a": 2.0, "n": 3}.__getitem__
    assert expression.evaluate("x", "-a**2 + 3*sqrt(4)/n - +1", known) == -4 + 2 - 1
    assert expression.evaluate("x", "round(a/0.7)", known) == 3
    assert expression.evaluate("x", "min(a, n) + max(1, 0.5)", known) == 3
    assert expression.evaluate("x", "2**10 + 10**-2 + (-1)**3 + 1e-3", known) == 1024 + 0.01 - 1 + 1e-3
    assert expression.names("x", ["a + b", 3, "sin(c)*pi"]) == {"a", "b", "c"}
    for huge in ("9**9**9", "9 ** 9**9**9", "(2**900)**900", "n**9**9", "a/0", "0xFF**0xFFFFFF", "(b + b)**9999999999"):
        with pytest.raises(ArgumentError, match="worked out"):
            expression.evaluate("x", huge, {"a": 2.0, "n": 3, "b": True}.__getitem__)
    assert np.isnan(expression.evaluate("x", "a*z", {"a": np.float64(np.inf), "z": 0}.__getitem__))
    for bad in ("a.b", "sin .b", "(a).real", "(\nsqrt.func.__globals__)", "a[0]", "[a]", "{a}", "(a, a)", "lambda: 1",
                "(a for a in a)", "(a := 2)", "a if a else 2", "not a", "a and 2", "a < 4", "a // 2", "True", "None",
                "(True + True)**9", "'s'", "f'{a}'", "1j", "sin(a, a)", "sin()", "max(a)", "max(*a)", "sin(x=a)",
                "sin(a)(a)", "pi()", "exec(a)", "__import__(a)",
                "1" + "0" * 600, "(" * 250 + "a" + ")" * 250):  # fmt: skip
        with pytest.raises(ArgumentError, match="be a number or a short"):
            expression.evaluate("x", bad, known)
    with pytest.raises(ArgumentError, match="no real number"):
        expression.evaluate("x", "sin", known)
    with pytest.raises(KeyError):  # a name that has no value
        expression.evaluate("x", "print", known)


@pytest.mark.parametrize("path", sorted((ROOT / "sweeps").glob("*.toml")), ids=lambda path: path.stem)
def test_every_study_is_read_and_built_and_its_results_are_committed(path):
    spec = read(path)
    pictures.check(spec)
    assert build(spec, spec.grid().programs[0]).N > 0
    config = json.loads((ROOT / "results" / path.stem / "config.json").read_text())
    about = spec.data()
    about.pop("files", None)
    assert {name: config["spec"][name] for name in about} == json.loads(json.dumps(about))
    axes = [[a.name, len(a), a.inner] for a in spec.axes]
    assert config["config"].get("axes", axes) == axes


SPEC = tomllib.loads(reaching(["final_error"], method=["EE", "IE"], alpha=[1.0, 5.0], Ts=[0.01, 0.1]))
SHIFT = 1e-6  # of the target: small enough for a linear loop
AT = -np.sin(0.3) - np.sin(1.4), np.cos(0.3) + np.cos(1.4)  # the tip at q0


def stable(drive, method="EE", Ts=0.1):
    """The largest stable z."""
    return Ts * gains(Ts=Ts, drive=drive, method=method).largest_stable


def spec(metrics, N, fixed=(), **axes):
    """Loops of explicit Euler at Ts = 0.1, beside their target."""
    made = tomllib.loads(reaching(metrics, N=N))
    made["fixed"] |= {"q0": [0.3, 1.1], "target": [AT[0] + SHIFT, AT[1]], "Ts": 0.1, "method": "EE"} | dict(fixed)
    return parse(made | {"axes": axes})


def limit(fixed=(), drop=(), name="limit", **axes):
    """A coordinate of a variation of the spec: (dimensions, values), or None."""
    written = copy.deepcopy(SPEC)
    written["fixed"] |= dict(fixed)
    written["axes"] |= axes
    for dropped in drop:
        written["axes"].pop(dropped)
    found = parse(written)
    found = found.coordinates(found.grid()).get(name)
    return found and found[:2]


def test_the_limit_is_over_the_axes_on_which_it_depends():
    dims, values = limit()
    assert dims == ("method",)
    np.testing.assert_allclose(values, [2, stability_limit(ck.METHODS["IE"], ck.picard(5))], rtol=1e-9)
    dims, values = limit(M=[1, 2, 5], method=["IE"])
    assert dims == ("method", "M")
    np.testing.assert_allclose(
        values[0], [stability_limit(ck.METHODS["IE"], ck.picard(m)) for m in (1, 2, 5)], rtol=1e-9
    )
    assert limit({"method": "EE"}, ["method"]) == ((), 2.0)
    assert limit({"N": "round(1/Ts)"})[0] == ("method",)  # Ts is compiled in, and the limit doesn't depend on it
    assert limit({"alpha": "z/Ts"}, ["alpha"], z=[0.5, 1.5])[0] == ("method",)
    laws = {"exact": {}, "damped": {"damping": 0.1}}
    assert limit(method=["EE"], law=laws) == (("method",), [2.0])  # with damping a little more may be stable
    dims, values = limit(lag=[0.05, 0.3], method=["EE"])  # with a lag z depends on Ts
    assert dims == ("method", "Ts", "lag") and len(values.ravel()) == 4
    np.testing.assert_allclose(values[0, 1, 1], stable(Drive(lag=0.3)), rtol=1e-9)
    assert limit(method=["EE"], lag=np.linspace(0.1, 0.2, 501).tolist()) is None  # too many
    quick, slow = {"alpha": "z/Ts", "Ts": "1ms"}, {"alpha": ["2*z/Ts", "z"], "Ts": 0.1}  # z is no alpha·Ts
    dims, values = limit({}, ["alpha", "Ts"], "alpha_Ts", z=[0.5, 1.5], law={"quick": quick, "slow": slow})
    assert dims == ("law", "z")
    np.testing.assert_allclose(values, [[0.5, 1.5], [1.0, 3.0]], rtol=1e-9)
    assert limit({"lag": [0.1, 0.2]}, method=["EE"])[0] == ("method", "Ts")
    assert limit({"lag": [0.1, 0.2]}, method=["EE"], alpha=[[1.0, 2.0]]) is None  # drives and gains differ
    law, rate = {"given": {"alpha": 2}, "scaled": {"alpha": "r"}}, {"one": {"r": 3}, "more": {"r": "10*k"}}
    dims, values = limit({"Ts": 0.1}, ["alpha", "Ts", "method"], "alpha_Ts", k=[1.0, 2.0], law=law, rate=rate)
    assert dims == ("law", "rate", "k")  # which only two tables together use
    np.testing.assert_allclose(values[1], [[0.3, 0.3], [1, 2]], rtol=1e-9)


def test_noise_at_rest_is_as_large_as_theory_says():
    """e[k+1] = e[k] − r(e[k] + n[k]) has variance r/(2 − r) σ²: r = z of explicit, 1 − e^{−z} of exponential Euler."""
    sigma, z = 1e-6, np.array([0.3, 1.0, 1.6])
    axes = {"z": z.tolist(), "noise": [[sigma, 0.0], [sigma, sigma]], "seed": list(range(8))}
    fixed = {"alpha": "z/Ts", "target": list(AT)}
    for method, removed in (("EE", z), ("EXP-EE", -np.expm1(-z))):
        found = run_spec(spec(["rms_error"], 1000, fixed | {"method": method}, **axes)).rms_error
        variance = (found**2).mean("seed").values / sigma**2
        theory = removed / (2 - removed)
        np.testing.assert_allclose(variance, np.stack([theory, 2 * theory], 1), rtol=0.06)
        assert len(np.unique(found)) == found.size  # every seed its own


def test_loops_through_a_lag_end_where_theory_says():
    """With the limit in an expression, half a sample of dead time included."""
    for drive in ({"lag": 0.3, "delay": 1}, {"delay": 0.5}):
        found = run_spec(spec(["final_error"], 400, drive | {"alpha": "share*limit/Ts"}, share=[0.95, 1.05]))
        assert found.final_error[0] < 0.2 * SHIFT and found.final_error[1] > SHIFT
        assert found.limit == pytest.approx(stable(Drive(**drive)), rel=1e-9)
