"""A share of `python -m tests.stress.numerics`: short arms, each held against another way to run it."""

import pytest

import cnclik as ck
from tests.stress.numerics import cases, checks


def short(way, after=0):
    """The first seed of a short arm with a small task that is held against this way."""

    def fits(seed):
        kind = cases.kind(seed)
        small = len(kind.kinds) <= 3 and kind.task in ("xy", "z", "rz") and kind.N and not kind.method.startswith("IF")
        return small and checks.way_of(seed) == way and cases.loop(kind, [seed, 0]) is not None

    return next(filter(fits, range(after, 5000)))


@pytest.mark.parametrize("way", checks.WAYS)
def test_finite_or_flagged_and_the_same_in_every_way(way):
    wrong, kind, loops, _ = checks.check(short(way))
    assert wrong is None, f"{kind}: {wrong}"
    assert loops


def test_a_difference_is_found(monkeypatch):
    """The checks can fail: a loop whose numbers depend on how it is run."""
    solve = cases.Loop.solve

    def other(self, kind, q0=None, alpha=None):
        made = solve(self, kind, q0, alpha)
        traced = q0 is not None and not ck.errors.concrete(q0)
        return ck.replace(made, q=made.q + 1.0) if traced else made

    monkeypatch.setattr(cases.Loop, "solve", other)
    seed, compared = 0, 0
    while not compared:  # a loop that grows, or is next to a singularity, is compared with nothing
        seed = short("lanes", seed + 1)
        wrong, *_, compared = checks.check(seed)
    assert "lanes differs in q" in wrong
