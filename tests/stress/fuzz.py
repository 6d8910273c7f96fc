"""Hostile arguments, files, logs and values: each is used, or refused in one line that names it.

An input is a command line with its files, or a call of the library, right but for some slips: numbers that break
readers, texts that break terminals, words lost and doubled, bytes as a bad disk leaves them. Whatever else comes of it
is a failure: another exception, a warning, words on stderr, too long, too much memory. A command is real until the
first program is traced.
"""

import contextlib
import importlib
import io
import os
import pathlib
import re
import resource
import signal
import tempfile
import traceback
import warnings
import zlib
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
LEFT_OUT = ("distributed",)  # these wait for others
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
    "set": ("alpha=5", "axes.M=[1,2]", "N=3", "alpha=9**9**9", "method=CN"),
    "q0": ("0.3", "0.5", "90deg"),
}
FILES = (
    "arm.urdf",
    "way.csv",
    "a.toml",
    "log.csv",
    ".",
    "/dev/zero",
    "/dev/null",
    "none",
    "",
    "x" * 300,
    "a\nb",
    "[/]",
)
SPEC = reaching('["final_error"]', alpha="[1.0, 2.0]", Ts='{linspace = ["0.01", 0.1, 3]}', delay="{range = [0, 3]}")
CELL = """import cnclik as ck
def problem(alpha=5.0): return ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=alpha), None, [0.3, 0.5]
"""


class Reached(BaseException):
    """A program would be traced now: what there was to read has been read."""


class Late(BaseException):
    """The time of an input is over; no `except Exception` holds it back."""


def any_of(rng, values):
    """One of them, as it is: NumPy would turn it into something of its own."""
    return values[int(rng.integers(len(values)))]


def slipped(rng, text: str) -> str:
    """A text with a slip: a letter lost, doubled or wrong; a word for another; a line lost or doubled."""
    words, k = re.split(r"([\s,\"<>=]+)", text), int(rng.integers(len(text) + 1))
    w, lines = 2 * int(rng.integers((len(words) + 1) // 2)), text.split("\n")
    row = int(rng.integers(len(lines)))
    match int(rng.integers(8)):
        case 0:
            return text[:k] + text[k + 1 :]
        case 1:
            return text[:k] + any_of(rng, "abzNM._-=[](){}*/+\"'# \n0519é\x00") + text[k + 1 :]
        case 2 | 3:
            words[w] = any_of(rng, NUMBERS)
        case 4:
            words[w] = any_of(rng, TEXTS)
        case 5:
            words[w] = any_of(rng, words)
        case 6:
            return "\n".join(lines[:row] + lines[row + 1 :])
        case _:
            return "\n".join([*lines[: row + 1], any_of(rng, lines), *lines[row + 1 :]])
    return "".join(words)


def damaged(rng, data: bytes) -> bytes:
    """Bytes as a bad disk leaves them: flipped, cut off, doubled, gone; or a mark that belongs elsewhere."""
    k = int(rng.integers(len(data) + 1))
    end = k + int(rng.integers(1, 60))
    odd = any_of(rng, (b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"<!--", b"]]>", b"\r", b"&a;", b'"', rng.bytes(9)))
    return any_of(rng, (data[:k], data[:end] + data[k:], data[:k] + data[end:], data[:k] + odd + data[k + 1 :]))


# --- commands with their files ------------------------------------------------------------------------


def urdf(rng) -> str:
    """A tree of some links, with limits and mimics of all kinds."""
    kinds = ("revolute", "revolute", "continuous", "prismatic", "fixed", "floating", "planar")
    limits = (("-1.5", "2"), ("-1.5", "2"), ("0", "0"), ("1", "2"), ("2", "1"), ("-inf", "2"), ("", "1"), ("0", "nan"))
    text, thin = '<link name="l0"/>', rng.random() < 0.7
    for i in range(1, int(rng.integers(2, 9))):
        (low, high), axis = any_of(rng, limits), any_of(rng, ("0 0 1", "0 1 0", "-1 0 0", "0.1 0.2 0.3"))
        mimic = f'<mimic joint="j{int(rng.integers(1, i + 1))}" multiplier="-2"/>' * (rng.random() < 0.1)
        text += (
            f'\n<link name="l{i}"/><joint name="j{i}" type="{any_of(rng, kinds)}"><child link="l{i}"/>'
            f'<parent link="l{i - 1 if thin else int(rng.integers(i))}"/><origin xyz="0.1 0 {rng.random()}"/>'
            f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="1" effort="1"/>{mimic}</joint>'
        )
    return f'<robot name="r">{text}</robot>'


def log(rng) -> str:
    """A loop that rings, or a step of a drive; stamps of any unit that jitter; words that recorders add."""
    rows, columns = int(any_of(rng, (0, 5, 16, 60, 200))), int(rng.integers(1, 4))
    k = np.arange(rows)[:, None]
    values = rng.uniform(0.9, 1.1) ** k * np.cos(rng.uniform(0, np.pi) * k + rng.uniform(0, 6, (1, columns)))
    if rng.random() < 0.3:
        values = (k > rows // 4) * (1 - np.exp(-np.maximum(k - rows // 4, 0) / 7)) * np.ones(columns)
    values = any_of(rng, (1.0, 1e-9, 1e9)) * (values + any_of(rng, (0.0, 1e-3)) * rng.normal(size=values.shape))
    clock = any_of(rng, (1.0, 1e3, 1e9, -1.0)) * (0.01 * k + any_of(rng, (0.0, 1e-3)) * rng.normal(size=k.shape))
    names = [any_of(rng, ("time", "t", "timestamp", "/header/stamp", "t [ms]"))]
    names += [any_of(rng, ("q1", "command", "position", "x", "", "/joint_states/position[0]")) for _ in range(columns)]
    cells = [[*names, "status"], *([*map(repr, row), "3"] for row in np.hstack([clock, values]).tolist())]
    return "\n".join(map(",".join, cells))


def command(rng):
    """(command line, {name: bytes of a file})."""
    verb, odd = any_of(rng, tuple(VERBS)), any_of(rng, (0.0, 0.05, 0.3))
    module = importlib.import_module(f"cnclik.cli.{verb}")
    every = [one for some in arguments.options_of(module).values() for one in some.values() if one.name not in LEFT_OUT]
    argv, named = [verb], [one for one in every if not one.positional]
    first = [one for one in every if one.positional]
    for one in first + [any_of(rng, named) for _ in range(int(rng.integers(4)) if named else 0)]:
        flag = one.name.replace("_", "-")
        if one.kind == options.SWITCH:
            argv.append(any_of(rng, ("--", "--no-")) + flag)
            continue
        count = 1 if rng.random() > odd else int(rng.integers(4))
        argv += [f"--{flag}"] * (not one.positional) + [word(rng, one, odd) for _ in range(count)]
    if rng.random() < odd:
        k = int(rng.integers(len(argv)))
        argv[k] = slipped(rng, argv[k]).replace("\x00", "")
    texts = {"arm.urdf": urdf(rng), "log.csv": log(rng), "a.toml": SPEC, "cell.py": CELL}
    texts["way.csv"] = "0,0.5,1,0\n1,1,0.5,0\n2,0.5,0.5,0\n"
    for name in texts:
        for _ in range(int(rng.integers(3)) if name != "cell.py" and rng.random() < 0.6 else 0):
            texts[name] = slipped(rng, texts[name])
    files = {name: text.encode("utf-8", errors="replace") for name, text in texts.items()}
    files = {name: damaged(rng, data) if rng.random() < 0.1 else data for name, data in files.items()}
    return [a for a in argv if "distrib" not in a], files


def word(rng, one, odd) -> str:
    """Right, nearly right, or anything."""
    choices = CHOICES.get(one.name) or one.choices
    if rng.random() < odd / 2:
        return any_of(rng, (*TEXTS, *NUMBERS)).replace("\x00", "")
    if choices:
        return any_of(rng, choices)
    return any_of(rng, FILES) if one.kind == options.NAME else any_of(rng, ("0", "1", "2", "5", "0.1", "0.01"))


def use_command(made, folder):
    argv, files = made
    for name, data in files.items():
        (folder / name).write_bytes(data)
    here, said, code = os.getcwd(), io.StringIO(), 0
    cached = jax.config.jax_enable_compilation_cache
    try:
        os.chdir(folder)
        with until_traced(), contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            main(argv)
    except Reached:
        return
    except SystemExit as leaving:
        code = leaving.code
    finally:
        os.chdir(here)
        jax.config.update("jax_enable_compilation_cache", cached)
    lines = [line for line in said.getvalue().splitlines() if not re.match(r"[\d,]+ of [\d,]+ ", line)]
    assert all(one.startswith("cnclik: ") and len(one) <= MOST_CHARACTERS for one in lines), f"{lines!r} on stderr"
    assert code in (0, None) or (code == 2 and lines) or (code == 1 and argv[0] in ("check", "reproduce")), code
    if code == 2:
        raise ArgumentError(lines[-1])


@contextlib.contextmanager
def until_traced():
    """Raise `Reached` where a program would be traced, a figure drawn, a port opened, or a study begun."""

    def reached(*args, **kwargs):
        raise Reached

    def begun(event, value, **_):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            raise Reached

    jax.monitoring.register_scalar_listener(begun)
    names = ("cnclik.show.output.draw", "cnclik.show.viewer.has_viser", "cnclik.sweeps.grid.fit")
    try:
        with contextlib.ExitStack() as stack:
            for name in names:
                stack.enter_context(mock.patch(name, reached))
            yield
    finally:
        jax.monitoring.unregister_scalar_listener(begun)


# --- calls of the library -----------------------------------------------------------------------------

CALLS = (  # a call and arguments that it takes
    (ck.planar_arm, {"lengths": [1.0, 0.5]}),
    (ck.position, {"axes": "xy"}),
    (ck.pose, {"weights": [1.0] * 6}),
    (ck.damped, {"damping": 0.1}),
    (ck.bounded, {"rate": 10.0}),
    (ck.hold, {"target": [0.1, 0.2, 0.3], "rotation": np.eye(3)}),
    (ck.line, {"start": [0, 0, 0.1], "end": [0.1, 0, 0], "duration": 1.0}),
    (ck.circle, {"center": [0.1, 0.2, 0.3], "radius": 0.1, "period": 2.0}),
    (ck.waypoints, {"times": [0.0, 1.0, 2.0], "positions": np.ones((3, 3)), "rotations": None}),
    (ck.Drive, {"delay": 2, "lag": 0.05, "smoothing": 0.1, "command": "position", "feedback": "measured"}),
    (ck.gains, {"Ts": 0.01, "drive": None, "method": "EE"}),
    (ck.posture, {"rest": [0.1, 0.2], "rate": 1.0}),
    (lambda names, damping: ck.levels(names, damping=damping), {"names": ["a"], "damping": [0.1]}),
    (
        lambda **k: ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), **k),
        {"alpha": 5.0, "error_clamp": (0.1, 0.3), "limits": None},
    ),
    (lambda **k: ck.reach(ck.planar_arm([1.0, 1.0]), task="xy", **k), {"targets": [1.0, 0.5], "near": [0.1, 0.2]}),
)


def call(rng):
    fn, arguments = any_of(rng, CALLS)
    arguments = dict(arguments)
    for _ in range(int(rng.integers(1, 3))):
        arguments[any_of(rng, tuple(arguments))] = any_of(rng, (*VALUES, *TEXTS[:12]))
    return fn, arguments


def use_call(made, folder):
    fn, arguments = made

    def begun(event, value, **_):
        if event == "/jax/core/compile/jaxpr_trace_duration" and fn is CALLS[-1][0]:
            raise Reached

    jax.monitoring.register_scalar_listener(begun)
    try:
        result = fn(**arguments)
    except Reached:
        return
    finally:
        jax.monitoring.unregister_scalar_listener(begun)
    assert repr(result)


# --- judged -------------------------------------------------------------------------------------------

ROOMS = {"command": (command, use_command), "call": (call, use_call)}


def trial(room, seed, number) -> str:
    """What is wrong with an input, or nothing."""
    draw, use = ROOMS[room]
    made = draw(np.random.default_rng([zlib.crc32(str(seed).encode()), zlib.crc32(room.encode()), number]))
    said, before = io.StringIO(), peak()

    def over(*_):
        raise Late

    old = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            with contextlib.redirect_stderr(said):
                use(made, pathlib.Path(folder))
        why = ""
    except ArgumentError as error:
        why = str(error)
        if len(why) > MOST_CHARACTERS or len(why.splitlines()) > 1 or "\x1b" in why:
            return f"{made}: refused in {len(why)} characters: {why[:300]!r}"
    except KeyboardInterrupt:
        raise
    except Late:
        return f"{made}: takes longer than {MOST_SECONDS:g} s"
    except BaseException as error:
        return f"{str(made)[:2000]}:\n" + "".join(traceback.format_exception(error)[-6:])
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, old)
    loud = [w for w in warned if not issubclass(w.category, (*QUIET, Remark))]
    wrong = [f"warns: {w.category.__name__}: {w.message} ({w.filename}:{w.lineno})" for w in loud[:1]]
    wrong += [f"writes on stderr: {said.getvalue()[:300]!r}"] * bool(said.getvalue())
    wrong += [f"takes {peak() - before >> 20} MiB"] * (peak() - before > MOST_BYTES)
    return f"{str(made)[:2000]}: {'; '.join(wrong)}" if wrong else ""


def peak() -> int:
    """The most memory that this process has held [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def trials(seed, folder):
    """(number, what is wrong or nothing), without end."""
    for number in range(10**9):
        room = "command" if number % 4 else "call"
        yield f"{room} {number}", trial(room, seed, number)
