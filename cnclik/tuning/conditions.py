"""Conditions: under what a loop is judged: noise, drives, a wrong model, and how many draws of them."""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.law.law import check_loop
from cnclik.record import record, stack
from cnclik.robot.kinematics import as_joint_values
from cnclik.shapes import ArrayLike
from cnclik.tuning.parameters import scaled_links
from cnclik.tuning.rollout import Scenario


@record
class Conditions:
    """What a robot adds to a loop. As they are, none: the measured error is the true one, motion what was commanded.

    Attributes:
      noise: standard deviation of the measured error, a number or (m,) [m, rad].
      drive: what lies between command and motion, see `Drive`. It counts in the loss and in the constraints.
      model_error: relative error of the link lengths the law believes in.
      draws: scenarios drawn of noise and model error for each path.
      tolerance: what counts as arrived, for the loss "settling" [m, rad].
      seed: of noise and model error; joint noise has that of the drive.

    Raises: ArgumentError for values that do not fit.
    """

    noise: ArrayLike = 0.0
    drive: Drive = Drive()
    model_error: float = 0.0
    draws: int = 1
    tolerance: float = 1e-3
    seed: int = 0

    def __post_init__(self):
        if np.any(np.asarray(errors.array("noise", self.noise, (), (None,)), float) < 0):
            raise errors.fail("noise", "be at least 0", f"is {np.asarray(self.noise).tolist()}")
        errors.kind("drive", self.drive, Drive, "be Drive(...)")
        errors.number("model_error", self.model_error, at_least=0)
        errors.integer("draws", self.draws, at_least=1)
        errors.number("tolerance", self.tolerance, positive=True)
        errors.seed(self.seed)


def scenarios(law, reference, q0, N: int, conditions: Conditions) -> Scenario:
    """All runs that a loss is the mean of, stacked: each path with its start, drawn `draws` times.

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

    def drawn(i, seed):
        return Scenario(
            reference=references[i % len(references)],
            q0=as_joint_values(law.chain, q0[i % len(q0)]),
            noise=sigma * rng.standard_normal((N, m)) if np.any(sigma > 0) else None,
            plant=_perturbed(law.chain, conditions.model_error, rng) if conditions.model_error > 0 else None,
            seed=int(seed),
        )

    seeds = np.random.default_rng(int(conditions.drive.seed)).integers(1 << 30, size=count * conditions.draws)
    seeds[0] = conditions.drive.seed  # a single run is that of `solve` with this drive
    return stack(drawn(k // conditions.draws, seed) for k, seed in enumerate(seeds))


def _perturbed(chain, relative, rng):
    """The chain with every link's offset longer or shorter by a normal error of the given relative size."""
    factors = 1.0 + relative * rng.standard_normal(len(chain.joints) + 1)
    return scaled_links(chain, [float(f) for f in factors])
