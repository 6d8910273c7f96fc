"""`python -m tests.stress [PART ...]`: hostile inputs, random programs, faults and long runs, for a bounded time.

    python -m tests.stress                                # ten minutes with the seed of the day
    python -m tests.stress fuzz --seed 2026-11-29 --only "command 17"    # one trial again

Parts share the time, each in a process of its own. Exit code 1, and the command that repeats it, for each failure.
`python -m tests.stress.mutants` puts faults into the package instead.
"""

import argparse
import importlib
import pathlib
import subprocess
import sys
import tempfile
import time

import jax

PARTS = ("fuzz", "engine", "faults", "soak")


def run(part, seed, seconds, only) -> int:
    """Number of failures of one part."""
    jax.config.update("jax_enable_x64", True)
    begun, failed = time.monotonic(), 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        trials = importlib.import_module(f"tests.stress.{part}").trials(seed, pathlib.Path(folder))
        for count, (name, why) in enumerate(trials, 1):  # noqa: B007
            if why and only in ("", name):
                failed += 1
                print(f'python -m tests.stress {part} --seed {seed} --only "{name}"\n{why.strip()}', flush=True)
            if only == name or time.monotonic() - begun > seconds:
                break
    seconds = time.monotonic() - begun
    print(f"{part}: {count} trials of seed {seed} in {seconds:.0f} s, {failed} failed; the last: {name}", flush=True)
    return failed


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.stress", description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, ()], metavar="PART", default=(), help=", ".join(PARTS))
    parser.add_argument("--seconds", type=float, default=600, help="of all parts together")
    parser.add_argument("--seed", default=time.strftime("%Y-%m-%d"), help="by default the date")
    parser.add_argument("--only", default="", help="one trial again")
    args = parser.parse_args()
    if len(args.parts) == 1:
        sys.exit(run(args.parts[0], args.seed, args.seconds, args.only) > 0)
    parts = args.parts or PARTS
    line = [sys.executable, "-m", "tests.stress", "--seed", args.seed, "--seconds", str(args.seconds / len(parts))]
    sys.exit(max(subprocess.run([*line, part]).returncode for part in parts))


if __name__ == "__main__":
    main()
