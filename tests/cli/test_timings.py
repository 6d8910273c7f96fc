"""Where a command's time goes: each instant counts once."""

import time

import pytest

from cnclik.cli import timings


def test_each_instant_counts_once():
    spans = timings.Spans(0.0)
    spans.found["importing"].append((0.0, 2.0))
    spans.found["tracing"].append((2.0, 6.0))
    spans.found["tracing"].append((3.0, 4.0))  # a function inside another
    spans.found["compiling"].append((5.0, 5.5))  # a number that was needed while tracing
    spans.found["compiling"].append((6.0, 9.0))
    spans.found["compiling"].append((7.0, 10.0))  # side by side
    spans.found["drawing"].append((11.0, 13.0))
    spans.found["importing"].append((11.0, 11.5))
    found = spans.seconds(now=14.0)
    assert found == {"compiling": 4.5, "tracing": 3.5, "importing": 2.5, "drawing": 1.5, "running": 2.0}
    assert sum(found.values()) == 14.0


def test_programs_are_seen():
    import jax

    begun = time.time()
    with timings.watch(begun) as spans:
        jax.jit(lambda x: x * 3.25 + len("here"))(1.0)
    found = spans.seconds()
    assert found["compiling"] > 0 and found["tracing"] > 0
    assert str(spans).startswith("Time ") and "(1 program, " in str(spans)
    before = str(spans).partition(":")[2]
    jax.jit(lambda x: x * 4.25)(1.0)
    assert "(1 program, " in before and len(spans.found["compiling"]) == 1


def test_length_of_a_union():
    assert timings.length([]) == 0
    assert timings.length([(3, 4), (0, 2), (1, 2.5), (1, 1.5)]) == pytest.approx(3.5)
