"""Command lines of every verb, drawn from its dataclass of options; all is real until the first program is traced."""

import contextlib
import dataclasses
import importlib
import io
import os
import typing
from unittest import mock

import jax
import numpy as np

from cnclik.cli import VERBS, main
from cnclik.problem.options import NAME, OPTIONS
from cnclik.problem.words import TASKS
from tests.specs import reaching
from tests.stress.fuzz import stores
from tests.stress.fuzz.judge import one_line
from tests.stress.fuzz.nasty import NUMBERS, TEXTS, any_of, chance, slipped
from tests.stress.fuzz.urdf import draw as robot

LEFT_OUT = ("distributed",)  # these wait for others
NUMERIC = ("0", "1", "2", "5", "0.1", "0.01", "-1", "3", "10", "1e-3", "100", "1e6", "1000000000", "1e308", "1e-320",
           "nan", "inf", "99999999999999999999", "2.5", "34ms", "0.034", "90deg", "-90", "5mm", "3 ms", "1 s", "180°",
           "2km", "1e3ms", "0 -90 90 deg", "34us", "ms", "1msms", *NUMBERS[:20])  # fmt: skip
FILES = ("arm.urdf", "way.csv", "targets.npy", "a.toml", "whole", ".", "/dev/zero", "/dev/null", "/dev/full", "none",
         "", "a/b/c", "x" * 300, "pipe", "a\nb", "[/]", "é.csv", "arm.urdf/x", "\ud800")  # fmt: skip
ROBOTS = ("panda", "ur5", "planar:1,1", "planar:1,1,1", "planar-clockwise:1,1", "arm.urdf", "planar", "planar:",
          "planar:nan", "planar:1e308,1e308", "planar:-1", "planar:1" + ",1" * 40, "pandda", "way.csv")  # fmt: skip
OUT = ("out", ".", "own", "whole", "out/a/b", "way.csv", "/dev/null", "/dev/full/x", "x" * 300, "", "out.npz",
       "out.csv", "out.nc", "[/]", "arm.urdf")  # fmt: skip
CHOICES = {
    "robot": (*ROBOTS, "cell.py"),
    "task": (*TASKS, "xy", "xyrz", "z"),
    "method": ("EE", "CN", "EXP-MIDPOINT", "RK4"),
    "reference": ("hold", "line", "circle", "lissajous", "way.csv"),
    "limits": ("velocity_scaling", "bounded"),
    "begin": ("q0", "on-path"),
    "command": ("velocity", "position"),
    "feedback": ("measured", "commanded", "rebased"),
    "smoothed": ("error", "command", "target"),
    "out": OUT,
    "over": ("alpha", "damping", "Ts", "feedforward"),
    "loss": ("tracking", "jerk=1e-4", "worst=2", "settling"),
    "tip": ("l1", "tip"),
    "base": ("l0",),
    "spec": ("a.toml",),
    "set": ("alpha=5", "axes.M=[1,2]", "N=3", "alpha=9**9**9", "method=CN"),
    "near": ("0", "-90", "1e9", "90deg", "nan", "3.2"),
    "reading": ("on-path/once/consistent", "printed/twice/printed"),
}


class Reached(BaseException):
    """A program would be traced now: what there was to read has been read."""


def draw(rng):
    """(the command line, the URDF file beside it)."""
    verb = any_of(rng, tuple(VERBS))
    argv, odd = [verb], any_of(rng, (0.0, 0.05, 0.3))
    hints = typing.get_type_hints(_args(verb))
    fields = [f for f in dataclasses.fields(_args(verb)) if f.name not in LEFT_OUT]
    for field in fields:
        if _positional(field) and chance(rng, 0.95):
            argv.append(_word(rng, field.name.rstrip("_"), hints[field.name], odd))
    named = [f for f in fields if not _positional(f) or chance(rng, odd / 5)]
    for _ in range(int(rng.integers(5))):
        field = any_of(rng, named or fields)
        name = field.name.rstrip("_").replace("_", "-")
        count = int(rng.integers(5)) if chance(rng, odd) else _count(hints[field.name])
        values = [_word(rng, field.name.rstrip("_"), hints[field.name], odd) for _ in range(count)]
        if bool in _inner(hints[field.name]) and chance(rng, 1 - odd):
            argv.append(any_of(rng, ("--", "--no-")) + name)
        elif chance(rng, 0.1):
            argv += [f"--{name}={v}" for v in values[:1]]
        else:
            argv += [f"--{name}", *values]
    if chance(rng, odd / 2):
        k = int(rng.integers(len(argv)))
        argv[k] = slipped(rng, argv[k])
    argv = [a for a in argv if a.partition("=")[0].lstrip("-") not in LEFT_OUT and "distrib" not in a]
    return argv, robot(rng) if chance(rng, 0.3) else ARM


ARM = b"""<robot name="r"><link name="l0"/><link name="l1"/><joint name="j" type="revolute">
<parent link="l0"/><child link="l1"/><origin xyz="0 0 1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


CELL = """import cnclik as ck
def problem(alpha=5.0): return ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=alpha), None, [0.3, 0.5]
"""


def _args(verb):
    return importlib.import_module(f"cnclik.cli.{verb}").Args


def _positional(field):
    return field.metadata.get("positional", False)


def _inner(hint) -> set:
    """The plain types and choices inside of a type."""
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is typing.Literal:
        return set(arguments)
    return set().union(*map(_inner, arguments)) if arguments else {hint}


def _count(hint) -> int:
    """How many values an option takes: 2 of a pair, 1 of most."""
    for one in (hint, *typing.get_args(hint)):
        if typing.get_origin(one) is tuple and ... not in typing.get_args(one):
            return len(typing.get_args(one))
    return 1


def _word(rng, name, hint, odd):
    """Right, nearly right, or anything."""
    kinds = _inner(hint)
    given = CHOICES.get(name) or tuple(k for k in kinds if isinstance(k, str))
    if chance(rng, odd / 3):
        return any_of(rng, (*TEXTS, *NUMBERS)).replace("\x00", "")
    if given and chance(rng, 1 - odd / 3):
        word = any_of(rng, given)
        return slipped(rng, word) if chance(rng, odd / 3) else word
    if kinds & {int, float} or (name in OPTIONS and OPTIONS[name].kind != NAME):
        return any_of(rng, NUMERIC if chance(rng, odd) else NUMERIC[:6])
    return any_of(rng, TEXTS if chance(rng, odd / 3) else FILES if chance(rng, odd) else FILES[:5]).replace("\x00", "")


def attempt(made, folder) -> None:
    """One command in a folder with a robot, a spec, tables and a finished sweep."""
    argv, data = made
    _furnish(folder, data)
    here, said = os.getcwd(), io.StringIO()
    cached = jax.config.jax_enable_compilation_cache
    try:
        os.chdir(folder)
        with _until_traced(), contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            code = 0
            try:
                main(argv)
            except Reached:
                return
            except SystemExit as leaving:
                code = leaving.code
    finally:
        os.chdir(here)
        jax.config.update("jax_enable_compilation_cache", cached)
    assert [p.read_text() for p in (folder / "own").iterdir()] == ["mine"] or "--overwrite" in argv
    one_line(code, said.getvalue())


def _furnish(folder, data):
    (folder / "arm.urdf").write_bytes(data)
    (folder / "way.csv").write_text("0,0.5,1,0\n1,1,0.5,0\n2,0.5,0.5,0\n")
    np.save(folder / "targets.npy", np.ones((2, 3)))
    (folder / "a.toml").write_text(reaching(["final_error"], alpha="[1.0, 2.0]"))
    (folder / "cell.py").write_text(CELL)
    os.mkfifo(folder / "pipe")
    (folder / "own").mkdir()
    (folder / "own" / "README.md").write_text("mine")
    (folder / "whole").symlink_to(stores.whole()[1], target_is_directory=True)


@contextlib.contextmanager
def _until_traced():
    """Raise `Reached` where a program would be traced, a figure drawn, a port opened, or another process started."""

    def reached(*args, **kwargs):
        raise Reached

    def begun(event, value, **_):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            raise Reached

    jax.monitoring.register_scalar_listener(begun)
    try:
        with (
            mock.patch("cnclik.show.output.draw", reached),
            mock.patch("cnclik.show.viewer.front._server", reached),
            mock.patch("cnclik.sweeps.program.fit", reached),
        ):
            yield
    finally:
        jax.monitoring.unregister_scalar_listener(begun)
