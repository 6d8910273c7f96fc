"""Hostile arguments, files, logs and values: each is used, or refused in one line that names it.

An input is a command line with its files, or a call of the library, right but for some slips: numbers that break
readers, texts that break terminals, words lost and doubled, bytes as a bad disk leaves them. Whatever else comes of it
is a failure: another exception, a warning, words on stderr, too long, too much memory. A command is real until the
first program is traced.
"""

import functools
import importlib
import io
import pathlib
import re
import resource
import signal
import tempfile
import traceback
import warnings
import zlib
from contextlib import ExitStack, chdir, contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from unittest import mock

import jax
import numpy as np

import cnclik as ck
from cnclik.cli import VERBS, arguments, main
from cnclik.errors import ArgumentError, Remark
from cnclik.problem import options
from cnclik.problem.options import TASKS
from tests.specs import reaching

MOST_SECONDS, MOST_BYTES, MOST_CHARACTERS = 10.0, 1 << 30, 1000  # of the processor, of memory, of a refusal
QUIET = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)  # which nobody gets to see
NUMBERS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "0", "-0.0", "-1", "1e12", "1e-12", "0.1", "2.5"),
    *("", " ", "0x10", "1_000", "٣", "½", "1,2", "1 2", "--1", "1e", "1j", "true", "None", "9" * 400, "9" * 5000),
    *("NaN", "+5", "3.14.15", "1;2", "−1", "34ms", "90deg", "3 ms", "180°", "1e3ms", "1msms", "1000000000", "pi/2"),
)
TEXTS = (
    *("", " ", "a", "[/]", "[bold", "{}", "%s%n", "../..", "/", "/dev/null", "\t", "a b", "a\nb", "é", "名前", "💥"),
    *("\u202eabc", "\ufeff", "\u2028", "'", '"', "\\", "<&>", "`x`", "$(x)", "\x1b[31mred", "nan", "None", "a" * 300),
    *("b" * 70_000, "__import__('os')", "0", "-", "--", "=", "#", "link", "world", "\x7f", "z\u0301", "("),
)
ODD = (*"abzNM._-=[](){}*/+\"'# \n0519é\x00\r", "\udcff\udcfe", "\ufeff", "<!--", "]]>", "&a;")  # of a bad disk, too
VALUES = (
    *(0, 1, -1, 2, 10**9, 10**18, -(2**63), 10**400, -0.0, 0.5, 1e308, -1e308, 1e-320, float("nan"), float("inf")),
    *(True, None, [], {}, [[]], [1, "a"], [[1, 2], [3]], [0.1] * 3, [0.1] * 1000, [float("nan")], [10**400], ""),
    *(1j, np.array(1), np.ones(3), np.eye(3), np.eye(4), np.ones((2, 7)), np.ma.masked_array([1.0, 2], [0, 1]), "pi"),
    *(np.ones(2, "O"), np.zeros(0), np.ones(3, "int8"), np.ones(4, "float16"), object(), str, ck.pose, -np.eye(3)),
)
CHOICES = {
    "robot": ("panda", "ur5", "planar:1,1", "planar:1,1,1", "arm.urdf", "planar", "planar:nan", "planar:-1", "cell.py"),
    "task": (*TASKS, "xy", "xyrz", "z"),
    "method": ("EE", "CN", "EXP-MIDPOINT", "RK4"),
    "reference": ("hold", "line", "circle", "lissajous", "way.csv"),
    "out": ("out", ".", "out/a/b", "way.csv", "/dev/null", "/dev/full/x", "x" * 300, "", "out.csv", "arm.urdf"),
    "log": ("log.csv", "log.csv", "way.csv", "none"),
    "spec": ("a.toml",),
    "q0": ("0.3", "0.5", "90deg"),
    "set": ("alpha=5", "axes.M=[1,2]", "N=3", "alpha=9**9**9", "method=CN"),
}
FILES = ("arm.urdf", "way.csv", "a.toml", "log.csv", ".", "/dev/zero", "/dev/null", "none", "", "x" * 300, "a\nb")
SPEC = reaching('["final_error"]', alpha="[1.0, 2.0]", Ts='{linspace = ["0.01", 0.1, 3]}', delay="{range = [0, 3]}")
CELL = """import cnclik as ck
def problem(alpha=5.0): return ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=alpha), None, [0.3, 0.5]
"""


# A program would be traced now: what there was to read has been read; the time of an input is over.
Reached, Late = (type(name, (BaseException,), {}) for name in ("Reached", "Late"))


def any_of(rng, values):
    """One of them, as it is: NumPy would turn it into something of its own."""
    return values[int(rng.integers(len(values)))]


def slipped(rng, text: str) -> str:
    """A text with a slip: letters lost, wrong or doubled; cut off; a word for another; a line lost or doubled."""
    words, lines, k = re.split(r"([\s,\"<>=]+)", text), text.split("\n"), int(rng.integers(len(text) + 1))
    w, row, kind = 2 * int(rng.integers((len(words) + 1) // 2)), int(rng.integers(len(lines))), int(rng.integers(10))
    end = k + int(rng.integers(1, any_of(rng, (2, 60))))
    if kind < 4:
        return text[:k] + (any_of(rng, ODD) + text[end:], text[end:], text[k:end] + text[k:], "")[kind]
    if kind < 6:
        return "\n".join([*lines[: row + kind - 4], *[any_of(rng, lines)] * (kind - 4), *lines[row + 1 :]])
    words[w] = any_of(rng, (NUMBERS, NUMBERS, TEXTS, words)[kind - 6])
    return "".join(words)


def urdf(rng) -> str:
    """A tree of some links, with limits and mimics of all kinds."""
    kinds, ends = ("revolute", "revolute", "continuous", "prismatic", "fixed", "floating", "planar"), ("-1.5", "2", "0")
    text, thin = '<link name="l0"/>', rng.random() < 0.7
    for i in range(1, int(rng.integers(2, 9))):
        low, high, axis = any_of(rng, ends), any_of(rng, ("2", "2", "0", "", "nan")), any_of(rng, ("0 0 1", "-1 .2 0"))
        mimic = f'<mimic joint="j{int(rng.integers(1, i + 1))}" multiplier="-2"/>' * (rng.random() < 0.1)
        text += (
            f'\n<link name="l{i}"/><joint name="j{i}" type="{any_of(rng, kinds)}"><child link="l{i}"/>'
            f'<parent link="l{i - 1 if thin else int(rng.integers(i))}"/><origin xyz="0.1 0 {rng.random()}"/>'
            f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="1" effort="1"/>{mimic}</joint>'
        )
    return f'<robot name="r">{text}</robot>'


def log(rng) -> str:
    """A loop that rings; stamps of any unit that jitter; words that recorders add."""
    rows, width = any_of(rng, (0, 5, 16, 60, 200)), int(rng.integers(1, 4))
    unit, noise = (1.0, 1e3, 1e9, -1.0), (0, 1e-3)
    k = np.arange(rows)[:, None]
    values = rng.uniform(0.9, 1.1) ** k * np.cos(rng.uniform(0, np.pi) * k + rng.uniform(0, 6, (1, width)))
    values, clock = (x + any_of(rng, noise) * rng.normal(size=x.shape) for x in (values, 0.01 * k))
    names = [any_of(rng, ("q1", "command", "position", "x", "", "/joint_states/position[0]")) for _ in range(width)]
    cells = np.hstack([any_of(rng, unit) * clock, any_of(rng, (1.0, 1e-9, 1e9)) * values]).tolist()
    head = [any_of(rng, ("time", "t", "timestamp", "/header/stamp", "t [ms]")), *names, "status"]
    return "\n".join(",".join(map(str, row)) for row in [head, *([*row, 3] for row in cells)])


def command(rng):
    """(command line, {name: bytes of a file})."""
    verb, odd = any_of(rng, tuple(VERBS)), any_of(rng, (0.0, 0.05, 0.3))
    groups = arguments.options_of(importlib.import_module(f"cnclik.cli.{verb}")).values()
    every = [option for group in groups for option in group.values() if option.name != "distributed"]  # which waits
    argv, named = [verb], [option for option in every if not option.positional]
    some = [any_of(rng, named) for _ in range(int(rng.integers(4)) if named else 0)]
    for option in [option for option in every if option.positional] + some:
        flag = option.name.replace("_", "-")
        if option.kind == options.SWITCH:
            argv.append(any_of(rng, ("--", "--no-")) + flag)
            continue
        count = 1 if rng.random() > odd else int(rng.integers(4))
        argv += [f"--{flag}"] * (not option.positional) + [word(rng, option, odd) for _ in range(count)]
    if rng.random() < odd:
        k = int(rng.integers(len(argv)))
        argv[k] = slipped(rng, argv[k]).replace("\x00", "")
    way = "0,0.5,1,0\n1,1,0.5,0\n2,0.5,0.5,0\n"
    files = {"cell.py": CELL.encode()}
    for name, text in {"arm.urdf": urdf(rng), "log.csv": log(rng), "a.toml": SPEC, "way.csv": way}.items():
        for _ in range(int(rng.integers(3)) if rng.random() < 0.6 else 0):
            text = slipped(rng, text)
        files[name] = text.encode("utf-8", "surrogateescape")
    return argv, files


def word(rng, option, odd) -> str:
    """Right, nearly right, or anything."""
    if rng.random() < odd / 2:
        return any_of(rng, (*TEXTS, *NUMBERS)).replace("\x00", "")
    else_ = FILES if option.kind == options.NAME else ("0", "1", "2", "5", "0.1", "0.01")
    return any_of(rng, CHOICES.get(option.name) or option.choices or else_)


def use_command(case, folder):
    argv, files = case
    for name, data in files.items():
        (folder / name).write_bytes(data)
    said, code, cached = io.StringIO(), 0, jax.config.jax_enable_compilation_cache
    try:
        with chdir(folder), redirect_stderr(said), redirect_stdout(io.StringIO()), until_traced(*LATE):
            main(argv)
    except SystemExit as leaving:
        code = leaving.code
    finally:
        jax.config.update("jax_enable_compilation_cache", cached)
    lines = [line for line in said.getvalue().splitlines() if not re.match(r"[\d,]+ of [\d,]+ ", line)]
    assert all(line.startswith("cnclik: ") and len(line) <= MOST_CHARACTERS for line in lines), f"{lines!r} on stderr"
    assert code in (0, None) or (code == 2 and lines) or (code == 1 and argv[0] in ("check", "reproduce")), code
    if code == 2:
        raise ArgumentError(lines[-1])


LATE = ("cnclik.show.output.draw", "cnclik.show.viewer.has_viser", "cnclik.sweeps.grid.fit")  # figure, port, study


@contextmanager
def until_traced(*names):
    """Leave where a program would be traced, or where one of these would be called."""

    def heard(event, *_, **__):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            raise Reached

    jax.monitoring.register_scalar_listener(heard)
    try:
        with suppress(Reached), ExitStack() as stack:
            for name in names:
                stack.enter_context(mock.patch(name, side_effect=Reached))
            yield
    finally:
        jax.monitoring.unregister_scalar_listener(heard)


ARM, TARGET = ck.planar_arm([1.0, 1.0]), [0.1, 0.2, 0.3]
CALLS = (  # a call and arguments that it takes
    (ck.planar_arm, {"lengths": [1.0, 0.5]}),
    (ck.position, {"axes": "xy"}),
    (ck.pose, {"weights": [1.0] * 6}),
    (ck.damped, {"damping": 0.1}),
    (ck.bounded, {"rate": 10.0}),
    (ck.hold, {"target": TARGET, "rotation": np.eye(3)}),
    (ck.line, {"start": TARGET, "end": [0.1, 0, 0], "duration": 1.0}),
    (ck.circle, {"center": TARGET, "radius": 0.1, "period": 2.0}),
    (ck.waypoints, {"times": [0.0, 1.0, 2.0], "positions": np.ones((3, 3)), "rotations": None}),
    (ck.Drive, {"delay": 2, "lag": 0.05, "smoothing": 0.1, "command": "position", "feedback": "measured"}),
    (ck.gains, {"Ts": 0.01, "drive": None, "method": "EE"}),
    (ck.posture, {"rest": [0.1, 0.2], "rate": 1.0}),
    (lambda names, damping: ck.levels(names, damping=damping), {"names": ["a"], "damping": [0.1]}),
    (functools.partial(ck.Law, ARM, ck.position("xy")), {"alpha": 5.0, "error_clamp": (0.1, 0.3), "limits": None}),
    (functools.partial(ck.reach, ARM, task="xy"), {"targets": [1.0, 0.5], "near": [0.1, 0.2]}),
)


def call(rng):
    fn, arguments = any_of(rng, CALLS)
    odd = {any_of(rng, tuple(arguments)): any_of(rng, (*VALUES, *TEXTS[:12])) for _ in range(int(rng.integers(1, 3)))}
    return fn, arguments | odd


def use_call(case, folder):
    fn, arguments = case
    with until_traced() if fn is CALLS[-1][0] else nullcontext():
        assert repr(fn(**arguments))


def wrong(use, case) -> str:
    """What is wrong with the use of an input, or nothing."""
    said, before, told = io.StringIO(), peak(), []
    old = signal.signal(signal.SIGPROF, mock.Mock(side_effect=Late))
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            with redirect_stderr(said):
                use(case, pathlib.Path(folder))
    except ArgumentError as error:
        why = str(error)
        if len(why) > MOST_CHARACTERS or len(why.splitlines()) > 1 or "\x1b" in why:
            told.append(f"refused in {len(why)} characters: {why[:300]!r}")
    except (Exception, SystemExit, Late) as error:  # noqa: BLE001 - whatever it is
        told.append("".join(traceback.format_exception(error)[-6:]))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, old)
    loud = [w for w in warned if not issubclass(w.category, (*QUIET, Remark))]
    told += [f"warns: {w.category.__name__}: {w.message} ({w.filename}:{w.lineno})" for w in loud[:1]]
    told += [f"writes on stderr: {said.getvalue()[:300]!r}"] * bool(said.getvalue())
    told += [f"takes {peak() - before >> 20} MiB"] * (peak() - before > MOST_BYTES)
    return f"{str(case)[:2000]}: {'; '.join(told)}" if told else ""


def peak() -> int:
    """The most memory that this process has held [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def trials(seed, folder):
    """(number, what is wrong or nothing), without end."""
    for number in range(10**9):
        room, draw, use = ("command", command, use_command) if number % 4 else ("call", call, use_call)
        case = draw(np.random.default_rng([zlib.crc32(f"{seed} {room}".encode()), number]))
        yield f"{room} {number}", wrong(use, case)
