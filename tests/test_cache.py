"""Caches in memory are bounded: a process meets new numbers of steps, literals and lambdas all day."""

import functools
import gc
import weakref

import cnclik as ck
from cnclik import cache


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

    for k in (*range(1, 9), 8, 8, 1):
        assert raised(2.0, power=k) == 2.0**k
    assert traced == [*range(1, 9), 8, 1]  # every fourth makes room, and what is asked for again is there


def test_a_robot_that_nobody_holds_takes_its_programs_along():
    """A method of a jitted function, kept beside it, is a cycle that Python never collects: 6 MiB for each robot."""
    robot = ck.planar_arm([0.7, 0.6])
    ck.reach(robot, [0.5, 0.4], task=ck.position("xy"))
    alive = weakref.ref(robot)
    del robot
    gc.collect()
    assert alive() is None
