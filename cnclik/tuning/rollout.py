"""Rollout: one run that a tuning looks at, with what is measured and the gain as a schedule has it."""

from __future__ import annotations

from cnclik.integrate.drive import Drive
from cnclik.integrate.solve import simulate
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.reference import Reference
from cnclik.record import cast, record, replace
from cnclik.robot.chain import Chain
from cnclik.shapes import AnyArray, Array, Float, Int
from cnclik.tuning.parameters import Adjustable, scheduled


@record
class Scenario:
    """One run that a tuning looks at.

    Attributes:
      reference, q0: as for `solve`.
      noise, plant: as for `simulate`. seed: of the drive's joint noise.
    """

    reference: Reference
    q0: Float[Array, " n"]
    noise: Float[AnyArray, "N m"] | None = None
    plant: Chain | None = None
    seed: int | Int[AnyArray, ""] = 0


def rollout(loop: Adjustable, scenario: Scenario, N: int, method, stage, *, drive=Drive(), horizon=None) -> Trajectory:
    """Run the loop for N steps. Pure, for jit, vmap and grad.

    Args:
      loop, scenario: what runs, and under which conditions.
      N, method, stage: as for `solve`. drive: as for `simulate`.
      horizon: [s] over which a gain schedule is spread, N·Ts by default.
    """
    drive = drive if drive.exact else replace(drive, seed=scenario.seed)
    horizon = N * loop.Ts if horizon is None else horizon
    schedule = cast(loop.schedule, scenario.q0.dtype)

    def gained(law, t):
        return scheduled(replace(loop, law=law, schedule=schedule), t / horizon)

    asked = loop.law, scenario.reference, scenario.q0, loop.Ts, N, method, stage
    changes = {} if loop.schedule is None else {"gained": gained}
    return simulate(*asked, drive=drive, noise=scenario.noise, plant=scenario.plant, **changes)
