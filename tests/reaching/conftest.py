"""Tests of a dozen targets are of batches; in use so few are searched for one by one."""

import pytest

from cnclik.reaching import many


@pytest.fixture(autouse=True)
def batches(monkeypatch):
    monkeypatch.setattr(many, "ONE_BY_ONE", dict.fromkeys(many.ONE_BY_ONE, 8))
