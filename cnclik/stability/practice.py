"""Practice: what an engineer would set on a robot: gains with their reason, what they cost, and the same elsewhere."""

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import DEFAULT, EE, named
from cnclik.integrate.stage import picard
from cnclik.precision import in_float64
from cnclik.record import record
from cnclik.stability.driven import delay_margin, driven_limits, noise_gain, overshoot, own_drives, respond, settling
from cnclik.stability.linear import share_per_step
from cnclik.stability.recommend import Advice, advise, loop_at_rest

SPEED = 0.1  # [m/s] of the tip, where none is given
MOST_GAIN_MARGIN = 1e6  # beyond it there is none to speak of


@record
class Gain:
    """What one gain does in a loop; linear, at rest.

    Attributes:
      alpha: [1/s]; z: alpha·Ts.
      overshoot: of a step, as a share of it. settling_time: until within 2 % of a step [s].
      gain_margin: factor by which alpha may still grow. delay_margin: further dead time that the loop bears [samples].
      noise_gain: standard deviation of the motion per unit of white noise of what is measured; velocity_noise_gain:
        that of the commanded velocity [1/s].
      lag: how far behind a target at constant speed the motion is without feed-forward [s].
      tracking_error: the largest error after the target starts at the speed, with the velocity fed forward [m].
    """

    alpha: float
    z: float
    overshoot: float
    settling_time: float
    gain_margin: float
    delay_margin: float
    noise_gain: float
    velocity_noise_gain: float
    lag: float
    tracking_error: float


@record
class Practice:
    """What to set on a robot. Gains are inf where any is.

    Attributes:
      largest_stable_alpha, fastest_monotone_alpha, recommended_alpha: [1/s] of the loop's method: the largest that is
        stable, that has no overshoot, and that would have none if the dead time were longer by a sample.
      reason: why that one, in words.
      now, recommended: `Gain` as the law has it, and as recommended.
      explicit_euler: {"largest_stable_alpha", "fastest_monotone_alpha", "recommended_alpha"} of the step that other
        libraries take.
      recommended_method: by name. speed: of the tip [m/s], for the errors.
      joint_speed: largest share of a joint's velocity limit that this speed takes, in the worst direction; NaN where
        there is no limit.
      settings: {where: settings in words} for other libraries and controllers.
      advice: `Advice`, on which this rests.
    """

    largest_stable_alpha: float
    fastest_monotone_alpha: float
    recommended_alpha: float
    reason: str
    now: Gain
    recommended: Gain
    explicit_euler: dict
    recommended_method: str
    speed: float
    joint_speed: float
    settings: dict
    advice: Advice


@in_float64
def practice(
    law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), drive: Drive = Drive(), speed: float = SPEED
) -> Practice:
    """What to set on a robot: gains, what they cost, and the same for other libraries. In float64.

    Args:
      law, reference, q: the loop at rest, as for `recommend`. Ts: sampling time [s]. method, stage: as for `solve`.
      drive: what lies between command and motion.
      speed: of the tip [m/s], for tracking errors and joint velocities.
    """
    errors.number("speed", speed, at_least=0)
    Ts, speed = float(errors.number("Ts", Ts, positive=True)), float(speed)
    loop = loop_at_rest(law, reference, q, method, stage, drive)
    advice = advise(law, reference, q, Ts=Ts, method=method, stage=stage, drive=drive)
    gains = advice.gains

    def seen(z):
        """What a gain of z does."""
        alpha, steps = z / Ts, loop.modes(np.array([z]), Ts)[0][0]
        share = gains.z_largest / z
        if own_drives(drive):
            steps = _alike(steps)
        return Gain(
            alpha=alpha,
            z=z,
            overshoot=max(overshoot(steps, drive, Ts), 0.0),
            settling_time=settling(steps, drive, Ts),
            gain_margin=share if share < MOST_GAIN_MARGIN else np.inf,
            delay_margin=delay_margin(steps, _worst(drive), Ts),
            **dict(zip(("noise_gain", "velocity_noise_gain"), noise_gain(steps, _worst(drive), Ts), strict=True)),
            **_tracking(steps, _worst(drive), Ts, speed),
        )

    return seen
