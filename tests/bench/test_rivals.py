"""tests.bench.rivals: its table, and that each way uses what it may."""

import numpy as np
import pytest

from cnclik.tuning import parameters as pm
from tests.bench.rivals import Row, as_csv, grid_of, page, rivals


def test_rivals_page_and_csv():
    row = Row("2-dof line", "scalar", "grid", np.inf, False, 1.2, 0.0, 100, 1.5, 0.5, [5.0])
    assert "| not finite | NO | 1.200 | 100 | 1.5 | 0.50 |" in page([row], 0.9, 100)
    assert as_csv([row]).splitlines()[1] == "2-dof line,scalar,grid,inf,False,1.2,0.0,100,1.5,0.5,[5.0]"


@pytest.mark.parametrize("axes", [0, 1, 2, 3, 6])
def test_grid_uses_no_more_than_it_may(axes):
    start = np.full((axes,), 5.0) if axes else 5.0
    p = pm.parameter("alpha", start, 0.01, 100.0, None)
    grid = grid_of(p, 100)
    each = max(2, int(100 ** (1 / max(axes, 1)) + 1e-9))
    assert grid.shape == (each ** max(axes, 1), *np.shape(start)) and len(grid) <= 100
    assert np.all(grid > 0.01) and np.all(grid < 100) and grid.min() < 1 < 20 < grid.max()


@pytest.mark.slow
def test_gradient_is_no_worse_than_its_rivals():
    rows = {r.way: r for r in rivals("2-dof line", "per-axis", steps=60)}
    assert len(rows) == 4 and all(r.satisfied and r.evaluations <= 60 for r in rows.values())
    assert rows["gradient"].loss <= min(r.loss for r in rows.values()) * (1 + 1e-6)
    assert rows["gradient"].loss < 0.5 * rows["hand-picked α = 5"].loss
