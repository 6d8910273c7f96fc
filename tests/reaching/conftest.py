"""Tests of a dozen targets are of batches; in use so few are searched for one by one.

Searches are native, but where a test says otherwise: `jax_alone` are those of machines without a compiler.
"""

import pytest

from cnclik.reaching import many, native, single


@pytest.fixture(autouse=True)
def way(request, monkeypatch):
    """How targets are searched for."""
    monkeypatch.setattr(single, "ONE_BY_ONE", (8, 8))
    monkeypatch.setattr(native, "AT_ONCE", 1000)
    if getattr(request, "param", "native") == "jax":
        monkeypatch.setattr(many, "native_for", lambda *_: None)
