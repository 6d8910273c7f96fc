"""Time: refused where a run's dtype has no such instants, and one compiled program whatever type a number comes in."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik import cache
from cnclik.integrate import solve as solving
from tests.bank import screws
from tests.engine.compare import NEEDS_C
from tests.refusals import refusals

SLIDER = screws([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], [0.0, 0.0, 0.0], kinds="P")
LAW = ck.Law(SLIDER, ck.position("x"), alpha=2.0)
WAVE = ck.lissajous([0.0], [1.0], period=4.0)
Q32 = np.zeros(1, np.float32)
FAR = float(2**16 - 1)  # [s] where float32 times are 2**-8 s apart

NUMBERS = {
    "float": float,
    "int": int,
    "float64": np.float64,
    "float32": np.float32,
    "int64": np.int64,
    "int32": np.int32,
    "0-d": np.array,
    "0-d float32": lambda v: np.asarray(v, np.float32),
    "jax": jnp.asarray,
    "jax float": lambda v: jnp.asarray(v, float),
}


@NEEDS_C
def test_programs_of_several_numbers_of_steps_are_few_together(monkeypatch):
    """There were as many as are kept for each of as many numbers of steps."""
    monkeypatch.setattr(cache, "KEPT_PROGRAMS", 2)
    for length in (0.25, 0.5):
        law = ck.Law(ck.planar_arm([length]), ck.position("x"), alpha=2.0)
        for N in (2, 4):
            ck.solve(law, WAVE, np.ones(1), 0.01, N, "EE")
    assert 0 < len(solving.a_run.ready) <= 2 and len(solving.a_run.functions) <= 2


@pytest.fixture
def compiled():
    """A list of what JAX and the engine compile."""
    found = []

    def heard(event, begun, ended, **_):  # the engine reports no durations
        if "backend_compile" in event:
            found.append(event)

    jax.monitoring.register_event_time_span_listener(heard)
    yield found
    jax.monitoring.unregister_event_time_span_listener(heard)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_one_program_for_all_types_of_numbers(dtype, monkeypatch, compiled):
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 1000)  # those of earlier tests could make it forget this one
    q, count, found = np.zeros(1, dtype), [], []
    for one, two in [(make(1), make(2)) for make in NUMBERS.values()]:
        run = ck.solve(LAW, WAVE, q, one, 3, t0=two)
        q1 = ck.step(LAW, WAVE, q, two, one).q
        count.append(len(compiled))
        found.append(np.concatenate([run.q[-1], q1]))
    assert len(set(count)) == 1
    assert len({tuple(v) for v in found}) == 1


def test_times_just_fine_enough_advance():
    assert np.all(np.diff(ck.solve(LAW, WAVE, Q32, 2.0**-8, 3, t0=FAR).t) > 0)


test_times_that_would_stand_still_are_refused = refusals(
    (lambda: ck.solve(LAW, WAVE, Q32, 2.0**-9, 3, t0=FAR), "`t0` must be counted"),
    (lambda: ck.step(LAW, WAVE, Q32, time.time(), 0.01), r"`t` must be counted from the start of the motion.*x64"),
    (lambda: ck.step(LAW, WAVE, Q32, 1e39, 0.01), r"`t` must be .* float32 times are inf s apart there, and Ts"),
    (lambda: ck.step(LAW, WAVE, Q32, -1e6, 0.01), r"`t` must be .* float32 times are 0.0625 s apart there, and Ts"),
    (lambda: ck.solve(LAW, WAVE, Q32, 0.01, 5, t0=1.75e9), "`t0` must be counted from the start of the motion"),
    (lambda: ck.solve(LAW, WAVE, Q32, 0.01, 10**8), "`N` must be smaller, .* but is 100000000: float32 times"),
    (lambda: ck.solve(LAW, WAVE, np.zeros(1), 0.01, 5, t0=1e18), "`t0` must be counted"),
)
