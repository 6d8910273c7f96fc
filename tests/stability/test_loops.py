"""Verdicts on random loops are true of runs twenty times as long, and their remedies mend; see `loops`."""

import pytest

import cnclik as ck
from tests.stability import loops


def wrong(number, count):
    with ck.use_form("rolled"):
        found = loops.judge(loops.family(number), count)
    told = [f"{one['about']}: {one['false']}: {one['said']}" for one in found if one["false"]]
    vain = [(one["about"], one["said"], told) for one in found for told in one["remedies"] if not told["good"]]
    kinds = {one["kind"] for one in found}
    return told, vain, kinds, sum(kind["kind"] == "too short to tell" for kind in found)


@pytest.mark.parametrize("number", [2, 19, 22])
def test_no_verdict_is_false_and_no_remedy_vain(number):
    told, vain, kinds, short = wrong(number, 14)
    assert not told and not vain
    assert len(kinds) >= 3 and short < 10  # it does not get away with saying nothing


@pytest.mark.slow
@pytest.mark.parametrize("number", range(25))
def test_no_verdict_of_many_is_false(number):
    told, vain, _, _ = wrong(number, 80)
    assert not told and len(vain) <= 2
