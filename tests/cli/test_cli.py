"""The command line's frame: verbs, help, options, units, the progress bar; and what importing and asking loads."""

import importlib
import importlib.util
import math
import re
import subprocess
import sys

import pytest

from cnclik import errors, quantities
from cnclik.cli import VERBS, arguments, diagnose, main, progress, reach, solve, stability
from cnclik.problem.options import OPTIONS, in_own_units


def test_overview_and_version(capsys):
    main([])
    shown = capsys.readouterr().out
    assert all(verb in shown for verb in VERBS) and "usage: cnclik VERB" in shown
    main(["--version"])
    assert capsys.readouterr().out.startswith("cnclik ")


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "9" if verb == "view" else "80")  # as narrow as a terminal may be
    main([verb, "--help"])
    shown = capsys.readouterr().out
    assert f"usage: cnclik {verb}" in shown
    assert not re.search(r"\w-\n", shown)  # a name in two lines can't be copied
    assert ("FILE.py" in shown) == (verb in ("solve", "stability", "view", "export"))
    if verb in ("solve", "export"):
        titles = re.findall(r"^([a-z ]+):$", shown, re.M)
        groups = ["robot and task", "path", "law", "loop", *["drive"] * (verb == "solve"), "output"]
        assert [t for t in titles if t != "options"] == groups


def test_the_options_are_few():
    modules = (importlib.import_module(f"cnclik.cli.{verb}") for verb in VERBS)
    every = {n for m in modules for some in arguments.options_of(m).values() for n in some if not some[n].positional}
    assert len(every) <= 45, sorted(every)


def test_right_options_pass():
    argv = ["panda", "--alpha", "2", "3", "--method", "CN", "--N", "3", "--no-figures", "--out", "x"]
    asked = {"robot": "panda", "figures": False, "alpha": [2.0, 3.0], "method": "CN", "N": [3.0], "out": "x"}
    assert arguments.parse(solve, argv, prog="x", description="x") == asked
    said = arguments.of_options(solve, errors.fail("out", "come with `Ts` and `what`", "comes without"))
    assert said == "Option `--out` must come with `--Ts` and `what`, but comes without."


# --- what is loaded ------------------------------------------------------------------------------------


def run(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_answers_that_hold_no_number_and_gains_need_no_jax():
    """Help, version, a wrong verb, a wrong option and `cnclik stability` load nothing that takes long."""
    code = """
import contextlib, io, sys
from cnclik.cli import VERBS, main
for argv in ["--version"], ["--help"], [], ["solv"], *([v, o] for v in VERBS for o in ("--help", "--bogus")):
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            main(argv)
    except SystemExit as left:
        assert left.code == (0 if "--help" in argv else 2)
heavy = "jax matplotlib xarray optax scipy".split()
print([name for name in [*heavy, "rich"] if name in sys.modules], end=" ")
with contextlib.redirect_stdout(io.StringIO()):
    main(["stability", "--Ts", "2ms", "--delay", "34ms"])
print([name for name in heavy if name in sys.modules])
"""
    assert run(code) == "[] []"


def test_importing_is_light_and_the_library_stands_on_jax_and_numpy(tmp_path):
    """With nothing else installed but lazy_loader: what draws, stores and prints is not even looked for.

    Importing takes under half a second beyond these, of processor time. Names may be asked for first inside a program:
    what a module makes of arrays when it is loaded must not belong to the program that was being traced.
    """
    code = f"""
import sys, time
class Missing:
    def find_spec(name, path=None, target=None):
        if name in "matplotlib xarray zarr h5py h5netcdf rich optax viser".split():
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing)
import jax, jax.numpy as jnp, lazy_loader, numpy as np
jax.config.update("jax_enable_x64", True)
before, start = {{m.partition(".")[0] for m in sys.modules}}, time.process_time()
import cnclik as ck
seconds = time.process_time() - start
def end(x):
    law = ck.Law(ck.planar_arm([1.0, x]), ck.position("xy"), alpha=5.0)
    return ck.solve(law, ck.hold(jnp.array([1.0, 1.0])), jnp.array([0.3, 0.5]), 0.01, 1, "EE").q[-1]
first = jax.jit(end)(1.0)
print(bool(jnp.allclose(first, end(1.0), rtol=1e-5)), end=" ")
unknown = [n for n in ("Drive", "measure", "sweep") if n not in dir(ck) or not getattr(ck, n)]
others = {{m.partition(".")[0] for m in sys.modules}} - before - set(sys.stdlib_module_names) - {{"cnclik"}}
print(others, unknown, seconds < 0.5, hasattr(ck, "sweeep"))
arm, q0 = ck.planar_arm([1.0, 0.8]), np.array([0.3, 0.6])
law, there = ck.Law(arm, ck.position("xy"), alpha=5.0), ck.hold([1.2, 0.9])
run = ck.solve(law, there, q0, 0.01, 300)
ck.step(law, there, q0, 0.0, 0.01)
ck.lanes(lambda q: ck.solve(law, there, q, 0.01, 3).q[-1])(np.tile(q0, (8, 1)))
jax.jit(ck.native(jnp.sin))(q0)
assert ck.reach(arm, (np.array([1.2, 0.9, 0.0]), None), task=ck.position("xy")).solved
assert ck.verdict(law, there, run).kind == "settled"
print(ck.advise(law, Ts=0.01).gains.recommended > 0, end=" ")
ck.export.c(law, out={str(tmp_path / "made")!r})
try:
    ck.plot(run, law)
except ModuleNotFoundError as error:
    print(error)
"""
    assert run(code) == "True set() [] True False\nTrue No module named 'matplotlib'"


def test_lines_without_a_terminal(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    with progress.bar("loops") as report:
        for now[0], *each in [(0.0, 0, 400), (50.0, 100, 400, "EE"), (59.0, 200, 400), (61.0, 300, 400)]:
            report(*each)
    assert capsys.readouterr().err.splitlines() == ["100 of 400 loops, EE", "300 of 400 loops"]


def test_a_terminal_gets_a_bar(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.bar("loops") as report:
        report(0, 3)
        report(2, 3, "[EE]")
    out, err = capsys.readouterr()
    assert out == "" and "2 of 3 loops" in err and "[EE]" in err


NUMBERS = [  # verb, arguments, option, values
    (solve, "--Ts 4 ms --delay 34 ms", "delay", 8.5),
    (solve, "--delay=2samples", "delay", 2.0),
    (solve, "--Ts 500µs", "Ts", 5e-4),
    (solve, "--lag 20ms 30ms", "lag", (0.02, 0.03)),
    (solve, "--q0 0 -90 90 deg", "q0", (0, -math.pi / 2, math.pi / 2)),
    (solve, "--q0 -90 45 deg 100 mm", "q0", (-math.pi / 2, math.pi / 4, 0.1)),
    (solve, "--q0 0 0.5 -1", "q0", (0, 0.5, -1)),
    (solve, "--target 300 -300 500 mm 1 0 0 0", "target", (0.3, -0.3, 0.5, 1, 0, 0, 0)),
    (solve, "--speed 500mm/s", "speed", 0.5),
    (solve, "--natural-frequency 5Hz", "natural_frequency", 10 * math.pi),
    (reach, "--random 1 --near 90deg 100 mm", "near", (math.pi / 2, 0.1)),
    (stability, "--speed 100mm/s", "speed", 0.1),
    (diagnose, "--Ts 2ms", "Ts", 2e-3),
]


@pytest.mark.parametrize(("verb", "argv", "name", "wanted"), NUMBERS)
def test_a_number_may_have_a_unit(verb, argv, name, wanted):
    place = "log.csv" if verb is diagnose else "panda"
    made = arguments.parse(verb, [place, *(argv.split() if isinstance(argv, str) else argv)], prog="", description="")
    shared = {key: value for key, value in made.items() if isinstance(value, (str, list)) and key in OPTIONS}
    assert (made | in_own_units(shared))[name] == pytest.approx(wanted, rel=1e-12)


def test_a_number_read_aloud_has_at_most_three_digits():
    """A wall was missed by "1e+03 mm/s"."""
    said = [quantities.aloud(v, "m") for v in (0.99996, -0.0009999, 9.996e-7, 0.0123, 3e-10, 0.0)]
    assert said == ["1 m", "-1 mm", "1 µm", "12.3 mm", "3e-10 m", "zero"]
    said = [quantities.aloud(0.00123, unit) for unit in ("rad/s, m/s", "1", "", "1/s")]
    assert said == ["0.00123 rad/s, m/s", "0.00123", "0.00123", "0.00123 1/s"]
