"""Loops of the library as C and derived for JAX, held against jax.vmap: laws, limits, methods, stages.

An eighth of a spread by default; the spread, in which every name occurs, and every pair of names with `pytest -m slow`.
"""

import itertools

import jax
import numpy as np
import pytest

import cnclik as ck
from engine.compare import check
from tests.export.combinations import INVERSES, LIMITS, NULL, STAGES, Combination

N, SIZE = 5, 11


def spread() -> list:
    """Every method, and every name beside some of them."""
    found = []
    for k, method in enumerate(ck.METHODS):
        inverse, limits, null = (list(names)[(k + k // 3) % len(names)] for names in (INVERSES, LIMITS, NULL))
        stage = list(STAGES)[k % 3] if ck.METHODS[method].implicit else "picard"
        found.append(Combination("planar3", inverse, limits, null, method, stage, ("float64", "float32")[k % 4 == 3]))
    return found


def pairs() -> list:
    """Every pair of names of two kinds."""
    kinds = {"inverse": INVERSES, "limits": LIMITS, "null": NULL, "method": ck.METHODS, "stage": STAGES}
    found = {}
    for one, two in itertools.combinations(kinds, 2):
        for a, b in itertools.product(kinds[one], kinds[two]):
            made = Combination("planar3", **{one: a, two: b})
            if made.stage != "picard" and not ck.METHODS[made.method].implicit:
                made = made._replace(method="CN")
            if made.limits != "bounded" or made.inverse != "pseudoinverse":  # refused
                found[str(made)] = made
    return list(found.values())


def lanes_of(law, dtype):
    """Postures within limits and away from singular ones, targets near them, and one that is not a number."""
    rng, n = np.random.default_rng(1), law.chain.n
    q0 = rng.uniform(0.3, 1.2, (SIZE, n))
    q0[3, 0] = np.nan
    at = [ck.forward(law.chain, q + 0.2) for q in np.nan_to_num(q0, nan=0.5)]
    position = np.array([np.asarray(p.position)[list(law.task.linear)] for p in at])
    return q0.astype(dtype), position.astype(dtype)


def run_of(combination):
    """A loop's whole trajectory, as a function of a lane's start and target."""
    law, method, stage = combination.parts()

    def run(q0, position):
        made = ck.solve(law, ck.hold(position), q0, 0.05, N, method, stage)
        return {name: getattr(made, name) for name in ("t", "q", "e", "x", "qdot", "residual", "status")}

    return law, run


def held(combination, loose=1.0, derived_too=True):
    """Asserts that the derived programs give what JAX does."""
    law, run = run_of(combination)
    with jax.enable_x64(combination.dtype == "float64"):
        check(run, *lanes_of(law, combination.dtype), ulps=loose * 3e3, scalar_too=False, derived_too=derived_too)


@pytest.mark.parametrize("combination", spread()[::8], ids=str)
def test_loops(combination):
    held(combination, derived_too=combination.limits != "bounded")  # XLA takes seconds for such a one


@pytest.mark.slow
@pytest.mark.parametrize("combination", [*spread(), *pairs()], ids=str)
def test_pairs(combination):
    held(combination)
