"""Logs for `diagnose` and `check`: loops that ring, steps of drives, noise, and what logs are full of."""

import contextlib
import io

import numpy as np

from cnclik.cli import main
from tests.stress.fuzz.judge import one_line
from tests.stress.fuzz.nasty import NUMBERS, TEXTS, any_of, chance, damaged, slipped

CLOCKS = ("time", "t", "timestamp", "__time", "/header/stamp", "header.stamp.sec", "Time", "time_ns", "stamp")
OPTIONS = (["--step"], ["--alpha", "20"], ["--json"], ["--command", "velocity"], ["--kind", "lag"])
NAMES = ("q1", "command", "position", "", "header.stamp.sec", "header.stamp.nanosec")
STAMPS = ("time", "timestamp", "__time", "/header/stamp", "t [ms]", "time_ns", "t")


def draw(rng):
    """(the file's bytes, options)."""
    rows = int(any_of(rng, (0, 1, 5, 15, 16, 40, 120, 300)))
    columns = int(rng.integers(1, 4))
    k = np.arange(rows)[:, None]
    growth, turn = rng.uniform(0.9, 1.05), rng.uniform(0, np.pi)
    values = any_of(rng, (1.0, 1e-9, 1e9, 1e300)) * growth**k * np.cos(turn * k + rng.uniform(0, 6, (1, columns)))
    if chance(rng, 0.3):
        values = (k > rows // 4) * rng.normal(size=columns) * (1 - np.exp(-np.maximum(k - rows // 4, 0) / 7))
    values = values + any_of(rng, (0.0, 1e-3, 1.0)) * rng.normal(size=(rows, columns)) + rng.normal(size=columns)
    names = [
        any_of(rng, ("q1", "command", "position", "x", "t", "", "/joint_states/position[0]", "status", "mode"))
        for _ in range(columns)
    ]
    timed = chance(rng, 0.5)
    if timed:
        clock = 0.01 * (k + any_of(rng, (0.0, 0.0, 0.04, 0.5)) * rng.normal(size=k.shape)) + any_of(rng, (0.0, 1.7e9))
        clock = clock * any_of(rng, (1.0, 1.0, 1e3, 1e6, 1e9, -1.0, 0.0))
        values, names = np.hstack([clock, values]), [any_of(rng, CLOCKS), *names]
    cells = [[f"{v:.9g}" for v in row] for row in values]
    if timed or chance(rng, 0.5):
        cells.insert(0, names)
    for _ in range(int(rng.integers(1, 4)) if cells and chance(rng, 0.3) else 0):
        row = any_of(rng, cells)
        j = int(rng.integers(len(row) + 1))
        row[j : j + 1] = any_of(rng, ([any_of(rng, NUMBERS)], [any_of(rng, TEXTS)], [], [""], [slipped(rng, "1.5")]))
    data = "\n".join(",".join(row) for row in cells).encode("utf-8", errors="replace")
    chosen = [word for one in OPTIONS if chance(rng, 0.15) for word in one]
    if not timed or chance(rng, 0.1):
        chosen += ["--Ts", "0.01"]
    if chance(rng, 0.2):
        chosen += ["--columns", any_of(rng, (*names, "none"))]
    if chance(rng, 0.1):
        return damaged(rng, data), chosen
    return _logged(rng) if len(data) % 3 == 2 else (data, chosen)


def _logged(rng):
    """As recorders write them: stamps of any name and unit that jitter, status, texts, growth of any speed."""
    rows = int(any_of(rng, (16, 60, 200)))
    k = np.arange(rows)[:, None]
    turn = any_of(rng, (0.0, rng.uniform(0, np.pi)))
    values = rng.uniform(1, 3) ** k * np.cos(turn * k + rng.uniform(0, 6, (1, 2)))
    values = values + any_of(rng, (0.0, 1e-3)) * rng.normal(size=values.shape)
    jitter = any_of(rng, (0.0, 1e-3, 1e-2)) * rng.normal(size=k.shape)
    stamps = any_of(rng, (1.0, 1e3, 1e9)) * (0.01 * k + jitter + any_of(rng, (0.0, 1.7e9)))
    names = [any_of(rng, STAMPS), *(any_of(rng, NAMES) for _ in range(2)), "status", "frame_id"]
    text = any_of(rng, ("base", "", "7"))
    cells = [names, *([f"{v:.17g}" for v in row] + ["3", text] for row in np.hstack([stamps, values]))]
    options = [word for one in OPTIONS if chance(rng, 0.2) for word in one]
    return "\n".join(",".join(row) for row in cells).encode(), options


def attempt(made, folder) -> None:
    data, options = made
    file, said, code = folder / "log.csv", io.StringIO(), 0
    file.write_bytes(data)
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            main(["check" if len(data) % 5 == 0 and not options else "diagnose", str(file), *options])
        except SystemExit as leaving:
            code = leaving.code
    one_line(code, said.getvalue())
