"""`python -m tests.bench.tuned`: gains that `tune` finds for arms with drives, and how their steps answer.

Into results/tuning: robots.md (a table), robots.png (the step of each through its drive, of the worst axis).
"""

import pathlib

import matplotlib.pyplot as plt
import numpy as np

from cnclik.integrate.drive import Drive
from cnclik.measure.files import markdown
from cnclik.problem.build import problem_from
from cnclik.show import style
from cnclik.show.output import draw
from cnclik.tuning import Conditions, end_responses, tune

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "tuning"
SERVO = dict(natural_frequency=23.25, damping_ratio=2.325, command="position")  # k_p 2000, k_v 400 on 3.7 kg m²
CASES = {
    "UR5, 500 Hz, 17 samples": ("ur5", 0.002, Drive(delay=17)),
    "UR5, 100 Hz, 3 samples, lag 20 ms": ("ur5", 0.01, Drive(delay=3, lag=0.02)),
    "UR5, 100 Hz, position servos": ("ur5", 0.01, Drive(**SERVO)),
    "Panda, 1 kHz, 5 samples": ("panda", 0.001, Drive(delay=5)),
    "Panda, 100 Hz, drives at once": ("panda", 0.01, Drive()),
}
HEADER = (
    "loop",
    "α [1/s]",
    "z",
    "RMS error before",
    "after",
    "overshoot",
    "settled to 2 % [ms]",
    "further dead time [samples]",
    "noise gain",
)


def main():
    rows, steps = [], {}
    for name, (robot, Ts, drive) in CASES.items():
        made = problem_from(
            robot, reference="circle", radius=0.1, period=4.0, Ts=Ts, N=int(2 / Ts), method="EE", alpha=2.0
        )
        found = tune(
            made.law, made.reference, made.q0, Ts=Ts, N=made.N, method=made.method, conditions=Conditions(drive=drive)
        )
        step = end_responses(found).sel(test="step")
        axis = int(np.argmax(step.response.max("time").values))
        steps[name] = 1e3 * step.time.values, step.response.values[axis]
        outside = np.abs(step.response.values - 1) > 0.02
        settled = 1e3 * step.time.values[np.flatnonzero(outside.any(0))[-1] + 1] if not outside[:, -1].any() else np.nan
        after, beyond = found.after, 100 * max(float(step.response.max()) - 1, 0)
        rows.append((
            name, f"{float(found.law.alpha):.4g}", f"{after.z:.3g}", f"{found.before.loss:.2e}", f"{after.loss:.2e}",
            f"{beyond:.2g} %", f"{settled:.0f}" if np.isfinite(settled) else "–",
            "any" if np.isinf(after.delay_margin) else f"{after.delay_margin:.3g}", f"{after.noise_gain:.3g}",
        ))  # fmt: skip
        print(*rows[-1], sep=" | ", flush=True)
        assert found.satisfied, found.why
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / "robots.md").write_text(markdown(HEADER, rows), encoding="utf-8")
    draw({"robots.png": (lambda: figure(steps), {"Title": "steps of tuned loops"})}, RESULTS)


def figure(steps):
    """Step responses over time, logarithmic: loops of 1 kHz and of a slow servo in one picture."""
    drawn, panel = plt.subplots(figsize=(style.COLUMN, 2.6))
    for i, (name, (time, response)) in enumerate(steps.items()):
        panel.semilogx(time[1:], response[1:], color=style.COLORS[i], linestyle=style.DASHES[i], label=name)
    panel.axhline(1.0, color="0.6", linewidth=0.6)
    panel.set(xlabel="time after a step of the target [ms]", ylabel="motion, of the step", ylim=(-0.05, 1.2))
    panel.legend(fontsize=6, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return drawn


if __name__ == "__main__":
    main()
