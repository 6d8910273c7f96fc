"""CSV files of targets and waypoints: right, nearly right, and damaged."""

import jax
import numpy as np

from cnclik.problem.names import task_from
from cnclik.problem.reference import reference_from
from cnclik.problem.tables import read_points
from cnclik.reaching import targets
from cnclik.robot.builtin import panda
from cnclik.robot.chain import planar_arm
from tests.stress.fuzz.nasty import NUMBERS, TEXTS, any_of, chance, damaged, slipped

ROBOTS = (planar_arm([1.0, 1.0]), panda())
HEADS = (
    ("x", "y", "z", "qw", "qx", "qy", "qz"),
    ("qw", "qx", "qy", "qz", "x", "y", "z"),
    ("time", "x", "y", "z"),
    ("time", "x", "y", "z", "qw", "qx", "qy"),
    ("X", "Y", "Z", "QW", "QX", "QY", "QZ"),
    ("x", "y", "x"),
    ("t", "t", "x", "y"),
    ("x [mm]", "y"),
    ("roll", "pitch"),
)
ENDINGS = (".csv", ".csv", ".csv", ".CSV", ".txt")


def draw(rng):
    """(whether waypoints or targets, the file's ending, its bytes, which robot, the task's name)."""
    rows = int(rng.integers(5)) if chance(rng, 0.8) else int(10 ** rng.uniform(1, 3))
    waypoints = chance(rng, 0.5)
    name = any_of(rng, ("pose", "position", "orientation", "xy", "xyrz") if waypoints else tuple(targets.TASKS))
    robot = int(rng.integers(2)) if name in ("position", "xy", "xyrz") else 1
    columns = {"pose": 7, "orientation": 4, "xyrz": 6 + robot, "xy": 2 + robot}.get(name, 3) + waypoints
    columns = any_of(rng, (1, 2, 3, 4, 5, 7, 8, 16, 17)) if chance(rng, 0.25) else columns
    values = rng.normal(size=(rows, columns))
    values[:, 0] = np.arange(rows) if chance(rng, 0.8) else values[:, 0]
    if columns >= 4:
        values[:, -4:] /= np.linalg.norm(values[:, -4:], axis=1, keepdims=True)
    ending = ".csv" if waypoints and chance(rng, 0.95) else any_of(rng, ENDINGS)
    data = _text(rng, values)
    if chance(rng, 0.1):
        data = damaged(rng, data)
    return waypoints, ending, data, robot, name


def _text(rng, values):
    cells = [[f"{v:.6g}" for v in row] for row in values]
    if cells and chance(rng, 0.3):
        names = list(any_of(rng, HEADS))[: len(cells[0])]
        names += [any_of(rng, ("", "a", "x", "speed"))] * (len(cells[0]) - len(names))
        cells.insert(0, [names[k] for k in rng.permutation(len(names))] if chance(rng, 0.5) else names)
    elif chance(rng, 0.2):
        cells.insert(0, any_of(rng, (["t", "x", "y"], ["# a"], [""], ["1", "a"])))
    for _ in range(int(rng.integers(1, 4)) if cells and chance(rng, 0.6) else 0):
        row = any_of(rng, cells)
        k = int(rng.integers(len(row) + 1))
        match int(rng.integers(6)):
            case 0 | 1:
                row[k : k + 1] = [any_of(rng, NUMBERS)]
            case 2:
                row[k : k + 1] = [any_of(rng, TEXTS)]
            case 3:
                del row[k : k + 1]
            case 4:
                cells.append(list(row))
            case _:
                row[k : k + 1] = [slipped(rng, row[k] if k < len(row) else "1")]
    between, end = (
        any_of(rng, (",", ",", ",", ", ", ";", "\t")),
        any_of(rng, (*("\n",) * 9, "\r\n", "\r", "\n\n", "\u2028")),
    )
    text = end.join(between.join(row) for row in cells) + end
    return text.encode(any_of(rng, (*("utf-8",) * 9, "utf-8-sig", "utf-16", "cp037")), errors="replace")


def attempt(made, folder) -> None:
    """As targets of `reach`, or as waypoints of `solve`."""
    waypoints, ending, data, robot, name = made
    file = folder / f"way{ending}"
    file.write_bytes(data)
    if not waypoints:
        task = targets.TASKS[name]()
        rows, _ = targets.read(read_points("TARGETS", file, task)[1], task)
        assert rows.ndim == 2 and rows.shape[1] == 12 and rows.dtype.kind == "f", rows.shape
        return
    chain = ROBOTS[robot]
    made = reference_from(str(file), chain, task_from(name, chain), np.full(chain.n, 0.3))
    for leaf in jax.tree.leaves(made):
        assert np.isfinite(np.asarray(leaf, float)).all(), f"not finite: {leaf}"
