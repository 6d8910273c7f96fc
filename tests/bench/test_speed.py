"""`python -m tests.bench.speed`: which lines it runs, and what it prints where."""

import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

import cnclik as ck
from tests.bench import cases
from tests.bench import speed as cli
from tests.bench import timing as bench

ROOT = pathlib.Path(__file__).parents[2]


def run(*args):
    command = [sys.executable, "-m", "tests.bench.speed", *args]
    environment = dict(os.environ) | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    return subprocess.run(command, env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_json_is_all_there_is_on_stdout():
    one = "--robot planar2 --method CN --stage picard --M 2 --dtype float64 --batch 3 --cores 1 --N 4 --seconds 0"
    done = run(*one.split(), "--json")
    assert done.returncode == 0, done.stderr
    (record,) = json.loads(done.stdout)
    asked = {"robot": "planar2", "method": "CN", "stage": "picard", "M": 2, "dtype": "float64", "batch": 3, "cores": 1}
    assert {name: record[name] for name in asked} == asked
    # CN with picard(2): the slope at the start and two passes.
    assert record["evaluations_per_second"] == pytest.approx(3 * 4 * 3 / record["run_s"], rel=1e-12)
    assert 0 < record["run_s"] < record["compile_s"] < 600
    assert 50 < record["base_mib"] <= record["peak_mib"] < 4096
    assert 0.1 < record["gradient_over_forward"] < 100
    assert "planar2" in done.stderr
    # The loops were those of solve.
    case = cases.ROBOTS["planar2"]()
    ends = [
        np.linalg.norm(ck.solve(case.law, ck.hold(goal), q0, cases.TS, 4, ck.CN, ck.picard(2)).e[-1])
        for q0, goal in zip(*cases.inputs(case, 3, "float64").values(), strict=True)
    ]
    assert record["error"] == pytest.approx(np.mean(ends), rel=1e-12)


def test_a_line_that_fails_is_told_and_the_others_run(monkeypatch, capsys):
    def measure(line, seconds):
        if line.method == "EE":
            raise bench.LineError("out of memory")
        return {"robot": line.robot, "method": line.method, "stage": line.stage, "M": 5, "dtype": line.dtype} | {
            "batch": 1, "cores": 1, "N": 1, "evaluations_per_second": 1e6, "run_s": 1e-6, "spread": 0.1,
            "compile_s": 1.0, "peak_mib": 1.0, "device": "none", "jax": "0",
        }  # fmt: skip

    monkeypatch.setattr(bench, "measure_apart", measure)
    with pytest.raises(SystemExit) as left:
        cli.run(cli.Args(robot=("ur5",), method=("EE", "CN"), dtype=("float32",), batch=(1,), json=True))
    assert left.value.code == 1
    out, err = capsys.readouterr()
    assert [r["method"] for r in json.loads(out)] == ["CN"]
    assert "ur5 EE picard(5) float32 batch 1: not measured: out of memory" in " ".join(err.split())


def test_the_table_goes_through_every_value():
    lines = cli.asked(cli.Args())
    assert len(lines) == len(set(lines)) < 40
    assert {line.robot for line in lines} == {"planar2", "planar5", "panda", "ur5", "chain30"}
    assert {line.dtype for line in lines} == {"float32", "float64"}
    assert {line.batch for line in lines} >= {1, 64, 4096, 1_000_000}
    assert {(line.method, line.stage) for line in lines} == {
        ("EE", "picard"), ("IE", "picard"), ("CN", "picard"), ("TRAPEZOID", "chord"),
        ("EXP-EE", "picard"), ("EXP-MIDPOINT", "picard"),
    }  # fmt: skip
    assert any(line.gradient for line in lines) and not all(line.gradient for line in lines)
    assert len(cli.asked(cli.Args(all=True))) == 5 * 4 * 2 * 4


def test_the_table_has_the_robots_that_there_are():
    assert tuple(cases.ROBOTS) == cli.lines.ROBOTS


def test_filters():
    one = cli.Args(
        robot=("panda",), method=("EE",), stage=("picard",), M=(5,), dtype=("float32",), batch=(65536,), cores=(1,)
    )
    (line,) = cli.asked(one)
    assert (line.batch, line.cores, line.M, line.gradient) == (65536, 1, 5, True)
    # Axes without a filter take all values of the table.
    lines = cli.asked(cli.Args(robot=("panda",), batch=(8,), gradient=False))
    assert {(line.robot, line.batch, line.gradient) for line in lines} == {("panda", 8, False)}
    assert len(lines) == 4 * 2


def test_bad_values_are_one_line_and_exit_2():
    done = run("--robot", "panda", "--batch", "0")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "Argument `batch` must be at least 1, but is 0.\n"


def test_cold_starts_are_one_table():
    done = run("--cold", "--only", "version", "robots")
    assert (done.returncode, done.stderr) == (0, "")
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in done.stdout.splitlines()]
    assert [row[0] for row in rows[2:]] == ["`--version`", "`robots ROBOT`"]
    assert all(0 < float(row[i].split()[0]) < 10 for row in rows[2:] for i in (1, 2))
    assert all(float(row[3]) < 100 for row in rows[2:])  # of the command, not of who measures


@pytest.mark.slow
def test_first_calls_in_python_are_timed_by_themselves():
    from tests.bench import cold

    (line,) = (line for line in cold.table() if line.name == "ck.step")
    found = cold.measure(line)
    assert 0 < found["again_s"] < found["cold_s"] and found["cold_mib"] > 100


def test_a_cold_start_that_fails_is_told(monkeypatch, capsys):
    from tests.bench import cold

    monkeypatch.setattr(
        cold, "table", lambda spec: [cold.Line("solv", ("solv",), 1, 1), cold.Line("x", ("--version",))]
    )
    with pytest.raises(SystemExit) as left:
        cli.run(cli.Args(cold=True, json=True))
    out, err = capsys.readouterr()
    first, second = json.loads(out)
    assert left.value.code == 1 and first["cold_s"] is None and second["again_s"] > 0
    assert "did you mean 'solve'" in first["error"] and "solv: not measured: " in err
    monkeypatch.setattr(cold, "MOST_SECONDS", 0.01)
    assert "cut off" in cold.measure(cold.Line("x", ("--version",)))["error"]


@pytest.mark.parametrize("option", [("--only", "nothing"), ("--urdf", "no.urdf")])
def test_bad_options_of_cold_starts(option):
    done = run("--cold", *option)
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1


def test_options_of_cold_starts_alone_are_refused():
    done = run("--urdf", "no.urdf")  # it began the whole table
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "Argument `urdf` must be left out without --cold, but is 'no.urdf'.\n"
