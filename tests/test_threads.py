"""Threads that nobody waits for."""

import threading
import time

import pytest

from cnclik.sweeps import program
from cnclik.sweeps.grid import grid
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


def test_an_interrupted_sweep_does_not_wait_for_its_compilers(monkeypatch):
    compiled, begun, real = threading.Event(), time.perf_counter(), program.compile_program

    def slow(study, fixed, of):
        if fixed["N"] > 1:
            compiled.wait(20)
        return real(study, fixed, of)

    monkeypatch.setattr(program, "compile_program", slow)
    of = grid({"N": [1, 2, 3], "z": [0.5, 1.0]})
    try:
        blocks = program.run_blocks(lambda N, z: {"y": N * z}, of, of.blocks())
        next(blocks)
        blocks.close()  # as an exception in the loop around it does
        assert time.perf_counter() - begun < 10
    finally:
        compiled.set()
