"""`python -m tests.diagnosis.long`: how long a log of 60 s at 500 Hz with 20 columns takes to diagnose.

OPENBLAS_NUM_THREADS=1 python -m tests.diagnosis.long      # without threads that wait for each other
"""

import time

import numpy as np

from cnclik.diagnosis import diagnose
from cnclik.measure.files import markdown
from tests.diagnosis.logs import late_loop
from tests.diagnosis.recordings import loop

TS, ROWS, COLUMNS, EVERY = 0.002, 30_000, 20, 3000  # pushed every 6 s
KINDS = ("rings", "rings with a lag", "is excited by noise", "decays", "follows a path", "is noise")


def log(kind, seed=0):
    """(ROWS, COLUMNS) of a loop on a slow path, measured by encoders."""
    rng = np.random.default_rng(seed)
    e = np.zeros(ROWS)
    if kind == "is excited by noise":
        e = 0.1 * late_loop(0.2, 4, 0.0, ROWS, 0.0, rng.standard_normal(ROWS))
    elif kind not in ("follows a path", "is noise"):
        one = {"rings": loop(0.3, 4, 1500), "decays": loop(0.05, 4, 1500)}.get(kind)
        one = late_loop(0.12, 2.3, 5.0, 1500) if one is None else one
        for first in range(0, ROWS, EVERY):
            e[first : first + len(one)] += one
    path = 0.0 if kind == "is noise" else np.sin(2 * np.pi * TS * np.arange(ROWS) / 7)[:, None]
    weights, noise = rng.uniform(-0.1, 0.1, COLUMNS), 3e-4 * rng.standard_normal((ROWS, COLUMNS))
    return path * rng.uniform(0.1, 1, COLUMNS) + rng.uniform(-2, 2, COLUMNS) + np.outer(e, weights) + noise


def main():
    diagnose(log("rings")[:200], TS)  # imports
    rows = []
    for kind in KINDS:
        signal, wall, cpu = log(kind), time.perf_counter(), time.process_time()
        found = diagnose(signal, TS)
        seconds = time.perf_counter() - wall, time.process_time() - cpu
        rows.append([kind, found.kind, *(f"{s:.2f}" for s in seconds)])
    print(markdown(["log of what", "it says", "wall [s]", "CPU [s]"], rows, left=2), end="")


if __name__ == "__main__":
    main()
