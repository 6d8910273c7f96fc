"""Every method has the orders that docs/methods.md tells: on its path and from off it, with exact and damped J#."""

import functools
import pathlib
import re

import numpy as np
import pytest
import scipy.integrate

import cnclik as ck
from tests.integrate.test_exponential import CIRCLE, LAW, START, by_steps
from tests.oracles import damped_inverse, planar_law

PAGE = pathlib.Path(__file__).parents[2] / "docs" / "methods.md"
OFF = START + np.array([0.1, -0.08, 0.12])
EXACT = 1e-9  # a damping that counts for nothing: one program for all cases, see tests/law/test_inverse.py
CASES = {"on its path": (START, EXACT), "from off it": (OFF, EXACT), "damped": (OFF, 0.3)}
STEPS = {"EXP-HEUN": 320}  # N at least


def told():
    """The rows of the page's table of orders: method, and its order in each case."""
    table = PAGE.read_text().split("| method | on its path | from off it | damped |")[1].split("\n\n")[0]
    for line in table.splitlines()[2:]:
        names, *orders = (cell.strip() for cell in line.strip().strip("|").split("|"))
        for name in re.findall(r"`([A-Z0-9-]+)`", names):
            yield name, dict(zip(CASES, map(int, orders), strict=True))


ORDERS = dict(told())


@functools.cache
def exact(case):
    q0, damping = CASES[case]
    center = np.asarray(ck.forward(LAW.chain, START).position)[:2] - [0.2, 0.0]
    turn = lambda t: np.pi / 2 * t  # noqa: E731
    f = planar_law(
        np.array([0.7, 1.1, 0.4]),
        lambda t: center + 0.2 * np.array([np.cos(turn(t)), np.sin(turn(t))]),
        lambda t: 0.2 * np.pi / 2 * np.array([-np.sin(turn(t)), np.cos(turn(t))]),
        4.0,
        inverse=np.linalg.pinv if damping == EXACT else damped_inverse(damping),
    )
    end = scipy.integrate.solve_ivp(lambda t, q: f(q, t), (0.0, 1.0), q0, method="DOP853", rtol=3e-14, atol=1e-14)
    return end.y[:, -1]


def test_the_table_has_every_method():
    assert set(ORDERS) == set(ck.METHODS)
    assert all(ck.METHODS[name].order == orders["on its path"] for name, orders in ORDERS.items())


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ORDERS)
def test_order(name, case):
    q0, damping = CASES[case]
    law = ck.replace(LAW, inverse=ck.damped(damping))
    N = STEPS.get((name, case), STEPS.get(name, 80))
    coarse, fine = (np.linalg.norm(by_steps(law, CIRCLE, q0, 1 / n, n, name)[0][-1] - exact(case)) for n in (N, 2 * N))
    assert np.log2(coarse / fine) == pytest.approx(ORDERS[name][case], abs=0.25)
