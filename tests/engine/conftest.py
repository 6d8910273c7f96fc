"""C programs that run once are built sooner less optimised; the slow tests and the other rooms build as users do."""

import os

import pytest


@pytest.fixture(autouse=True)
def _built_soon(request, monkeypatch):
    if "slow" not in request.keywords:
        monkeypatch.setenv("CFLAGS", f"{os.environ.get('CFLAGS', '')} -O1")
