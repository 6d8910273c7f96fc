"""Loops as C, as the engine's scalars and as their source, and on Pinocchio's kinematics for real robots.

No other test asks the engines about loops of no special kind. The oracle of planar arms, with every method, is
tests/integrate/test_combinations.py.
"""

import jax
import pytest

from engine.compare import check
from tests import bank
from tests.oracles import close


@pytest.mark.parametrize("loop", bank.LOOPS, ids=lambda loop: "-".join(loop))
def test_c_scalars_source_and_oracle_are_one(loop):
    given = loop.numbers()
    with jax.enable_x64(loop.dtype == "float64"):
        planar = loop.name.startswith("planar")  # of larger ones XLA takes seconds for scalars
        found = check(loop.run, *given, ulps=3e3, derived_too=planar, scalar_too=loop.name == "planar2")
    assert found["q"].dtype == loop.dtype and not found["status"].any()
    for k in range(bank.LANES if loop.name == "g1" else 0):
        close(found["q"][k], bank.by_pinocchio(*(v[k] for v in given)), atol=1e-11)
