"""`python -m tests.stress.numerics`: thousands of random loops of every kind, on several processes.

python -m tests.stress.numerics                       # 2,000 kinds of loops
python -m tests.stress.numerics --kinds 100 --first 500
XLA_FLAGS=--xla_cpu_max_isa=AVX2 python -m tests.stress.numerics      # as on a processor without AVX-512
"""

import argparse
import collections
import multiprocessing
import os
import signal
import sys
import time

from cnclik.cli.progress import bar
from cnclik.measure.files import markdown
from tests.stress.numerics.checks import one


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    args = parser.parse_args()
    seeds, begun = range(args.first, args.first + args.kinds), time.time()
    kinds, loops, alike, failed = (collections.Counter() for _ in range(4))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # by way of what tells what was found
    context = multiprocessing.get_context("spawn")
    try:
        with context.Pool(args.processes, maxtasksperchild=50) as pool, bar("kinds", args.kinds) as report:
            for done, (seed, way, wrong, count, compared) in enumerate(pool.imap_unordered(one, seeds), 1):
                kinds[way] += 1
                loops[way] += count
                alike[way] += compared
                if wrong:
                    failed[way] += 1
                    print(f"seed {seed}, {wrong}", file=sys.stderr, flush=True)
                report(done, args.kinds)
    finally:  # what was found stands, also where this is stopped
        rows = [[way, kinds[way], loops[way], alike[way], failed[way]] for way in sorted(kinds)]
        print(markdown(["held against", "kinds", "loops", "compared", "wrong"], rows))
        minutes = (time.time() - begun) / 60
        print(f"{kinds.total()} kinds in {minutes:.0f} min on {args.processes} processes.", flush=True)
    sys.exit(failed.total() > 0)


if __name__ == "__main__":
    main()
