"""The command line's frame: verbs, help, one line for what is wrong; and what importing cnclik loads."""

import dataclasses
import pathlib
import re
import subprocess
import sys
import typing

import pytest

from cnclik import errors
from cnclik.cli import VERBS, arguments, main


def test_overview_names_every_verb(capsys):
    main([])
    shown = capsys.readouterr().out
    assert all(verb in shown for verb in VERBS) and "usage: cnclik VERB" in shown


def test_version(capsys):
    main(["--version"])
    assert capsys.readouterr().out.startswith("cnclik ")


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb(verb, capsys):
    with pytest.raises(SystemExit) as left:
        main([verb, "--help"])
    shown = capsys.readouterr().out
    assert not left.value.code and f"usage: cnclik {verb}" in shown
    assert not re.search(r"\w-\n", shown)  # a name in two lines can't be copied


def test_unknown_verb_suggests_the_nearest(capsys):
    with pytest.raises(SystemExit) as left:
        main(["reproduse"])
    assert left.value.code == 2
    assert capsys.readouterr().err.strip().endswith("but is 'reproduse' (did you mean 'reproduce'?).")


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of every kind."""

    steps: int = 3
    Ts: float = 0.1
    pair: tuple[int, int] = (1, 2)
    kind: typing.Literal["one", "two"] = "one"
    gain: float | None = None
    out_dir: str = "x"


@pytest.mark.parametrize(
    "argv, says",
    [
        (["--steps", "x"], "Option `--steps` must be an integer, but is 'x'."),
        (["--steps", "1.5"], "Option `--steps` must be an integer, but is '1.5'."),
        (["--Ts=ab"], "Option `--Ts` must be a number, but is 'ab'."),
        (["--gain", "p"], "Option `--gain` must be a number, but is 'p'."),
        (["--kind", "three"], "Option `--kind` must be one of one, two, but is 'three'."),
        (["--pair", "1"], "Option `--pair` must be 2 integers, but is '1'."),
        (["--pair"], "Option `--pair` must be given 2 integers, but has no value."),
        (["-s", "1"], "but is '-s' (did you mean '--Ts'?)."),
        (["--pair", "1", "k"], "Option `--pair` must be 2 integers, but is '1 k'."),
        (["--out-dir"], "Option `--out-dir` must be given a text, but has no value."),
        (["--ts", "3"], "(did you mean '--Ts'?)."),
        (["--step", "3"], "(did you mean '--steps'?)."),
        (["loose"], "but is 'loose'."),
    ],
)
def test_wrong_options_are_one_line(argv, says, capsys):
    with pytest.raises(errors.ArgumentError) as caught:
        arguments.parse(Args, argv, prog="cnclik x", description="x")
    message = str(caught.value)
    assert message.endswith(says) and "\n" not in message
    assert capsys.readouterr().err == ""


def test_options_are_named_as_they_are_typed():
    from cnclik.cli.solve import Args as Solve

    with pytest.raises(errors.ArgumentError, match="did you mean '--from'"):
        arguments.parse(Solve, ["panda", "--form", "1"], prog="x", description="x")
    with pytest.raises(errors.ArgumentError, match="--from, --to,") as caught:
        arguments.parse(Solve, ["panda", "--zzz", "1"], prog="x", description="x")
    assert "--robot" not in str(caught.value)
    for argv, says in (
        (["--hz", "250"], "(did you mean '--Ts'?). A rate of 250 Hz is --Ts 4ms."),
        (["--rate=500Hz"], "(did you mean '--Ts'?). A rate of 500 Hz is --Ts 2ms."),
        (["--Ts", "250Hz"], "(units: s, ms, us). A rate of 250 Hz is --Ts 4ms."),
        (["--dt", "0.01"], "(did you mean '--Ts'?)."),
        (["--gain", "5"], "(did you mean '--alpha'?)."),
        (["--latency", "5"], "(did you mean '--delay'?)."),
        (["--dead_time", "5"], "(did you mean '--delay'?)."),
    ):
        with pytest.raises(errors.ArgumentError) as caught:
            arguments.parse(Solve, ["panda", *argv], prog="x", description="x")
        assert str(caught.value).endswith(says)
    said = arguments.of_options(Solve, errors.fail("damping_ratio", "come with `natural_frequency`", "comes without"))
    assert said == "Option `--damping-ratio` must come with `--natural-frequency`, but comes without."
    from cnclik.cli.export import Args as Export

    with pytest.raises(errors.ArgumentError, match="Option `--out` must be given, but is not"):
        arguments.parse(Export, ["panda"], prog="x", description="x")
    with pytest.raises(errors.ArgumentError, match="Argument `ROBOT` must be given, but is not: A URDF or MJCF file"):
        arguments.parse(Solve, [], prog="x", description="x")


def test_right_options_pass():
    args = arguments.parse(Args, ["--Ts", "0.5", "--pair", "3", "4", "--gain", "2"], prog="x", description="x")
    assert args == Args(Ts=0.5, pair=(3, 4), gain=2.0)


ROOT = pathlib.Path(__file__).parents[2]


def run(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


OTHERS = """
import jax, jax.numpy, lazy_loader, numpy, sys, time
before, start = {m.partition(".")[0] for m in sys.modules}, time.process_time()
import cnclik as ck
others = lambda: {m.partition(".")[0] for m in sys.modules} - before - set(sys.stdlib_module_names) - {"cnclik"}
"""


def test_import_is_light():
    """No package but jax, numpy and lazy_loader, and under a second beyond them, of processor time."""
    late = "'cnclik.sweeps.sweep' in sys.modules"
    *said, seconds = run(OTHERS + f"print(others(), {late}, time.process_time() - start)").split()
    assert said == ["set()", "False"] and float(seconds) < 1


def test_names_loaded_on_use_are_public_and_light():
    unknown = "[n for n in ('Metrics', 'measure_run', 'sweep') if n not in dir(ck) or not getattr(ck, n)]"
    same = "ck.sweep is __import__('cnclik.sweeps.sweep', fromlist='x').sweep"
    code = OTHERS + "from cnclik import measure_run\n" + f"print({unknown}, others(), {same}, hasattr(ck, 'sweeep'))"
    assert run(code) == "[] set() True False"


def test_solver_search_advice_and_export_stand_on_jax_and_numpy(tmp_path):
    """With nothing else installed: what draws, stores and prints is not even looked for."""
    code = f"""
import sys
class Missing:
    def find_spec(name, path=None, target=None):
        if name in "matplotlib xarray zarr h5py h5netcdf rich optax viser".split():
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing)
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
import cnclik as ck
arm, q0 = ck.planar_arm([1.0, 0.8]), np.array([0.3, 0.6])
law, there = ck.Law(arm, ck.position("xy"), alpha=5.0), ck.hold([1.2, 0.9])
run = ck.solve(law, there, q0, 0.01, 300)
ck.step(law, there, q0, 0.0, 0.01)
ck.lanes(lambda q: ck.solve(law, there, q, 0.01, 3).q[-1])(np.tile(q0, (8, 1)))
jax.jit(ck.native(jnp.sin))(q0)
assert ck.reach(arm, (np.array([1.2, 0.9, 0.0]), None), task=ck.position("xy")).solved
assert ck.verdict(law, there, run, Ts=0.01).kind == "settled"
print(ck.advise(law, Ts=0.01).gains.recommended > 0, end=" ")
ck.export.c(law, out={str(tmp_path / "made")!r})
try:
    ck.plot(run)
except ModuleNotFoundError as error:
    print(error)
"""
    assert run(code) == "True No module named 'matplotlib'"


def test_answers_that_hold_no_number_need_no_jax():
    """Help, version, a wrong verb and a wrong option load nothing that takes long."""
    code = """
import contextlib, io, sys
from cnclik.cli import VERBS, main
for argv in ["--version"], ["--help"], [], ["solv"], *([v, o] for v in VERBS for o in ("--help", "--bogus")):
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            main(argv)
    except SystemExit as left:
        assert left.code == (0 if "--help" in argv else 2)
heavy = "jax numpy scipy matplotlib xarray optax rich yourdfpy".split()
print([name for name in heavy if name in sys.modules])
"""
    assert run(code) == "[]"


def test_parts_of_verbs_load_no_room_that_few_answers_need():
    """Reach and export without stability; gains without JAX."""
    code = """
import contextlib, io, sys
from cnclik.cli import main
with contextlib.redirect_stdout(io.StringIO()) as said:
    main("stability --Ts 2ms --delay 34ms --lag 20ms --alpha 3".split())
print("recommended" in said.getvalue(), "jax" in sys.modules, end=" ")
import cnclik.problem.heading, cnclik.problem.targets
print([name for name in sys.modules if name in ("cnclik.stability.advice", "cnclik.stability.ending")])
"""
    assert run(code) == "True False []"


def test_a_file_is_shown_without_jax():
    code = """
import contextlib, io, sys
from cnclik.cli import main
with contextlib.redirect_stdout(io.StringIO()) as said:
    main(["robots", "sweeps/arm3.urdf"])
print([name for name in ("jax", "numpy", "yourdfpy") if name in sys.modules], "Tips" in said.getvalue())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[] True"


def test_a_built_in_robot_is_shown_and_its_tip_may_be_named(capsys):
    main(["robots", "panda"])
    said = capsys.readouterr().out
    assert said.startswith("panda, built in, tip flange\n") and said.count("revolute") == 7
    main(["reach", "panda", "--tip", "flange", "--random", "1", "--json"])
    assert '"SOLVED": 1' in capsys.readouterr().out


def test_words_are_those_that_are_built():
    """The command line's names are read without the functions behind them."""
    from cnclik.integrate.method import METHODS
    from cnclik.problem import words

    tables = words.ROBOTS, words.INVERSES, words.LIMITS, words.REFERENCES, words.STAGES
    assert all(callable(takes.function()) for table in tables for takes in table.values() if takes.maker)
    assert tuple(METHODS) == words.METHODS


def test_names_may_be_asked_for_first_inside_a_program():
    """What a module makes of arrays when it is loaded must not belong to the program that was being traced."""
    code = """
import jax, jax.numpy as jnp, cnclik as ck
def end(x):
    law = ck.Law(ck.planar_arm([1.0, x]), ck.position("xy"), alpha=5.0)
    return ck.solve(law, ck.hold(jnp.array([1.0, 1.0])), jnp.array([0.3, 0.5]), 0.01, 3).q[-1]
first = jax.jit(end)(1.0)
print(bool(jnp.allclose(first, end(1.0), rtol=1e-5)), float(jax.jit(jax.grad(lambda x: end(x)[0]))(1.0)) != 0)
"""
    assert run(code) == "True True"


def test_one_bad_line_from_a_shell():
    done = subprocess.run(
        [sys.executable, "-m", "cnclik", "reproduce", "--readin", "x"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "did you mean '--reading'" in done.stderr
