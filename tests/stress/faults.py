"""Whole commands killed, stopped and starved; nothing half-written remains.

Each trial starts one command in a process of its own, as a user would, and disturbs it.
"""

import functools
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zlib

import numpy as np

from cnclik.sweeps import store
from cnclik.writing import LIST

SPEC = pathlib.Path(__file__).parents[2] / "sweeps" / "horizon.toml"
AXES = "--set axes.method=['EE'] --set axes.Ts=[0.1] --set axes.alpha=[1,9]"
COMMANDS = {  # verbs that write results, on small cases
    "sweep": f"sweep {SPEC} {AXES} --out OUT",
    "solve": "solve planar:1,1 --reference circle --N 50 --out OUT",
    "reach": "reach planar:1,1 --random 20 --out OUT/answers.csv",
}


def start(name, out):
    out.mkdir(exist_ok=True)
    line = [sys.executable, "-m", "cnclik", *COMMANDS[name].replace("OUT", str(out)).split()]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def ended(process):
    """(exit code, what a user would read of an error)."""
    _, err = process.communicate()
    lines = [said for said in err.splitlines() if said.startswith("cnclik:") or "Traceback" in said or "Error" in said]
    return process.returncode, lines


def files(folder) -> dict:
    """Contents by name; without those of a sweep's store, of which each block is a file, and lists."""
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    return {name: content for name, content in found.items() if not name.startswith(("data.zarr/", ".partial-", LIST))}


def broken(found, wanted) -> list:
    """Names of files that are not those of an undisturbed run: its bytes, or its kind and size where times differ."""

    def alike(name, a, b):
        near = abs(len(a) - len(b)) < 0.1 * len(b) or name.endswith(".png")
        return a == b or (a[:8] == b[:8] and near and (not name.endswith(".png") or a[-8:] == b[-8:]))

    return [name for name, content in found.items() if not alike(name, content, wanted.get(name, b""))]


def kill(name, out, rng, seconds, wanted):
    """SIGKILL, half of them late, when files are written: all files are whole, and the same command then goes on."""
    process = start(name, out)
    time.sleep(seconds * rng.uniform(0.8 * (rng.random() < 0.5), 1.1))
    process.kill()
    process.communicate()
    found = files(out)
    data = {n for n in wanted if n.endswith((".nc", ".md", ".csv"))}
    early = any(n.endswith(".png") for n in found) and not data <= set(found)
    if broken(found, wanted) or early:
        return f"half a file, or figures without data: {broken(found, wanted)} of {sorted(found)}"
    code, said = ended(start(name, out))
    again = files(out)
    lost = store.Store(out).missing() if name == "sweep" else []
    wrong = code or sorted(again) != sorted(wanted) or broken(again, wanted) or lost
    return f"the command did not go on: {code} {said} {sorted(again)}" if wrong else ""


def stop(name, out, rng, seconds, wanted):
    """SIGINT or SIGTERM: one line on stderr, exit code 130 or 143, nothing left over, not even hidden."""
    sent, process = (signal.SIGINT, signal.SIGTERM)[rng.integers(2)], start(name, out)
    time.sleep(max(seconds * rng.uniform(0, 1), 1.0))  # before that Python itself is being loaded
    process.send_signal(sent)
    code, said = ended(process)
    if code in (0, -sent):  # it had done its work, and Python was about to end; or had not yet begun to hear
        found = sorted(files(out))
        return "" if found == sorted(wanted) or (code and not found) else f"{code} with {found}"
    if code != 128 + sent or len(said) != 1:
        return f"{sent.name}: exit code {code}, {said}"
    return "".join(f"{sent.name}: left {hidden}" for hidden in out.rglob(".partial-*"))


def full(name, out, rng, seconds, wanted):
    """A file system (tmpfs, needs root) with less room than the results take: one line, and whole files alone."""
    size = max(int(sum(map(len, wanted.values())) / 1024 * rng.uniform(0, 1.1)), 8)
    out.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(out)]
    if subprocess.run(mount, capture_output=True).returncode:
        return ""  # not for this user
    try:
        code, said = ended(start(name, out))
        found = files(out)
    finally:
        subprocess.run(["umount", str(out)], check=True)
    if code == 0:
        return "" if sorted(found) == sorted(wanted) else f"ended well with {sorted(found)}"
    wrong = broken(found, wanted) or code not in (1, 2) or len(said) != 1
    return f"exit code {code}, {said}, {broken(found, wanted)}" if wrong else ""


@functools.cache
def undisturbed(name, folder):
    """(seconds that a command takes, files that it makes)."""
    for _ in range(2):  # the first fills the cache of compiled programs
        shutil.rmtree(folder / name, ignore_errors=True)
        begun = time.perf_counter()
        code, said = ended(start(name, folder / name))
        seconds = time.perf_counter() - begun
        assert code == 0, f"{name}: {said}"
    return seconds, files(folder / name)


def trials(seed, folder):
    """(what was done, what is wrong or nothing), without end."""
    rng = np.random.default_rng(zlib.crc32(str(seed).encode()))
    for k in range(10**9):
        name, act = list(COMMANDS)[k % 3], (kill, stop, full)[k // 3 % 3]
        place = pathlib.Path(tempfile.mkdtemp(dir=folder))
        yield f"{act.__name__} {name} {k}", act(name, place / "out", rng, *undisturbed(name, folder))
        shutil.rmtree(place, ignore_errors=True)
