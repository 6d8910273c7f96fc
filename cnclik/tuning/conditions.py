"""Conditions: what disturbs a loop that is judged (noise, drives), and the runs drawn from them."""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.solve import solve
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.law import check_loop
from cnclik.law.reference import Reference
from cnclik.record import AnyArray, Array, ArrayLike, Float, record, stack
from cnclik.robot.model import as_joint_values
from cnclik.tuning.parameters import Adjustable


@record
class Conditions:
    """Disturbances that a robot adds to a loop. By default none: the measured error is exact, and the motion equals the
    command.

    Attributes:
      noise: standard deviation of the measured error, a number or (m,) [m, rad].
      drive: model of the drives, see `Drive`. It enters the loss and the constraints.
      draws: number of random scenarios of noise for each path.
      tolerance: error below which the tip has settled, for the loss "settling" [m, rad].
      seed: of noise.

    Raises: ArgumentError for values that do not fit.
    """

    noise: ArrayLike = 0.0
    drive: Drive = Drive()
    draws: int = 1
    tolerance: float = 1e-3
    seed: int = 0

    def __post_init__(self):
        if np.any(np.asarray(errors.array("noise", self.noise, (), (None,)), float) < 0):
            raise errors.fail("noise", "be at least 0", f"is {np.asarray(self.noise).tolist()}")
        errors.kind("drive", self.drive, Drive, "be Drive(...)")
        errors.integer("draws", self.draws, at_least=1)
        errors.number("tolerance", self.tolerance, positive=True)
        errors.seed(self.seed)


@record
class Scenario:
    """One run of a tuning: `reference`, `q0` and `noise` as for `solve`."""

    reference: Reference
    q0: Float[Array, " n"]
    noise: Float[AnyArray, "N m"] | None = None


def scenarios(law, reference, q0, N: int, conditions: Conditions) -> Scenario:
    """All runs over which a loss is the mean, stacked: each path with its start, drawn `draws` times.

    Args:
      reference: a path, or a list of B paths. q0: (n,) or (B, n) [rad, m].
      N: steps of each run.
    """
    references = list(reference) if isinstance(reference, (list, tuple)) else [reference]
    check_loop(law, *references)
    q0 = np.atleast_2d(np.asarray(errors.array("q0", q0, (law.chain.n,), (None, law.chain.n)), float))
    count = max(len(references), len(q0))
    if len(references) not in (1, count) or len(q0) not in (1, count):
        raise errors.fail("q0", f"hold one start, or one for each of {len(references)} paths", f"holds {len(q0)}")
    m = law.task.m
    sigma = np.broadcast_to(np.asarray(errors.array("noise", conditions.noise, (), (m,)), float), (m,))
    rng = np.random.default_rng(int(conditions.seed))

    def drawn(i):
        return Scenario(
            reference=references[i % len(references)],
            q0=as_joint_values(law.chain, q0[i % len(q0)]),
            noise=sigma * rng.standard_normal((N, m)) if np.any(sigma > 0) else None,
        )

    return stack(drawn(k // conditions.draws) for k in range(count * conditions.draws))


def rollout(loop: Adjustable, scenario: Scenario, N: int, method, stage, *, drive=Drive()) -> Trajectory:
    """Run the loop for N steps. Pure, for jit, vmap and grad.

    Args: N, method, stage, drive: as for `solve`.
    """
    run = loop.law, scenario.reference, scenario.q0, loop.Ts, N, method, stage
    return solve(*run, drive=drive, noise=scenario.noise)
