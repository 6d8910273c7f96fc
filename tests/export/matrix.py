"""`python -m tests.export.matrix`: every law, inverse, limit, method, stage and precision, held against JAX.

Thirty combinations with 100,000 inputs each, all others on a small arm with five. Each line is a combination, its
largest difference in units of what is allowed, and how many lanes differ in status; the exit code is 1 if one fails.
JAX compiles each combination for seconds: all others take hours, `--part 3/40` takes a fortieth of them.
"""

import argparse
import itertools
import sys
import time

import jax
import numpy as np

import cnclik as ck
from tests.export.combinations import INVERSES, LIMITS, NULL, STAGES, Combination, compare

MANY, FEW = 100_000, 5


def every() -> list:
    """All combinations, on the smallest arm that has a null space where there is a term for it."""
    found = []
    for inverse, limits, null, method in itertools.product(INVERSES, LIMITS, NULL, ck.METHODS):
        stages = STAGES if ck.METHODS[method].implicit else ("picard",)
        robot = "planar2" if null == "none" else "planar3"
        for stage, dtype in itertools.product(stages, ("float64", "float32")):
            found.append(Combination(robot, inverse, limits, null, method, stage, dtype))
    return found


def thirty() -> list:
    """A spread in which every name occurs, on arms of 2 to 7 joints."""
    random, found = np.random.default_rng(2), []
    methods = random.permutation(list(ck.METHODS))
    for k in range(30):
        method = str(methods[k % len(methods)])
        inverse, limits, null = (list(names)[k % len(names)] for names in (INVERSES, LIMITS, NULL))
        stage = list(STAGES)[(k // 8) % 3] if ck.METHODS[method].implicit else "picard"
        light = limits == "none" and null == "none"
        method = ("EE", "EXP-EE", "HEUN")[(k // 12) % 3] if light else method  # JAX compiles six axes for minutes
        robot = ("ur5", "panda")[(k // 12) % 2] if light else ("planar2", "planar3", "planar4")[(k // 4) % 3]
        found.append(Combination(robot, inverse, limits, null, method, stage, ("float64", "float32")[(k // 2) % 2]))
    return found


def run(combinations, count, say=print) -> int:
    """How many fail."""
    failed = 0
    for combination in combinations:
        begun = time.perf_counter()
        try:
            off, others = compare(combination, count)
        except AssertionError:
            off, others = np.inf, -1
        bad = not (off <= 1 and others == 0)
        failed += bad
        seconds = time.perf_counter() - begun
        say(f"{combination}: {off:.3g}, {others}{'  FAILED' * bad}  ({seconds:.1f} s)", flush=True)
        jax.clear_caches()
    return failed


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.export.matrix", description=__doc__.splitlines()[0])
    parser.add_argument("--part", default="1/1", help="of all others, such as 3/40; 0/1 for none")
    parser.add_argument("--thirty", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--count", type=int, default=MANY)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    part, parts = map(int, args.part.split("/"))
    failed = run(thirty(), args.count) if args.thirty else 0
    failed += run(every()[part - 1 :: parts], FEW) if part else 0
    print(f"{failed} failed")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
