"""Threads that nobody waits for."""

import threading
import time

import pytest

from cnclik.threads import cores, side_by_side


def test_what_is_asked_for_runs_to_its_end_side_by_side():
    meet = threading.Barrier(2)  # passed only by two at once
    with side_by_side(2) as pool:
        found = [pool.submit(meet.wait, 10) for _ in range(2)]
    assert all(one.done() and one.exception() is None for one in found)
    assert cores() >= 1


@pytest.mark.parametrize("left", [KeyboardInterrupt, ValueError])
def test_who_is_interrupted_waits_for_nothing_and_begins_nothing_more(left):
    go, begun, started = threading.Event(), time.perf_counter(), []

    def work(number):
        started.append(number)
        go.wait(20)

    try:
        with pytest.raises(left), side_by_side(1) as pool:
            pool.map(work, range(3))
            raise left
        assert time.perf_counter() - begun < 10
    finally:
        go.set()
    time.sleep(0.1)
    assert started == [0]
