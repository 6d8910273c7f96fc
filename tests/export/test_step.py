"""The exported step against JAX without hints: laws, inverses, limits, methods, stages and precisions in turn."""

import pytest

import cnclik as ck
from cnclik.export.library import compiled
from tests.engine.compare import NEEDS_C
from tests.export import matrix
from tests.export.combinations import INVERSES, LIMITS, NULL, STAGES, Combination, compare

SPREAD = [
    Combination("planar3"),
    Combination("planar2", dtype="float32"),
    Combination("planar3", "pseudoinverse"),
    Combination("planar2", "singular-damped", "bounded", method="TRAPEZOID", stage="chord"),
    Combination("planar2", "pseudoinverse", method="AB2"),
    Combination("planar2", "damped", method="IE", stage="newton"),
    Combination("planar3", "damped", "bounded", "posture"),
    Combination("planar3", "singular-damped", "velocity-scaling", "posture", method="EXP-MIDPOINT"),
    Combination("planar2", "damped", method="HEUN", dtype="float32"),
    Combination("planar2", "damped", method="EXP-AB2", dtype="float32"),
    Combination("planar2", "damped", method="CN", dtype="float32"),
]


@NEEDS_C
@pytest.mark.parametrize("combination", SPREAD, ids=str)
def test_the_exported_step_is_jaxs(combination):
    off, others = compare(combination, 300)
    assert off <= 1 and others == 0


@NEEDS_C
@pytest.mark.parametrize("count", [5, 300])  # of five, repeats nearby are looked at as well
def test_a_gain_that_is_off_in_its_ninth_digit_is_found(count):
    combination = Combination("planar3", "pseudoinverse")
    law, method, stage = combination.parts()
    wrong = compiled(ck.replace(law, alpha=5.0 * (1 + 1e-9)), method=method, stage=stage, dtype=combination.dtype)
    off, _ = compare(combination, count, step=wrong)
    assert off > 1


def test_the_spread_has_every_name_in_it():
    for field, names in (("inverse", INVERSES), ("limits", LIMITS), ("null", NULL), ("stage", STAGES)):
        assert {getattr(c, field) for c in SPREAD} == set(names)


@NEEDS_C
@pytest.mark.slow
@pytest.mark.parametrize("combination", matrix.thirty(), ids=str)
def test_the_exported_step_is_jaxs_for_a_hundred_thousand_inputs(combination):
    off, others = compare(combination, matrix.MANY)
    assert off <= 1 and others == 0


@NEEDS_C
@pytest.mark.slow
@pytest.mark.parametrize("combination", matrix.every()[::60], ids=str)
def test_every_name_goes_through_with_every_other(combination):
    off, others = compare(combination, matrix.FEW)
    assert off <= 1 and others == 0
