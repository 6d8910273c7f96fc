"""`python -m tests.bench`: cnclik against its peers and against what it set out to reach; into one JSON file.

Everything is measured anew; sections can be chosen by name, the others keep what the file holds:

    python -m tests.bench                     # all: about 15 minutes
    python -m tests.bench peers cores         # some
    python -m tests.bench.document            # the pages from the files

Needs `pip install -e .[test,bench]` and g++. Leave the machine alone meanwhile.
"""

import argparse
import json
import pathlib
import sys
import tempfile
import time

from tests.bench import document, peers
from tests.bench import timing as bench
from tests.bench.lines import Line

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "speed"


def say(text):
    print(text, file=sys.stderr, flush=True)


def cores(rounds, seconds):
    """Two cores against one, in turn: [one, two, one, ...]."""
    made = []
    for _ in range(rounds):
        for count in (1, 2):
            line = Line(robot="panda", method="EE", stage="picard", batch=1 << 18, cores=count)
            made.append(bench.measure_apart(line, seconds))
            say(f"{count} cores: {made[-1]['evaluations_per_second'] / 1e6:.2f} M/s")
    return made


def compiling(rounds, seconds):
    """The Panda's program compiled cold, and found in the persistent cache."""
    line, made = Line(robot="panda", method="EE", stage="picard", cores=1), []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            cold = bench.measure_apart(line, 0.0, cache=folder)
            warm = bench.measure_apart(line, 0.0, cache=folder)
        made.append({"cold_s": cold["compile_s"], "cached_s": warm["compile_s"]})
        say(f"compile: {cold['compile_s']:.2f} s cold, {warm['compile_s']:.2f} s from the cache")
    return made


def gradient(rounds, seconds):
    """Value and gradient of the tracking loss, on all cores: XLA compiles on as many as there are."""
    made = []
    for _ in range(rounds):
        line = Line(robot="panda", method="EE", stage="picard", gradient=True)
        made.append(bench.measure_apart(line, seconds))
        say("gradient: q0 {gradient_over_forward:.2f}×, alpha {alpha_gradient_over_forward:.2f}×".format(**made[-1]))
    return made


def million(rounds, seconds):
    """1e6 loops of 30 steps of the paper's 5-joint arm, CN with picard(5), on two cores."""
    made = []
    for dtype in ("float32", "float64"):
        for _ in range(rounds):
            line = Line(robot="planar5", method="CN", stage="picard", dtype=dtype, batch=1_000_000, cores=2, N=30)
            made.append(bench.measure_apart(line, 0.0))
            say("a million loops, {dtype}: {run_s:.2f} s, {peak_mib:.0f} MiB".format(**made[-1]))
    return made


SECTIONS = {
    "peers": lambda args: peers.compare(args.rounds, args.batch, say),
    "cores": lambda args: cores(min(args.rounds, 5), args.seconds),
    "compile": lambda args: compiling(min(args.rounds, 3), args.seconds),
    "gradient": lambda args: gradient(min(args.rounds, 3), args.seconds),
    "million": lambda args: million(min(args.rounds, 3), args.seconds),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__.splitlines()[0])
    parser.add_argument("section", nargs="*", help=f"any of {', '.join(SECTIONS)}; by default all")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=2.0, help="for the repeated runs of one line")
    parser.add_argument("--batch", type=int, default=peers.BATCH, help="of peers; less only to try things")
    parser.add_argument("--output", type=pathlib.Path, default=RESULTS / "peers.json")
    args = parser.parse_args()
    for name in args.section:
        if name not in SECTIONS:
            parser.error(f"section {name!r} is none of {', '.join(SECTIONS)}")
    found = json.loads(args.output.read_text()) if args.output.exists() else {}
    for name in args.section or SECTIONS:
        say(f"== {name}")
        found[name] = SECTIONS[name](args)
        found["machine"] = document.machine()
        found.setdefault("measured", {})[name] = time.strftime("%Y-%m-%d")
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(json.dumps(found, indent=1) + "\n")
    document.show(found)


if __name__ == "__main__":
    main()
