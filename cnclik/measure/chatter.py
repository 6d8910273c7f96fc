"""Chatter: how much of a joint's motion is back and forth."""

import numpy as np


def chatter(qdot, *, settled=0.5) -> float:
    """RMS speed that is taken back in the next step, over the last part of a run [rad/s, m/s].

    A joint that moves at a in one step and at −b in the next takes back min(a, b); one that slows down, however
    hard, takes back nothing. Alternation at ±a measures a·√n' for n' such joints, smooth motion 0.

    Args:
      qdot: (N, n) joint velocities of the steps.
      settled: the part of the run that is looked at, counted from its end.
    """
    qdot = np.asarray(qdot)
    late = qdot[int(len(qdot) * (1 - settled)) :]
    if len(late) < 2:
        return 0.0
    back = np.where(late[1:] * late[:-1] < 0, np.minimum(np.abs(late[1:]), np.abs(late[:-1])), 0.0)
    return float(np.sqrt(np.mean(np.sum(back**2, axis=1))))
