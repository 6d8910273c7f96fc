"""Stamps of any unit and name give the sampling time, with jitter; missing rows are named; status is left out."""

import numpy as np
import pytest

from cnclik.cli.log import clock, no_motion
from cnclik.diagnosis.recording import sampling_time
from cnclik.errors import ArgumentError

TS = 0.002
K = np.arange(400)


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize(("unit", "size"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_units_follow_from_the_size_of_stamps(unit, size, start):
    """Logs of 2 to 5 kHz were read as 1000 times slower: now what may be two units is refused, or Ts decides."""
    for Ts in (TS, 2.5e-4, 0.25):
        q = np.stack([(start + Ts * K) * size, np.sin(K)], 1)
        if start or Ts == TS or (unit == "s" and Ts == 2.5e-4) or (unit == "ns" and Ts == 0.25):
            t, places, read = clock(["/header/stamp", "q1"], q)
            assert places == [0] and read == unit and sampling_time(t, None) == pytest.approx(Ts, rel=1e-3)
        else:
            with pytest.raises(ArgumentError, match=f"`Ts` must be given, or the unit .* may be .*{unit}"):
                clock(["t"], q[:, :1])
        assert clock(["t"], q[:, :1], 1.2 * Ts)[2] == unit


def test_units_follow_from_names():
    named = {"__time": 1, "time_ms": 1e-3, "stampNs": 1e-9, "sec": 1, "t [ms]": 1e-3}
    for name, factor in named.items():
        t, places, _ = clock((name,), 0.01 / factor * np.arange(5.0)[:, None])
        assert places == [0] and t == pytest.approx(0.01 * np.arange(5.0)), name
    for name in ("q1", "x", "q_t", "time_constant_q", "translation", "timer_state", "ms"):
        assert clock((name,), np.arange(5.0)[:, None])[:2] == (None, []), name


@pytest.mark.parametrize("names", [("header.stamp.sec", "header.stamp.nanosec"), ("/stamp/secs", "/stamp/nsecs")])
def test_seconds_and_nanoseconds_are_one_time(names):
    ns = 1_700_000_000_900_000_000 + 2_000_000 * K.astype(np.int64)
    t, places, _ = clock([*names, "position"], np.stack([ns // 10**9, ns % 10**9, np.cos(K)], 1).astype(float))
    assert places == [0, 1]
    np.testing.assert_allclose(t, TS * K, atol=1e-9)


def test_jitter_is_no_missing_row_and_status_no_motion():
    rng = np.random.default_rng(0)
    for jitter in (1e-4, 4e-4, 7e-4):
        t = TS * K + jitter * rng.standard_normal(len(K))
        assert sampling_time(t, None) == pytest.approx(TS, rel=0.01)
    t[200:] += 3 * TS
    with pytest.raises(ArgumentError, match="row 201 comes"):
        sampling_time(t, None)
    assert sampling_time(t, TS) == TS  # a Ts that is given goes first
    names = ["q1", "robot_mode", "status", "header.seq", "frame_id", "stateX", "q2"]
    table = np.stack([np.sin(K), 0 * K + 7, K % 3, K, np.nan * K, 0.5 * np.cos(K), K % 2], 1)
    assert no_motion(names, table) == [1, 2, 3, 4]
