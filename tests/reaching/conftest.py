"""Searches run as C where there is a compiler; tests marked `without_c` run them as programs of XLA."""

import contextlib

import pytest

import cnclik as ck


@pytest.fixture(autouse=True)
def way(request):
    """The engine of a search: "c" or "xla"."""
    with ck.use_engine("xla") if getattr(request, "param", "c") == "xla" else contextlib.nullcontext():
        yield
