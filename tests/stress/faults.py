"""`python -m tests.stress.faults`: whole commands killed, stopped and starved; nothing half-written remains.

Each round starts one command in a process of its own, as a user would, and disturbs it:

- kill: SIGKILL at a random moment, half of them late, when files are written. What the folder holds afterwards is
  nothing or files of a whole run, each of them whole; the same command then ends as if nothing had been.
- stop: SIGINT or SIGTERM. One line on stderr, exit code 130 or 143, nothing left over, not even hidden.
- full: a file system (tmpfs, needs root) with less room than the results take. Exit code 2 with one line, and whole
  files alone.
- writers: four of the same command at once, into one folder.
- reader: as a user who may not write there (needs root).

    python -m tests.stress.faults                        # 100 kills and 20 of each other kind for each command
    python -m tests.stress.faults --kills 4 --others 1 --only solve
"""

import argparse
import collections
import contextlib
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

from cnclik.cli.progress import bar
from cnclik.measure.files import markdown
from cnclik.writing import LIST

SPEC = pathlib.Path(__file__).parents[2] / "sweeps" / "horizon.toml"
PLANAR = ["planar:1,1", "--reference", "circle"]
AXES = ("method=['EE']", "Ts=[0.1]", "alpha=[1, 9]")
COMMANDS = {  # every verb that writes results, on small cases
    "solve": ["solve", *PLANAR, "--N", "50", "--csv"],
    "tune": ["tune", *PLANAR, "--N", "20", "--steps", "3"],
    "stability --map": ["stability", "planar:1,1", "--map", "--cells", "8", "--N", "20"],
    "reach": ["reach", "planar:1,1", "--random", "20", "--out", "{out}/answers.csv"],
    "sweep": ["sweep", str(SPEC), *(word for axis in AXES for word in ("--set", f"axes.{axis}"))],
}
started = []  # processes
DATA = {"trajectory.nc", "trajectory.csv", "tuned.json", "summary.md", "map.nc", "passes.nc", "answers.csv"}


def line(name, out):
    words = [w.replace("{out}", str(out)) for w in COMMANDS[name]]
    return [sys.executable, "-m", "cnclik", *words, *["--out", str(out)] * ("--out" not in words)]


def start(name, out, **options):
    if name == "reach":
        out.mkdir(exist_ok=True)
    made = subprocess.Popen(line(name, out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **options)
    started.append(made)
    return made


def end_all():
    """End what an interrupt has left running."""
    for process in started:
        if process.poll() is None:
            process.kill()
            process.wait()


def ended(process):
    _, err = process.communicate(timeout=600)
    lines = [said for said in err.splitlines() if said.startswith("cnclik:") or "Traceback" in said or "Error" in said]
    return process.returncode, lines


def files(folder) -> dict:
    """Contents by name; those of a sweep's store, of which each block is a file, and of lists apart."""
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    return {name: content for name, content in found.items() if not name.startswith(("data.zarr/", ".partial-", LIST))}


def whole(name: str, content: bytes, other: bytes) -> bool:
    """Whether a file is one of an undisturbed run: the same bytes, or of the same kind and size where times differ."""
    if content == other:
        return True
    if name.endswith(".png"):
        return content[:8] == other[:8] and content[-8:] == other[-8:]
    if name.endswith(".nc"):
        return content[:8] == other[:8] and abs(len(content) - len(other)) < 0.02 * len(other)
    return content[-1:] == b"\n" and abs(len(content) - len(other)) < 0.1 * len(other)


def hidden(folder):
    return [p for p in folder.rglob("*") if p.name.startswith(".partial-")]


# --- what is done to a command: each returns what is wrong, or None ------------------------------------


def kill(name, folder, rng, seconds, wanted):
    out, late = folder / "out", rng.random() < 0.5
    process = start(name, out)
    time.sleep(seconds * (rng.uniform(0.8, 1.1) if late else rng.uniform(0, 1)))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    found = files(out) if out.exists() else {}
    strange = [n for n in found if n not in wanted or not whole(n, found[n], wanted[n])]
    if strange:
        return f"half a file or a strange one: {strange}"
    figures = [n for n in found if n.endswith(".png")]
    if figures and not {n for n in wanted if n in DATA} <= set(found):
        return f"figures without data: {sorted(found)}"
    if rng.random() < 0.1 or name == "sweep":  # and the same command ends as if nothing had been
        code, said = ended(start(name, out))
        again = files(out)
        if code or sorted(again) != sorted(wanted) or not all(whole(n, again[n], wanted[n]) for n in wanted):
            return f"the command did not go on: {code} {said} {sorted(again)}"
    return None


def stop(name, folder, rng, seconds, wanted):
    out, sent = folder / "out", (signal.SIGINT, signal.SIGTERM)[rng.integers(2)]
    process = start(name, out)
    time.sleep(max(seconds * rng.uniform(0, 1), 1.0))  # before that Python itself is being loaded
    process.send_signal(sent)
    code, said = ended(process)
    if code in (0, -sent):  # it had done its work, and Python was about to end; or had not yet begun to hear
        unheard = code == -sent and not out.exists()
        return None if unheard or sorted(files(out)) == sorted(wanted) else "ended well with other files"
    if code != (130 if sent == signal.SIGINT else 143) or len(said) != 1:
        return f"{sent.name}: exit code {code}, {said}"
    if out.exists() and hidden(out):
        return f"{sent.name}: left {hidden(out)}"
    return None


def full(name, folder, rng, seconds, wanted):
    total = sum(map(len, wanted.values())) / 1024
    room = folder / "room"
    room.mkdir()
    size = max(int(total * rng.uniform(0, 1.1)), 8)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(room)], check=True)
    try:
        code, said = ended(start(name, room / "out"))
        found = files(room / "out") if (room / "out").exists() else {}
        if code == 0:
            return None if sorted(found) == sorted(wanted) else f"ended well with {sorted(found)}"
        if code not in (1, 2) or len(said) != 1:
            return f"exit code {code}, {said}"
        broken = [n for n in found if n not in wanted or not whole(n, found[n], wanted[n])]
        return f"half a file: {broken}" if broken else None
    finally:
        end_all()  # what an interrupt has left in it keeps it busy
        subprocess.run(["umount", str(room)], check=True)


def writers(name, folder, rng, seconds, wanted):
    together = [start(name, folder / "out") for _ in range(4)]
    said = [ended(process) for process in together]
    if any(code for code, _ in said):
        return f"{said}"
    found = files(folder / "out")
    wrong = [n for n in wanted if n not in found or not whole(n, found[n], wanted[n])]
    return f"not as of one: {wrong}" if wrong or hidden(folder) else None


def reader(name, folder, rng, seconds, wanted):
    folder.chmod(0o755)
    (folder / "out").mkdir(mode=0o755)
    environment = os.environ | {"HOME": "/nonexistent"}
    process = start(name, folder / "out", user=65534, group=65534, extra_groups=[], env=environment)
    code, said = ended(process)
    return None if code == 2 and len(said) == 1 and not files(folder) else f"exit code {code}, {said}"


def _runs_for_others() -> bool:
    """Whether another user may run this interpreter."""
    try:
        return subprocess.run([sys.executable, "-c", ""], user=65534, group=65534, extra_groups=[]).returncode == 0
    except OSError:
        return False


def undisturbed(name, folder):
    """(seconds that a command takes, files that it makes)."""
    folder.mkdir(parents=True)
    for _ in range(2):  # the first fills the cache of compiled programs
        shutil.rmtree(folder / "out", ignore_errors=True)
        begun = time.perf_counter()
        code, said = ended(start(name, folder / "out"))
        seconds = time.perf_counter() - begun
        if code:
            sys.exit(f"{name}: {said}")
    return seconds, files(folder / "out")


def rounds(args, plan, place, report):
    """Yields (command, fault, what is wrong or None) of each round."""
    total, done = len(args.only) * sum(n for _, n in plan.values()), 0
    for name in args.only:
        seconds, wanted = undisturbed(name, place / "undisturbed" / name.replace(" ", ""))
        for kind, (act, count) in plan.items():
            for k in range(count):
                folder = pathlib.Path(tempfile.mkdtemp(dir=place))
                rng = np.random.default_rng([args.seed, k])
                found = act(name, folder, rng, seconds, wanted)
                with contextlib.suppress(OSError):
                    shutil.rmtree(folder)
                done += 1
                report(done, total, f"{name}, {kind}")
                yield name, kind, found and f"{name}, {kind} {k}: {found}"


def told(found, plan) -> tuple:
    """(rounds, what is wrong) of all until an interrupt; each command and fault is printed as soon as it is done."""
    tried, well, wrong = collections.Counter(), collections.Counter(), []
    print(markdown(["command", "fault", "rounds", "well"], [], left=2), end="", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        for *of, why in found:
            row = name, kind = tuple(of)
            tried[row] += 1
            well[row] += not why
            if why:
                wrong.append(why)
                print(why, file=sys.stderr, flush=True)
            if tried[row] == plan[kind][1]:
                print(f"| {name} | {kind} | {tried[row]} | {well[row]} |", flush=True)
    for (name, kind), count in tried.items():
        if count < plan[kind][1]:
            print(f"| {name} | {kind} | {count} | {well[name, kind]} |")
    return tried.total(), wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--others", type=int, default=20, help="rounds of each other kind; of `writers` a tenth")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(COMMANDS), default=list(COMMANDS))
    args = parser.parse_args()
    for ends in (signal.SIGINT, signal.SIGTERM):  # behind `&` the first is ignored, by the commands too
        signal.signal(ends, signal.default_int_handler)
    root = hasattr(os, "geteuid") and os.geteuid() == 0
    plan = {"kill": (kill, args.kills), "stop": (stop, args.others), "writers": (writers, -(-args.others // 10))}
    if root:
        plan["full"] = full, args.others
        if _runs_for_others():
            plan["reader"] = reader, 1
    plan = {kind: (act, count) for kind, (act, count) in plan.items() if count}
    total, begun = len(args.only) * sum(n for _, n in plan.values()), time.perf_counter()
    with tempfile.TemporaryDirectory() as place, bar("rounds", total) as report, contextlib.ExitStack() as left:
        os.chmod(place, 0o755)
        left.callback(end_all)
        done, wrong = told(rounds(args, plan, pathlib.Path(place), report), plan)
    print(f"\n{done} of {total} rounds of seed {args.seed} in {(time.perf_counter() - begun) / 60:.0f} min.")
    print("\n".join(wrong) or "Nothing lost, nothing half-written.")
    sys.exit(130 if done < total else bool(wrong))


if __name__ == "__main__":
    main()
