"""Settings of the same loop in other libraries, each with the feedback, posture gain and lag that it has there.

Run in pink, mink and Placo, and in copies of the loops of Isaac Lab, MoveIt Servo and servoj: results/loops.
"""

import numpy as np

from cnclik.integrate.drive import MOST, Drive
from cnclik.law.walls import names_of
from cnclik.record import replace
from cnclik.stability.driven import settling
from cnclik.stability.drives import SPARE
from cnclik.stability.rebased import WHERE, runs_away

OWN_COMMANDS = 0.25  # alpha·Ts of a loop that looks at its own commands: d^d/(d + 1)^(d + 1) for d = 1
LOOKAHEAD = 0.03  # [s], the least that a UR's servoj takes: a lag of its own
# Of an arm of which nothing is known: 34 ms of dead time were measured of a UR, 30 ms of others; the position servos of
# the MuJoCo menagerie lag by k_v/k_p = 0.1 s, some by 0.2 s. Measured so: results/loops.
ASSUMED_DELAY, ASSUMED_LAG = 0.03, 0.1  # [s]
REBASED = "servos with ζ below 0.71 and dead time may oscillate or run away, and a smaller gain does not help"
BEGINS = "each position target starts at the measured joints"
KNOWN = (
    "Record a step of all joints that are sent positions, and ask again with the natural frequency, damping ratio and "
    "dead time that `cnclik diagnose LOG.csv --step` prints"
)
MOST_Z = 1.0  # a recommended gain removes no more than 63 % of an error per step, or all of it by explicit Euler


def settings(borne, drive, safe: Drive, Ts: float) -> dict:
    """The same loop by explicit Euler elsewhere: {where: what to set there}; what has no gain there is left out, or
    is a sentence with the reason.

    Args:
      borne: borne(drive), the recommended z of explicit Euler through a drive. drive: as it was given, or None. safe:
        the one that is assumed then.
    """

    # Position commands that begin at the measured joints; a drive that follows at once takes any z.
    again = replace(safe, command="position", feedback="rebased") if safe.order else None
    drives = (replace(safe, feedback="measured"), again, _of_servoj(drive, Ts))
    measured, rebased, servoj = (MOST_Z if one is None else borne(one) for one in drives)
    last = f"{OWN_COMMANDS:g} where it is the last command"
    made = {}
    if measured:
        z = f"{measured:.4g}"
        qp = f"FrameTask(gain={z}), the same gain for PostureTask (1 if left out), dt={Ts:g}, where the configuration"
        made |= {name: f"{qp} is measured; {last}" for name in ("pink", "mink")}
        made["Placo"] = (
            f"each solve removes the whole error, so give tasks a target at {z} of the way from the measured state "
            f"(placo.interpolate_frames(T_now, T_target, {z}), joints likewise); {last}"
        )
    of_velocities = ""
    if drive is not None and drive.order and drive.command == "velocity":
        of_velocities = f"the drive that you gave is a velocity servo. {KNOWN}"
    if of_velocities:
        made["Isaac Lab"] = f"no k_val can be given: {BEGINS}, and {of_velocities}"
    elif drive is None or (drive.order == 0 and not drive.prompt):
        made["Isaac Lab"] = f"no k_val can be given: {BEGINS}, and {REBASED}. {KNOWN}"
    elif again is not None and drive.order and runs_away(again, Ts):
        made["Isaac Lab"] = f"no k_val is safe: {BEGINS}, and this servo may then oscillate or run away. {WHERE}"
    elif rebased:
        made["Isaac Lab"] = (
            f'DifferentialIKControllerCfg(ik_method="pinv", ik_params={{"k_val": {rebased:.4g}}}): '
            f"{BEGINS}{_settles(again, rebased, Ts)}; {REBASED}"
        )
    if measured:
        made["MoveIt Servo"] = (
            f"publish_period: {Ts:g}; publish_joint_velocities: true, publish_joint_positions: false (positions would "
            "start at the measured joints: another loop); pose tracking: x, y, z and angular_proportional_gain: "
            f"{measured / Ts:.4g}"
        )
    if of_velocities:
        made["UR servoj"] = f"no alpha can be given: servoj takes positions, and {of_velocities}"
    elif servoj:
        made["UR servoj"] = (
            f"alpha = {servoj / Ts:.4g} 1/s, with error and J at the measured joints; q_cmd += qdot*{Ts:g}, from the "
            f"last q_cmd and not the measured joints; servoj(q_cmd, t={Ts:g}, lookahead_time={LOOKAHEAD:g}), whose lag "
            "is accounted for"
        )
    return made


def around_formula(law, Ts: float) -> str:
    """What a law does to q̇ = J#(ẋ_d + K e) + (I − J#J) q̇₀, such as "joint limits (rate·Ts = 0.1), walls a and b";
    "" where it does nothing."""
    rate, walls = getattr(law.limits, "rate", None), names_of(getattr(law.limits, "walls", ()))
    said = [f"joint limits{'' if rate is None else f' (rate·Ts = {float(rate) * Ts:.4g})'}"] * (law.limits is not None)
    said += [f"wall{'s' * (len(walls) > 1)} {' and '.join(walls)}"] * bool(walls)
    return ", ".join([*said, *["error clamp"] * (law.error_clamp is not None)])


def _of_servoj(drive, Ts) -> Drive:
    """A UR's: dead time and the lag of LOOKAHEAD; what lags already has dead time more in its place."""
    if drive is None:
        return Drive(delay=min(ASSUMED_DELAY / Ts, MOST - SPARE), lag=LOOKAHEAD, command="position")
    own = replace(drive, feedback="measured", command="position")
    if drive.order == 0:
        return replace(own, lag=LOOKAHEAD)
    return replace(own, delay=min(drive.delay + LOOKAHEAD / Ts, MOST - SPARE - drive.measurement_delay))


def _settles(drive, z, Ts) -> str:
    if drive is None or any(np.ndim(v) for v in (drive.lag, drive.natural_frequency, drive.damping_ratio)):
        return ""
    return f", so that a step settles to 2 % in {settling(np.array([[-z]]), drive, Ts):.3g} s"
