"""How long the first answer takes: commands in a fresh process, without compiled programs of an earlier one, and again.

Seconds are wall time from start to end of the process, its own start included; for the lines that begin with `ck.`,
those of the first call alone. Nothing here loads JAX: the process that measures stays small.
"""

import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

SOLVED = ("EE", "CN", "TRAPEZOID", "RK4", "EXP-MIDPOINT")  # methods of all kinds
MOST_SECONDS = 600.0  # for a command, before it is cut off
ROBOT, SPEC = "{robot}", "{spec}"  # stand for files
_CIRCLE = f"{ROBOT} --reference circle"
_STEP = "lambda q: ck.step(law, goal, q, 0.0, 0.01, ck.EE).q"
_MANY = "np.tile(np.asarray(q0, float), (4096, 1))"


class Line(NamedTuple):
    """What is run: arguments of `cnclik`, or a call in Python; and the seconds aimed at, cold and again."""

    name: str
    what: tuple | str
    cold: float | None = None
    again: float | None = None


def _verb(command, cold=None, again=None) -> Line:
    return Line(command.replace(ROBOT, "ROBOT").replace(SPEC, "SPEC"), tuple(command.split()), cold, again)


def table(spec=None) -> list[Line]:
    """The lines, quick ones first.

    Args:
      spec: a sweep's TOML file, whose run is then a line, too.
    """
    solve = "--N 400 --no-figures"
    return [
        _verb("--help", 0.5, 0.5),
        _verb("--version", 0.5, 0.5),
        _verb("solve --help", 0.5, 0.5),
        _verb(f"solve {ROBOT} --bogus 1", 0.5, 0.5),
        _verb(f"robots {ROBOT}", 1.5, 1.0),
        *(_verb(f"solve {_CIRCLE} --method {name} {solve}", 4, 2) for name in SOLVED),
        _verb(f"solve {_CIRCLE} --method CN --damping 0.05 {solve}", 4, 2),
        _verb(f"solve {_CIRCLE} --method CN --damping 0.05 --limits bounded {solve}", 4, 2),
        _verb(f"solve {_CIRCLE} --method CN --N 400", 6, 4),
        _verb("stability --delay 34ms", 0.5, 0.5),
        _verb(f"stability {ROBOT} --method EE", 6, 2.5),
        _verb(f"stability {ROBOT} --draw map", 15, 8),
        _verb(f"tune {_CIRCLE} --method EE", 25, 10),
        _verb(f"tune {_CIRCLE} --method CN", 25, 10),
        _verb(f"tune {_CIRCLE} --method EE --delay 17", 25, 10),
        _verb("reproduce", 20, 10),
        *([_verb(f"sweep {SPEC} --fresh", 120, 60)] if spec else []),
        Line("ck.solve", "ck.solve(law, goal, q0, 0.01, 400, ck.CN)", 2, 0.5),
        Line("ck.step", "ck.step(law, goal, q0, 0.0, 0.01, ck.CN)", 2, 0.5),
        Line("ck.lanes of step in a jit, 4,096 arms", f"jax.jit(lambda q: ck.lanes({_STEP})(q))({_MANY})", 4),
        Line("jax.vmap of step in a jit, 4,096 arms", f"jax.jit(jax.vmap({_STEP}))({_MANY})", 4),
    ]


_CALL = """
import time, jax, numpy as np, cnclik as ck
jax.config.update("jax_enable_x64", True)
ck.use_cache()
problem = ck.problem_from({robot!r}, reference="circle")
law, goal, q0 = problem.law, problem.reference, problem.q0
ck.solve, ck.step, ck.lanes, ck.EE, ck.CN
begun = time.perf_counter()
jax.block_until_ready({call})
print(time.perf_counter() - begun)
"""


def measure(line: Line, *, robot=None, spec=None) -> dict:
    """Run a line twice, with an empty cache folder and then with what the first run left there.

    Args:
      robot: a URDF file; by default one of seven joints.
      spec: a sweep's TOML file.

    Returns: name, cold_s, again_s [s], cold_mib, again_mib (largest memory of the process) and the aims; where the
      command failed or was cut off, None in place of seconds, and `error`.
    """
    record = {"name": line.name, "cold_aim_s": line.cold, "again_aim_s": line.again}
    with tempfile.TemporaryDirectory() as folder:
        files = {ROBOT: str(pathlib.Path(robot).absolute()) if robot else arm(folder)}
        files[SPEC] = str(pathlib.Path(spec).absolute()) if spec else ""
        for which in ("cold", "again"):
            seconds, mebibytes, error = _once(
                _command(line, files), folder, expected=2 if "--bogus" in line.what else 0
            )
            if not isinstance(line.what, tuple) and not error:
                seconds = float(pathlib.Path(folder, "said").read_text().splitlines()[-1])
            record |= {f"{which}_s": None if error else seconds, f"{which}_mib": mebibytes}
            if error:
                record["error"] = error
                break
    return record


def _command(line, files) -> list:
    if isinstance(line.what, tuple):
        return [sys.executable, "-m", "cnclik", *(files.get(word, word) for word in line.what)]
    return [sys.executable, "-c", _CALL.format(robot=files[ROBOT], call=line.what)]


def _once(command, folder, *, expected=0):
    """Seconds and largest memory [MiB] of one process, and what went wrong, if anything."""
    with open(os.path.join(folder, "said"), "w+") as said:
        begun = time.perf_counter()
        own = {"env": environment(os.path.join(folder, "cache")), "cwd": folder, "stdin": subprocess.DEVNULL}
        process = subprocess.Popen(command, **own, stdout=said, stderr=subprocess.STDOUT)
        code, usage = _wait(process, begun + MOST_SECONDS)
        seconds = time.perf_counter() - begun
        said.seek(0)
        lines = said.read().strip().splitlines() or [""]
    mebibytes = usage.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
    if seconds >= MOST_SECONDS:
        return seconds, mebibytes, f"cut off after {MOST_SECONDS:.0f} s"
    return seconds, mebibytes, "" if code == expected else lines[-1] or f"ended with {code}"


def environment(cache) -> dict:
    """Variables for a process that runs the package that measures, and keeps its programs below a folder."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "JAX_PERSISTENT"))}
    package = str(pathlib.Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (package, kept.get("PYTHONPATH"))))
    return kept | {"XDG_CACHE_HOME": cache, "PYTHONPATH": path}


def _wait(process, until):
    """Exit code and resources of a child, which is killed where it takes too long; not those of all children so far."""
    while True:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return process.returncode, usage
        if time.perf_counter() > until:
            process.send_signal(signal.SIGKILL)
            until = float("inf")
        time.sleep(0.005)


def arm(folder) -> str:
    """A URDF file of seven revolute joints, a little less than 1 m long."""
    inertia = " ".join(f'i{a}="{0.01 * (a in ("xx", "yy", "zz"))}"' for a in ("xx", "yy", "zz", "xy", "xz", "yz"))
    inertial = f'<inertial><mass value="1"/><inertia {inertia}/></inertial>'
    links = "".join(f'<link name="l{i}">{inertial}</link>' for i in range(8))  # simulators want masses
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{0.02 * (i % 3)} 0 0.13" rpy="{1.5707963267948966 * (-1) ** i} 0 0.1"/><axis xyz="0 0 1"/>'
        '<limit lower="-2.9" upper="2.9" velocity="2" effort="50"/></joint>'
        for i in range(7)
    )
    path = os.path.join(folder, "arm7.urdf")
    pathlib.Path(path).write_text(f'<robot name="arm7">{links}{joints}</robot>')
    return path


def page(records) -> str:
    """The records as one Markdown table."""
    from cnclik.measure.files import markdown

    rows = [
        (
            f"`{r['name']}`",
            *(_seconds(r.get(f"{which}_s"), r[f"{which}_aim_s"]) for which in ("cold", "again")),
            f"{max(r['cold_mib'], r.get('again_mib', 0)):,.0f}",
        )
        for r in records
    ]
    return markdown(("command", "cold [s] (aim)", "again [s] (aim)", "peak [MiB]"), rows)


def _seconds(found, aim) -> str:
    return ("–" if found is None else f"{found:.2f}") + (f" ({aim:g})" if aim else "")
