"""Whole commands killed, stopped and starved; nothing half-written remains.

Each trial starts one command in a process of its own, as a user would, and disturbs it:

- kill: SIGKILL at a random moment, half of them late, when files are written. What the folder holds afterwards is
  nothing or files of a whole run, each of them whole; the same command then ends as if nothing had been.
- stop: SIGINT or SIGTERM. One line on stderr, exit code 130 or 143, nothing left over, not even hidden.
- full: a file system (tmpfs, needs root) with less room than the results take. Exit code 2 with one line, and whole
  files alone.
"""

import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zlib

import numpy as np

from cnclik.writing import LIST

SPEC = pathlib.Path(__file__).parents[2] / "sweeps" / "horizon.toml"
PLANAR = ["planar:1,1", "--reference", "circle"]
AXES = ("method=['EE']", "Ts=[0.1]", "alpha=[1, 9]")
COMMANDS = {  # verbs that write results, on small cases
    "sweep": ["sweep", str(SPEC), *(word for axis in AXES for word in ("--set", f"axes.{axis}"))],
    "solve": ["solve", *PLANAR, "--N", "50"],
    "reach": ["reach", "planar:1,1", "--random", "20", "--out", "{out}/answers.csv"],
}
DATA = {"trajectory.nc", "summary.md", "answers.csv"}


def start(name, out):
    if name == "reach":
        out.mkdir(exist_ok=True)
    words = [word.replace("{out}", str(out)) for word in COMMANDS[name]]
    line = [sys.executable, "-m", "cnclik", *words, *["--out", str(out)] * ("--out" not in words)]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def ended(process):
    """(exit code, what a user would read of an error)."""
    try:
        _, err = process.communicate()
    finally:
        process.kill()  # of an interrupt
    lines = [said for said in err.splitlines() if said.startswith("cnclik:") or "Traceback" in said or "Error" in said]
    return process.returncode, lines


def files(folder) -> dict:
    """Contents by name; those of a sweep's store, of which each block is a file, and of lists apart."""
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    return {name: content for name, content in found.items() if not name.startswith(("data.zarr/", ".partial-", LIST))}


def broken(found, wanted) -> list:
    """Names of files that are not those of an undisturbed run: its bytes, or its kind and size where times differ."""
    bad = []
    for name, content in found.items():
        other = wanted.get(name, b"")
        alike = abs(len(content) - len(other)) < 0.1 * len(other)
        if name.endswith((".png", ".nc")):
            alike = content[:8] == other[:8] and (alike if name.endswith(".nc") else content[-8:] == other[-8:])
        bad += [name] * (content != other and not (alike and content))
    return bad


def kill(name, folder, rng, seconds, wanted):
    out, late = folder / "out", rng.random() < 0.5
    process = start(name, out)
    time.sleep(seconds * (rng.uniform(0.8, 1.1) if late else rng.uniform(0, 1)))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    found = files(out) if out.exists() else {}
    if bad := broken(found, wanted):
        return f"half a file or a strange one: {bad}"
    if any(n.endswith(".png") for n in found) and not {n for n in wanted if n in DATA} <= set(found):
        return f"figures without data: {sorted(found)}"
    code, said = ended(start(name, out))  # and the same command ends as if nothing had been
    again = files(out)
    wrong = code or sorted(again) != sorted(wanted) or broken(again, wanted)
    return f"the command did not go on: {code} {said} {sorted(again)}" if wrong else ""


def stop(name, folder, rng, seconds, wanted):
    out, sent = folder / "out", (signal.SIGINT, signal.SIGTERM)[rng.integers(2)]
    process = start(name, out)
    time.sleep(max(seconds * rng.uniform(0, 1), 1.0))  # before that Python itself is being loaded
    process.send_signal(sent)
    code, said = ended(process)
    if code in (0, -sent):  # it had done its work, and Python was about to end; or had not yet begun to hear
        unheard = code == -sent and not out.exists()
        return "" if unheard or sorted(files(out)) == sorted(wanted) else "ended well with other files"
    if code != (130 if sent == signal.SIGINT else 143) or len(said) != 1:
        return f"{sent.name}: exit code {code}, {said}"
    hidden = [p for p in out.rglob(".partial-*")] if out.exists() else []
    return f"{sent.name}: left {hidden}" if hidden else ""


def full(name, folder, rng, seconds, wanted):
    room, total = folder / "room", sum(map(len, wanted.values())) / 1024
    room.mkdir()
    size = max(int(total * rng.uniform(0, 1.1)), 8)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(room)], check=True)
    try:
        code, said = ended(start(name, room / "out"))
        found = files(room / "out") if (room / "out").exists() else {}
        if code == 0:
            return "" if sorted(found) == sorted(wanted) else f"ended well with {sorted(found)}"
        if code not in (1, 2) or len(said) != 1:
            return f"exit code {code}, {said}"
        return f"half a file: {bad}" if (bad := broken(found, wanted)) else ""
    finally:
        subprocess.run(["umount", str(room)], check=True)


def may_mount(folder) -> bool:
    """Whether a tmpfs can be mounted here."""
    done = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", str(folder)], capture_output=True)
    return done.returncode == 0 and subprocess.run(["umount", str(folder)]).returncode == 0


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
    rng, known = np.random.default_rng(zlib.crc32(str(seed).encode())), {}
    acts = [kill, stop, *([full] if shutil.which("mount") and may_mount(folder) else [])]
    for k in range(10**9):
        name, act = list(COMMANDS)[k % len(COMMANDS)], acts[k // len(COMMANDS) % len(acts)]
        if name not in known:
            known[name] = undisturbed(name, folder)
        place = pathlib.Path(tempfile.mkdtemp(dir=folder))
        yield f"{act.__name__} {name} {k}", act(name, place, rng, *known[name])
        shutil.rmtree(place, ignore_errors=True)
