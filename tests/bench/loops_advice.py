"""Part of `tests.bench.loops`: what the advice is worth on robots that have more than the models know of.

Four arms, eight kinds of servos, 100 to 1000 Hz, 0 to 8 samples of delay; friction, encoders, limits of torque and
commands that are not followed to the full; measured, commanded and rebased feedback. Each cell records a step of all
joints, fits the drive, and runs the gain that the fit names: from the fit, and with nothing said of the drives.
Where no gain is named the cell looks for one that would have been stable and without overshoot.
"""

import numpy as np

from cnclik.diagnosis.fit import NOT_REBASED, fit_drive
from cnclik.errors import ArgumentError
from cnclik.record import replace
from cnclik.stability.gain import gains
from tests.bench.loops_mujoco import SHIFT, Servo, Setup, World, growth, run, step_response

SERVOS = {
    "position 5": Servo("position", (2000.0, 500.0), (400.0, 100.0)),  # k_p/k_v, as the UR5e of the MuJoCo menagerie
    "position 10": Servo("position", (4500.0, 2000.0), (450.0, 200.0)),  # as its Panda
    "position 50": Servo("position", (20000.0, 5000.0), (400.0, 100.0)),
    "position ζ 0.4": Servo("position", (2000.0, 500.0), (62.0, 7.0)),  # on 3 and 0.15 kg m²
    "velocity 400": Servo("velocity", (0.0, 0.0), (400.0, 400.0)),
    "velocity 40": Servo("velocity", (0.0, 0.0), (40.0, 40.0)),
    "velocity 100 PI": Servo("velocity", (0.0, 0.0), (100.0, 20.0), 10.0),
    "velocity 40 PI": Servo("velocity", (0.0, 0.0), (40.0, 10.0), 5.0),
}
WORLDS = {
    "": World(),
    "friction": World(dry=(1.0, 0.2), viscous=(3.0, 0.3)),
    "encoder": World(resolution=2 * np.pi / 2**15),
    "torque": World(effort=(80.0, 15.0)),
    "gain 0.95": World(gain=0.95),
    "gain 1.08": World(gain=1.08),
    "all": World((1.0, 0.2), (3.0, 0.3), (100.0, 20.0), 2 * np.pi / 2**15, 0.97),
}
FEEDBACKS = ("measured", "measured", "commanded", "measured", "measured", "rebased", "measured")
RATES, DELAYS = (100, 250, 500, 1000), (0, 1, 3, 5, 8)
EACH = 15  # cells of an arm
STEP = 60 * SHIFT  # of the target: 3 cm and 60 mrad
STEPPED = {"position": 0.03, "velocity": 0.2}  # [rad, rad/s] of the recorded step
LEAD = 10  # rows before it
RECORDED, ROWS = 1.2, 200  # [s] of a record, and its rows at most
SECONDS, LONG = 3.0, 8.0  # of a run, and of one without a recommended gain
CALM, MUCH, LEFT = 0.01, 0.05, 0.02  # overshoot that is none, that is too much; share of an error that is no swing
GRID = np.geomspace(0.4, 6.0, 9)  # times the recommended gain: where the best one is looked for
ANY = np.geomspace(0.02, 1.0, 10)  # alpha·Ts that are run where no gain is named


def cells(robots):
    """(robot, servo, rate, delay, world, feedback): each combination of a robot's differs from the others'."""
    for r, robot in enumerate(robots):
        for i in range(EACH):
            servo, world = list(SERVOS)[i % len(SERVOS)], list(WORLDS)[(3 * i + r) % len(WORLDS)]
            feedback = FEEDBACKS[(i + 3 * r + i // len(SERVOS)) % len(FEEDBACKS)]
            if feedback == "rebased" and SERVOS[servo].command == "velocity":
                feedback = "measured"  # is the same
            if feedback == "commanded" and WORLDS[world].gain != 1:
                feedback = "measured"  # no gain of a loop that does not see it changes where its robot ends
            yield robot, servo, RATES[(i + r + i // 8) % 4], DELAYS[(2 * i + r) % 5], world, feedback


def recorded(setup, delay):
    """Commands and motions (N, n) of a step of all joints at once, as a robot's log would have them."""
    N = int(min(RECORDED / setup.Ts, ROWS))
    size = STEPPED[setup.servo.command]
    motions = step_response(setup, size, N)
    if resolution := setup.world.resolution:
        q = motions + setup.arm.q
        motions = np.round(q / resolution) * resolution - setup.arm.q
    rest = np.zeros((LEAD + delay, setup.arm.n)) + motions[0]
    command = np.zeros((LEAD + N, setup.arm.n))
    command[LEAD:] = size
    return command, np.concatenate([rest, motions])[: LEAD + N]


def beyond(e) -> np.ndarray:
    """How far position or orientation went beyond the target (B,), as shares of the step; inf where it was given up."""
    parts = []
    for part in (slice(0, 3), slice(3, 6)):
        first = e[0, 0, part]
        parts.append(np.nanmax(-e[..., part] @ first / (first @ first), axis=0))
    return np.where(np.isfinite(e[-1, :, 0]), np.max(parts, axis=0), np.inf)


def unstable(e) -> np.ndarray:
    """Whether the error grows in the end (B,), and is more than what friction and encoders leave."""
    size = np.linalg.norm(e * np.repeat([1.0, 0.5], 3), axis=-1)
    last = size[-(len(size) // 6) :].max(0)
    return ~np.isfinite(last) | ((growth(e) > 0) & (last > LEFT * size[0]))


def arrives(e) -> np.ndarray:
    """Whether less than LEFT of the error is left in the end (B,)."""
    size = np.linalg.norm(e * np.repeat([1.0, 0.5], 3), axis=-1)
    return size[-(len(size) // 6) :].max(0) < LEFT * size[0]


def best(alphas, over) -> float:
    """The largest gain (on a line between two that were run) up to which nothing went beyond by more than CALM."""
    first = int(np.argmax(over > CALM)) if (over > CALM).any() else len(alphas)
    if first in (0, len(alphas)):
        return float(alphas[max(first - 1, 0)]) * (1.0 if first else np.nan)
    low, high = over[first - 1 : first + 1]
    share = np.clip((CALM - low) / (high - low), 0, 1) if np.isfinite(high) else 0.5
    return float(alphas[first - 1] * (alphas[first] / alphas[first - 1]) ** share)


def advised(fit, Ts, feedback) -> tuple:
    """(the gain that a fit recommends for a feedback, 0 if none; why there is none)."""
    if feedback == "measured":
        return fit.recommended_alpha or 0.0, fit.note
    if feedback == "rebased" and NOT_REBASED in fit.note:
        return 0.0, NOT_REBASED
    drive = fit.drive if feedback == "rebased" and not fit.drive.order else replace(fit.drive, feedback=feedback)
    found = gains(Ts=Ts, method="EE", drive=drive)
    return found.recommended / max(1.0, float(np.max(fit.gain))), found.reason


def measure(arm, servo, rate, delay, world, feedback) -> dict:
    """One cell."""
    Ts = 1.0 / rate
    setup = Setup(arm, SERVOS[servo], Ts, feedback, min(Ts, 2e-3 if rate <= 250 else 1e-3), WORLDS[world])
    row = dict(robot=arm.name, servo=servo, rate=rate, delay=delay, world=world, feedback=feedback)
    try:
        fit = fit_drive(None, *recorded(setup, delay), Ts, command_kind=setup.servo.command)
    except ArgumentError as refused:
        return row | {"not fitted": str(refused)}
    row["fit"] = {"options": fit.options, "explained": float(fit.explained), "note": fit.note}
    named, why = advised(fit, Ts, feedback)
    alphas = {"recommended": named}
    if feedback != "rebased":  # where position commands begin at the measured joints, settings name none
        alphas["unknown"] = gains(Ts=Ts, method="EE").recommended
    alphas = {name: alpha for name, alpha in alphas.items() if alpha}
    around = alphas["recommended"] * GRID if "recommended" in alphas else ANY / Ts
    lanes = np.concatenate([list(alphas.values()), around])
    N = int((SECONDS if "recommended" in alphas else LONG) / Ts)
    made = run(setup, lanes, delay, N, STEP)
    over, grows = beyond(made), unstable(made)
    for i, (name, alpha) in enumerate(alphas.items()):
        row[name] = {"alpha": float(alpha), "over": float(over[i]), "unstable": bool(grows[i])}
    over, grows = over[len(alphas) :], grows[len(alphas) :]
    if "recommended" not in alphas:
        calm = (over <= CALM) & ~grows & arrives(made)[len(alphas) :]
        return row | {"none named": why, "calm": around[calm].tolist()}
    row["best"] = best(around, over)
    return row


def figures(rows) -> dict:
    """The numbers that count: {name: value}."""
    told = {name: [r for r in rows if name in r] for name in ("recommended", "unknown", "none named")}

    def count(name, what):
        return sum(bool(what(r[name])) for r in told[name])

    best = [(r["recommended"]["alpha"], r["best"]) for r in told["recommended"]]
    return {
        "cells": len(rows),
        **{f"{name} named": len(told[name]) for name in ("recommended", "unknown")},
        **{f"{name} unstable": count(name, lambda v: v["unstable"]) for name in ("recommended", "unknown")},
        **{f"{name} over 5 %": count(name, lambda v: _over(v) > MUCH) for name in ("recommended", "unknown")},
        "median of best": float(np.median([alpha / most for alpha, most in best if most and np.isfinite(most)])),
        "calm where none is named": sum(bool(r["calm"]) for r in told["none named"]),
    }


def _over(lane) -> float:
    return np.inf if lane["over"] is None else lane["over"]
