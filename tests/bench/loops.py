"""`python -m tests.bench.loops`: loops as they run in pink, mink and MuJoCo, against what cnclik says of them.

Largest gains of pink's and mink's own loops; in MuJoCo three arms with position and velocity servos, control at 100 to
500 Hz, 0 to 17 samples of delay: largest stable gain, fastest without overshoot and lag behind a ramp, measured, and as
models of growing detail predict them. What the advice is worth on four arms with friction, encoders and the like
(`--only advice`), and each line of settings for another tool in that tool (`--only tools`; Placo where it is there).
Into results/loops (20 minutes on one core); what is there already is kept unless --fresh, so a run that was stopped
goes on. Needs the extra `peers`.
"""

import argparse
import importlib.metadata
import importlib.util
import json
import pathlib
import sys
import time

import jax
import mujoco
import numpy as np

import cnclik as ck
from cnclik.record import replace
from tests.bench import document, loops_advice, loops_models, loops_mujoco, loops_page, loops_peers, loops_tools
from tests.bench.loops_arms import POSTURES, SERVOS, Arm
from tests.bench.loops_mujoco import SHIFT, Setup
from tests.oracles import late_by

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "loops"
RATES = (500, 200, 100)  # [Hz]
DELAYS = (0, 1, 2, 5)
LONG = {"UR5": (17,)}  # further delays of an arm
FIT_AT = (0, 1)  # samples of delay with which steps are recorded; longer ones are as the last
FINE = 1e-4  # of the physics [s], where its own step is looked at
PREDICTED = ("UR5", "Panda", "Kinova")  # of which the models' predictions are looked at
RAMP_DELAYS = np.array([0, 2, 5])


def scale(delays, Ts):
    """The largest gains of a loop with dead time alone, from which on is looked."""
    return 2 * np.sin(np.pi / (2 * (2 * delays + 1))) / Ts


def group(arm, inertia, servo, rate) -> list:
    """The cells of an arm, a servo and a rate."""
    setup = Setup(arm, SERVOS[servo], 1.0 / rate)
    delays = np.array(DELAYS + LONG.get(arm.name, ()))
    around = scale(delays, setup.Ts)
    largest, calm = loops_mujoco.limits(setup, delays, around)
    best = "lag" if setup.servo.command == "velocity" else "second order"
    own = loops_models.drives(setup, 0, inertia)[best]
    linear = {
        "drive": loops_models.of_drive(own, setup.Ts, arm.n),
        "equations": loops_models.of_equations(setup, inertia, stepped=True),
    }
    in_time = {
        name: loops_mujoco.limits(setup, delays, around, loops_models.linear_run(model))
        for name, model in linear.items()
    }
    cells, fits = [], fitted(setup, delays.tolist())
    for i, delay in enumerate(delays.tolist()):
        cell = {"robot": arm.name, "servo": servo, "rate": rate, "delay": delay}
        cell |= {"largest": float(largest[i]), "calm": float(calm[i])}
        cell["in_time"] = {name: [float(v[i]) for v in found] for name, found in in_time.items()}
        cell["fits"] = {name: {k: np.round(v, 6).tolist() for k, v in fit.items()} for name, fit in fits[delay].items()}
        cell["predicted"] = {
            name: loops_models.predicted(setup, drive)
            for name, drive in loops_models.drives(setup, delay, inertia, fits[delay]).items()
        }
        cells.append(cell)
    return cells


def fitted(setup, delays) -> dict:
    """{delay: {model: keyword arguments of a Drive}} from recorded steps."""
    made = {delay: {} for delay in delays}
    for name, together in (("fitted", False), ("together", True)):
        records = {at: loops_models.fitted(setup, at, together) for at in FIT_AT}
        for delay in delays:
            at = max(d for d in FIT_AT if d <= delay)
            made[delay][name] = records[at] | {"delay": records[at]["delay"] + delay - at}
    return made


def feedbacks(arm, inertia, servo, rate) -> list:
    """Largest gain and lag behind a ramp for each feedback, measured and as the joints' own drives predict them."""
    rows = []
    for feedback in ("measured", "commanded", "rebased"):
        setup = Setup(arm, SERVOS[servo], 1.0 / rate, feedback)
        if feedback == "rebased" and setup.servo.command == "velocity":
            continue  # is "measured"
        best = "lag" if setup.servo.command == "velocity" else "second order"
        top = scale(RAMP_DELAYS, setup.Ts) if feedback == "measured" else np.full(3, 2.0 / setup.Ts)
        top = top * 10 if feedback == "rebased" else top  # their step goes to a servo that has hardly moved
        largest, _ = loops_mujoco.limits(setup, RAMP_DELAYS, top, calm=False)
        own = loops_models.drives(setup, 0, inertia)[best]
        gains = np.where(np.isfinite(largest) & (largest > 0), 0.3 * largest, 0.3 * top)
        gains = gains if feedback == "rebased" else np.minimum(gains, 20.0)
        linear = loops_models.linear_run(loops_models.of_drive(own, setup.Ts, arm.n))
        lags = loops_mujoco.ramp_lag(setup, gains, RAMP_DELAYS)
        told = loops_mujoco.ramp_lag(setup, gains, RAMP_DELAYS, linear)
        for i, delay in enumerate(RAMP_DELAYS.tolist()):
            drive = loops_models.drives(setup, delay, inertia)[best]
            row = {"robot": arm.name, "servo": servo, "rate": rate, "delay": delay, "feedback": feedback}
            row |= {"largest": float(largest[i]), "predicted": loops_models.predicted(setup, drive)[0]}
            row |= {"alpha": float(gains[i]), "lag": float(lags[i]), "lag_predicted": float(told[i])}
            rows.append(row | {"late": float(np.max(late_by(drive, setup.Ts)))})
    return rows


def fine(arm, inertia) -> list:
    """Velocity servos where MuJoCo's own steps are shorter: is it these that a continuous drive leaves out?"""
    rows, delays = [], np.array([0, 1, 2])
    for servo in ("velocity, kv 400", "velocity, kv 40"):
        setup = Setup(arm, SERVOS[servo], 0.002, step=FINE)
        largest, _ = loops_mujoco.limits(setup, delays, scale(delays, setup.Ts), calm=False)
        for i, delay in enumerate(delays.tolist()):
            made = loops_models.drives(setup, delay, inertia)
            row = {"robot": arm.name, "servo": servo, "delay": delay, "largest": float(largest[i])}
            rows.append(row | {name: loops_models.predicted(setup, made[name])[0] for name in ("lag", "modes")})
    return rows


def checks(arm, inertia) -> list:
    """cnclik's own loop in time, on both sides of the largest gain."""
    rows = []
    for servo in ("position", "velocity, kv 400"):
        setup = Setup(arm, SERVOS[servo], 0.002)
        for name, drive in loops_models.drives(setup, 2, inertia).items():
            if name in ("lag", "second order"):
                largest, row = (
                    loops_models.predicted(setup, drive)[0],
                    {"robot": arm.name, "servo": servo, "model": name},
                )
                rows.append(row | {"around": [around(setup, drive, share * largest) for share in (0.95, 1.05)]})
    return rows


def around(setup, drive, alpha) -> float:
    """Growth of the error in cnclik's own loop through the drive."""
    arm = setup.arm
    at = ck.forward(arm.chain, arm.q)
    law = replace(arm.law, alpha=alpha)
    path = ck.hold(np.asarray(at.position) + SHIFT[:3], loops_mujoco.rotation_of(SHIFT[3:]) @ np.asarray(at.rotation))
    made = ck.solve(law, path, arm.q, setup.Ts, 8000, "EE", ck.picard(5), drive=drive)
    return float(loops_mujoco.growth(np.asarray(made.e)[:, None])[0])


def save(found, folder) -> None:
    """The data, whole or not at all."""
    kept = folder / "loops.json.part"
    kept.write_text(loops_page.text(found), encoding="utf-8")
    kept.replace(folder / "loops.json")


def parts(names):
    """(name of a part, what measures it)."""
    yield "peers", loops_peers.measure
    yield "tools", loops_tools.measure
    if importlib.util.find_spec("placo"):  # brings a Pinocchio of its own: an environment of its own
        yield "Placo, tools", lambda: loops_tools.measure(("Placo",))
    for name in names:
        arm = Arm(name)
        cells = [cell for cell in loops_advice.cells(POSTURES) if cell[0] == name]
        yield f"{name}, advice", lambda a=arm, c=cells: [loops_advice.measure(a, *one[1:]) for one in c]
        if name in loops_advice.REBASED:
            yield f"{name}, rebased", lambda a=arm: loops_advice.rebased(a)
        if name not in PREDICTED:
            continue
        inertia = arm.inertia()
        for servo in SERVOS:
            for rate in RATES:
                yield f"{name}, {servo}, {rate} Hz", lambda a=arm, m=inertia, s=servo, r=rate: group(a, m, s, r)
        for servo in SERVOS:
            yield f"{name}, {servo}, feedback", lambda a=arm, m=inertia, s=servo: feedbacks(a, m, s, 100)
        if arm.n == 6:
            yield f"{name}, fine", lambda a=arm, m=inertia: fine(a, m)
            yield f"{name}, checks", lambda a=arm, m=inertia: checks(a, m)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.loops", description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="*", choices=list(POSTURES), default=list(POSTURES))
    parser.add_argument("--fresh", action="store_true", help="measure again what is there already")
    parser.add_argument("--only", default="", help="parts whose names end so, such as advice or tools")
    parser.add_argument("--page", action="store_true", help="only write the page again")
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    args.out.mkdir(parents=True, exist_ok=True)
    there = args.out / "loops.json"
    found = json.loads(there.read_text()) if there.exists() and not args.fresh else {}
    for name, measure in () if args.page else parts(args.robots):
        if name in found or not name.endswith(args.only):
            continue
        begun = time.process_time()
        rows = measure()
        found[name] = {"seconds": round(time.process_time() - begun, 1), "rows": rows}
        found["machine"] = document.machine() | {"mujoco": mujoco.__version__}
        found["machine"] |= {name: importlib.metadata.version(name) for name in ("mink", "pin-pink", "pin")}
        print(f"{name}: {found[name]['seconds']} s", file=sys.stderr, flush=True)
        save(found, args.out)
    loops_page.write(found, args.out)


if __name__ == "__main__":
    main()
