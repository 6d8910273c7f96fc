"""What is written: it compiles everywhere without a warning, its example agrees, and what has no C form is refused."""

import pathlib
import re
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import cnclik as ck
from cnclik.cli import main
from cnclik.engine.operations import number
from cnclik.record import record
from tests.bank import screws
from tests.export.native import arm, native
from tests.refusals import refusals

pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
STRICT = "-Wall -Wextra -Werror -pedantic -ffp-contract=off"
COMPILERS = {
    "gcc": "gcc -std=c99 -O1",  # what is not set is seen where something is optimised
    "g++": "g++ -std=c++17 -O0 -x c++",
    "clang": "clang -std=c99 -O0",
    "sanitized": "gcc -std=c99 -O0 -fsanitize=address,undefined -fno-sanitize-recover=all",
}


def a_law(task=ck.position("xy"), chain=arm(3), **changes):
    return ck.Law(chain, task, **{"alpha": 5.0, "inverse": ck.damped(0.1)} | changes)


def of_q(fn):
    """A task of one coordinate, the first of fn(q)."""
    value = jax.custom_jvp(lambda q: fn(q)[:1])
    value.defjvp(lambda q, step: (value(*q), step[0][:1]))
    return ck.function(lambda robot, q: value(q), ["own"], ["1"])


ODD = ck.planar_arm([1.0, 0.8], joint_names=["a*/ int x;", "/*/b??/\\"])
SLIDES = screws([[0.1, 0.0, 0.2]] * 3, np.eye(3)[[0, 2, 2]].tolist(), [0.3, 0.0, 0.8], kinds="PPR")

FLOOR = ck.wall(ck.position("z"), above=-1.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Exports of every kind."""
    at, way = tmp_path_factory.mktemp("exports"), ck.waypoints([0.0, 0.5, 1.0], [[1.0, 1.0], [1.2, 1.0], [1.0, 1.3]])
    every = {
        "flat": dict(law=a_law(ck.position()), method="CN"),
        "path": dict(method="TRAPEZOID", stage=ck.chord(2), reference=way),
        "single": dict(method="EXP-MIDPOINT", dtype="float32"),
        "slides": dict(law=a_law(ck.position("xz"), chain=SLIDES, limits=ck.bounded(walls=[FLOOR])), method="EE"),
        "panda": dict(law=ck.panda(), name="int32_t", dtype="float32"),
        "odd": dict(law=ODD, name="main"),
    }
    for name, options in every.items():
        law = options.pop("law", a_law())
        ck.export.c(law, options.pop("reference", None), out=at / name, **options)
    return [at / name for name in every]


def ran(folder, source="clik_step.c", compiler="gcc -std=c99"):
    """What the example prints with a source and a compiler, and its exit status."""
    line = f"{compiler} {source} example.c -lm -o run && ./run"
    done = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True)
    return done.stdout + done.stderr, done.returncode


def builds(folder, compiler="gcc"):
    """The vectors of an export agree, and the compiler has no warning."""
    (source,) = {path.name for path in folder.glob("*.c")} - {"example.c"}
    said, code = ran(folder, source, f"{COMPILERS[compiler]} {STRICT}")
    assert code == 0 and "8 of 8 vectors agree" in said, (folder.name, said[:2000])


@pytest.mark.parametrize("compiler", COMPILERS)
def test_it_compiles_without_a_warning_and_its_example_agrees(compiler, folders):
    if not shutil.which(COMPILERS[compiler].split()[0]):
        pytest.skip(f"no {compiler}")
    for folder in folders if compiler == "gcc" else folders[::2]:
        builds(folder, compiler)


@pytest.mark.parametrize(
    ("name", "old", "new", "code", "agree"),
    [
        ("path", "output->qdot[0] = ", "output->qdot[0] = 1.001 * ", 7, 1),  # that with the NaN still does
        ("flat", "output->least = ", "output->least = 1e-8 + ", 0, 8),  # it is the root of a rounding
    ],
)
def test_an_example_that_disagrees_says_so(folders, tmp_path, name, old, new, code, agree):
    shutil.copytree(folders[0].parent / name, tmp_path, dirs_exist_ok=True)
    text = (tmp_path / "clik_step.c").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "wrong.c").write_text(text.replace(old, new), encoding="utf-8")
    said, returned = ran(tmp_path, "wrong.c")
    assert returned == code and f"{agree} of 8 vectors agree" in said


def test_what_rounding_decides_is_not_compared(folders, tmp_path):
    """Of a nearly singular arm q̇; of others nothing but the vector with the NaN."""
    short = a_law(chain=ck.planar_arm([1.0, 1e-6]), inverse=ck.pseudoinverse())
    folder = ck.export.c(short, out=tmp_path / "made", method="EE")
    builds(folder)
    texts = [(at / "example.c").read_text() for at in (folder, *folders[:3])]
    rows = [re.search(r"out_qdot.*?;", text, re.S)[0] for text in texts]
    assert [len(re.findall("{.*NAN.*}", text)) for text in rows] == [8, 1, 1, 1]
    assert [len(re.findall("agree, but for [0-9]+ numbers that rounding", text)) for text in texts] == [1, 0, 0, 0]


def test_the_source_has_no_allocation_no_recursion_and_nothing_global(folders):
    assert "a* / int x;" in (folders[0].parent / "odd" / "clik_main.h").read_text(encoding="utf-8")
    for folder in folders:
        for path in folder.glob("clik_*.c"):
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"malloc|calloc|alloca|\bgoto\b|while", text)
            outside = re.sub(r"(?s)\{.*?\n\}", "", text)
            assert not re.search(r"^(static )?(const )?(double|float|int32_t|int) \w+( =|\[|;)", outside, re.M)
        kinds = {path.name for path in folder.iterdir()}
        assert {"example.c", "README.md"} < kinds
        told = (folder / "README.md").read_text(encoding="utf-8")
        assert ck.__version__ in told and "cc -std=c99" in told and "rad]" in told


test_what_cannot_be_exported_is_refused = refusals(
    ({"law": a_law(of_q(lax.lgamma))}, "`lgamma`"),
    ({"law": a_law(of_q(lambda q: q * jnp.linalg.eigvalsh(jnp.outer(q, q))[0]))}, "`eigh`"),
    *(({"name": bad}, "`name` must") for bad in ("clik step", "1st", "a" * 61, "größe")),
    *(({"out": bad}, "`out` must") for bad in (5, "\0x")),
    ({"dtype": "float16"}, "`dtype` must"),
    ({"dtype": 3}, "`dtype` must be one of float64, float32, double, float, but is 3"),
    ({"reference": "circle"}, "`reference` must"),
    ({"law": arm(2), "reference": ck.hold([1.0, 1.0])}, "`reference` must be left out for a robot"),
    ({"stage": 3}, "`stage` must be a stage such as picard(5), but is 3"),
    ({"stage": ck.picard, "method": "IE"}, "`stage` must be a stage such as picard(5)"),
    of=lambda law=a_law(), out="never", **options: ck.export.c(law, out=out, **options),
)


def test_the_passes_of_a_stage_are_at_most_those_exported():
    step = native(a_law(), method="IE", stage=ck.picard(np.array(2)))
    assert "int32_t M; /* passes of an implicit stage, at most" in step.header


def test_arrays_are_parameters_and_literals_are_compiled_in():
    lengths = np.array([1.0, 0.8, 0.6])
    law = ck.Law(ck.planar_arm(lengths), ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))
    step = native(law, method="EE")
    assert {"alpha", "damping", "feedforward"} < set(step.parameters.dtype.names)
    assert any("position" in name for name in step.parameters.dtype.names)  # an array of lengths is a parameter
    assert not any("position" in name for name in native(a_law(), method="EE").parameters.dtype.names)
    q, target = np.array([0.3, 0.5, -0.4]), [0.9, 1.2]
    step.parameters["alpha"] = 50.0
    wanted = ck.step(ck.replace(law, alpha=50.0), ck.hold(target), q, 0.0, 0.01, "EE")
    assert np.allclose(step(q, target, Ts=0.01).q, wanted.q, rtol=0, atol=1e-14)


def test_a_number_beyond_single_precision_is_infinite():
    assert number(-1e300, np.float32) == "-INFINITY"


def test_what_a_users_record_calls_its_numbers_is_no_word_of_c():
    @record
    class Drawn:
        double: object
        größe: object

        def __call__(self, robot, q):
            return self.double * q[:1] + self.größe

    law = a_law(task=ck.function(Drawn(double=np.array(-1.0), größe=np.array(0.5)), ["own"], ["1"]))
    names = set(native(law, method="EE").parameters.dtype.names)
    assert any("own_double" in name for name in names) and any("own_gr__e" in name for name in names), names


def test_the_command_line_writes_the_same_and_the_pages_example_runs_on_it(tmp_path, capsys):
    law = ck.Law(ck.planar_arm([1.0, 0.8, 0.6]), ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))  # as on the page
    ck.export.c(law, out=tmp_path / "arm-step", method="EE")
    words = ["export", "planar:1,0.8,0.6", "--task", "xy", "--method", "EE", "--damping", "0.1"]
    main([*words, "--out", str(tmp_path / "cli")])
    said = capsys.readouterr().out
    assert "clik_step.c example.c" in said and "Wrote clik_step.h, clik_step.c, example.c and" in said
    for name in ("clik_step.h", "clik_step.c", "example.c"):
        assert (tmp_path / "cli" / name).read_text() == (tmp_path / "arm-step" / name).read_text()
    page = (pathlib.Path(__file__).parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```c\n(.*?)^```", page, re.M | re.S)
    (build,) = re.findall(r"`(cc -std=c99 [^`]* -o loop)`", page)
    (tmp_path / "loop.c").write_text(code, encoding="utf-8")
    line = f"{build} -Wall -Wextra -Werror -pedantic && ./loop"
    done = subprocess.run(line, shell=True, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and np.allclose([float(v) for v in done.stdout.split()], 0, atol=1e-6), done.stderr
