"""Limits: the shares of the velocity, acceleration and jerk limits that a motion uses, joint by joint."""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.integrate.trajectory import Trajectory, one_lane
from cnclik.precision import of_numbers
from cnclik.record import ArrayLike, Float, Number, record
from cnclik.robot.chain import Chain
from cnclik.robot.chart import apart
from cnclik.robot.model import modelled

QUANTITIES = ("velocity", "acceleration", "jerk")
_ROUNDING = 1e-6  # share of a limit that is rounding


@record
class LimitsTaken:
    """The largest shares of their limits that the joints use; see `check_limits`.

    Attributes:
      velocity, acceleration, jerk: (n,) largest |value|/limit; 0 where there is no limit.
      at: (3, n) time of each, at the start of the sample, in the order of `QUANTITIES` [s].
      names: of the joints.
    """

    velocity: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]
    jerk: Float[np.ndarray, " n"]
    at: Float[np.ndarray, "3 n"]
    names: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether no limit is exceeded."""
        return bool(max(np.max(getattr(self, name), initial=0) for name in QUANTITIES) <= 1 + _ROUNDING)

    def __repr__(self):
        lines = [f"Limits {'kept' if self.ok else 'broken'}: largest part of each, and when"]
        lines.append(f"  {'joint':<16}" + "".join(f"{name:>24}" for name in QUANTITIES))
        for i, joint in enumerate(self.names):
            cells = (f"{getattr(self, name)[i]:.4g} at {self.at[q][i]:.4g} s" for q, name in enumerate(QUANTITIES))
            lines.append(f"  {joint:<16}" + "".join(f"{cell:>24}" for cell in cells))
        return "\n".join(lines)


@of_numbers
def check_limits(
    run: Trajectory | Float[ArrayLike, "N+1 n"],
    *,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    jerk: ArrayLike | None = None,
    chain: Chain | None = None,
    Ts: Number | None = None,
) -> LimitsTaken:
    """Check a motion against limits as a robot's controller does, by differences of sampled joint values from rest.

    q̇[k] = (q[k+1] − q[k])/Ts, q̈[k] = (q̇[k] − q̇[k−1])/Ts, q⃛[k] = (q̈[k] − q̈[k−1])/Ts, with q̇ and q̈ 0 before the
    start. In float32 rounding at 1 kHz alone makes a jerk of 100 rad/s³, so check motions in float64.

    Args:
      run: a `Trajectory` of one lane, whose q̇ is used, or joint values (N + 1, n) from any source [rad, m].
      velocity, acceleration, jerk: limits, a number or one per joint (n,) [rad/s, rad/s², rad/s³; m]; None: no limit.
      chain: its joint names, and its velocity limits where `velocity` is None.
      Ts: sampling time of joint values [s].

    Raises: ArgumentError for shapes and values that do not fit.
    """
    if isinstance(run, Trajectory):
        one_lane(run)
        if Ts is not None:
            raise errors.fail("Ts", "be left out for a Trajectory, which has it", f"is {Ts!r}")
        t, qdot = np.asarray(run.t, float), np.asarray(run.qdot, float)
        Ts = (t[-1] - t[0]) / max(len(qdot), 1)
    else:
        q = np.asarray(errors.array("run", run, (None, None)), float)
        Ts = float(errors.number("Ts", Ts, positive=True))
        if chain is not None:
            errors.kind("chain", chain, Chain)
        moved = np.diff(q, axis=0) if chain is None else np.asarray(apart(chain, q[:-1], q[1:]))
        qdot, t = moved / Ts, np.arange(len(q)) * Ts
    n = qdot.shape[1]
    if not len(qdot):
        raise errors.fail("run", "have a step", "has none")
    if chain is not None and chain.n != n:
        raise errors.fail("chain", f"have the run's {n} joints", f"has {chain.n}")
    if chain is not None and velocity is None:
        velocity = modelled(chain).velocity_limit
    found, at, value = {}, [], qdot
    for name, limit in zip(QUANTITIES, (velocity, acceleration, jerk), strict=True):
        most = np.full(n, np.inf)
        if limit is not None:
            most[:] = errors.array(name, limit, (), (n,), finite=False)
            if not (most >= 0).all():
                raise errors.fail(name, "be at least 0", f"is {most.min():g}")
        part = np.abs(value) / np.maximum(most, 1e-12)  # a limit of 0 is kept by a joint that does not move
        found[name] = part.max(axis=0)
        at.append(t[part.argmax(axis=0)])
        value = np.diff(value, axis=0, prepend=np.zeros((1, n))) / Ts
    names = tuple(f"joint {i + 1}" for i in range(n)) if chain is None else tuple(chain.joint_names)
    return LimitsTaken(**found, at=np.stack(at), names=names)
