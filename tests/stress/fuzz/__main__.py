"""`python -m tests.stress.fuzz`: a hundred thousand inputs that are wrong in every way, each judged (see `judge`).

    python -m tests.stress.fuzz                                         # all of it: 25 minutes of one core
    python -m tests.stress.fuzz --only urdf toml --inputs 1000          # some rooms, fewer inputs
    python -m tests.stress.fuzz --only urdf --seed 0 --number 17        # one input again, shown, with its traceback

Exit code 1, and the command that repeats it, for every input that fails.
"""

import argparse
import collections
import contextlib
import os
import pathlib
import signal
import sys
import tempfile
import time

from cnclik.cli.progress import bar
from cnclik.measure.files import markdown
from tests.stress.fuzz import judge, many

SHARES = {
    "urdf": 0.3,
    "toml": 0.17,
    "tables": 0.2,
    "expressions": 0.17,
    "poses": 0.06,
    "stacks": 0.06,
    "arguments": 0.075,
    "logs": 0.015,
    "stores": 0.005,
    "exports": 0.005,
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.stress.fuzz", description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=SHARES, default=list(SHARES))
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--number", type=int, help="one input again")
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_args()
    if args.number is not None:
        many.begin()
        _again(args)
        return
    for ends in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ends, signal.default_int_handler)
    total = sum(SHARES[name] for name in args.only)
    counts = {name: round(args.inputs * SHARES[name] / total) for name in args.only}
    found, begun = [], time.perf_counter()
    # What was tried before an interrupt is told all the same.
    with bar("inputs", sum(counts.values())) as report, contextlib.suppress(KeyboardInterrupt):
        for some in many.verdicts(counts, args.seed, args.processes):
            found += some
            report(len(found), sum(counts.values()))
            for bad in (v for v in some if v.outcome == "failed"):
                print(f"\n{judge.repeat(bad, args.seed)}\n{bad.why.strip()}", file=sys.stderr)
    seconds = time.perf_counter() - begun
    print(table(found), end="")
    tried = f"{len(found):,} of {sum(counts.values()):,} inputs of seed {args.seed}"
    print(f"\n{tried} in {seconds / 60:.1f} min on {args.processes} processes.")
    sys.exit(any(v.outcome == "failed" for v in found))


def table(verdicts) -> str:
    """The rooms in Markdown: how many inputs, what came of them, the slowest and the largest."""
    rooms = collections.defaultdict(list)
    for verdict in verdicts:
        rooms[verdict.room].append(verdict)
    rows = []
    for name, found in (*sorted(rooms.items()), ("all", verdicts)):
        of = collections.Counter(v.outcome for v in found)
        slowest, largest = max(v.seconds for v in found), max(v.bytes for v in found)
        counts = (f"{n:,}" for n in (len(found), of["passed"], of["refused"], of["failed"]))
        rows.append([name, *counts, f"{slowest:.2f}", f"{largest / 2**20:.0f}"])
    header = ["inputs", "number", "passed", "refused in one line", "failed", "slowest [s]", "most memory [MiB]"]
    return markdown(header, rows)


def _again(args):
    """One input of one room, shown."""
    from tests.stress.fuzz import rooms

    for name in args.only:
        room = rooms.ROOMS[name]
        shown = repr(judge.drawn(room, args.number, args.seed))
        print(f"{name} {args.number}: {shown[:4000]}")
        with tempfile.TemporaryDirectory(prefix="cnclik-fuzz-") as folder:
            found = judge.judge(room, args.number, pathlib.Path(folder), args.seed)
        print(f"{found.outcome} in {found.seconds:.2f} s, {found.bytes / 2**20:.0f} MiB: {found.why}")


if __name__ == "__main__":
    main()
