"""Threads that nobody waits for."""

import threading
import time

import pytest

from cnclik.threads import side_by_side


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
