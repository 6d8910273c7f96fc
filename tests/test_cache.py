"""Caches in memory are bounded: a process meets new literals and lambdas all day. No thread is waited for."""

import functools
import gc
import threading
import time
import weakref

import pytest

import cnclik as ck
from cnclik import cache
from cnclik.threads import side_by_side


def test_a_cache_keeps_a_bounded_number_of_entries(monkeypatch):
    monkeypatch.setattr(cache, "KEPT_PROGRAMS", 3)
    recent = cache.LRU()
    for i in range(5):
        recent[i] = str(i)
        recent.get(0)  # in use all the time: it stays
    assert list(recent) == [3, 4, 0] and recent.get(2) is None
    assert recent.get(3) == "3" and list(recent) == [4, 0, 3]


def test_programs_of_a_function_are_few_and_right(monkeypatch):
    """As in a process that meets new numbers of steps, literals and lambdas all day."""
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 3)
    traced = []

    @functools.partial(cache.bounded_jit, static_argnames="power")
    def raised(x, *, power):
        traced.append(power)
        return x**power

    for k in (*range(1, 5), 4, 4, 1):
        assert raised(2.0, power=k) == 2.0**k
    assert traced == [*range(1, 5), 4, 1]  # every fourth makes room, and what is asked for again is there


def test_a_robot_that_nobody_holds_takes_its_programs_along():
    """A method of a jitted function, kept beside it, is a cycle that Python never collects: 6 MiB for each robot."""
    robot = ck.planar_arm([0.7, 0.6])
    ck.reach(robot, [0.5, 0.4], task=ck.position("xy"))
    alive = weakref.ref(robot)
    del robot
    gc.collect()
    assert alive() is None


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
