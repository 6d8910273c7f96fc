"""`python -m tests.bench.peers_gain`: the gain 1 − exp(−alpha·dt) in pink and mink, whose own gain is a share per step.

A UR5 that stands 1 mm and 2 mrad beside its target is held by each library's own loop. With the exponential share the
error has fallen to e^{−alpha·t} at every dt, as the law says; with the share alpha·dt that the first order suggests it
falls faster the larger dt is, is dead-beat at alpha·dt = 1, and is refused (mink) or overshoots (pink) beyond. Tables
in Markdown; AssertionError where the exponential one is off by more than 1 % or overshoots. Needs the extra `peers`.
"""

import math

import mink
import numpy as np

from cnclik.measure.files import markdown
from tests.bench.loops_mujoco import Arm
from tests.bench.loops_peers import LOOPS, held

TIME = 0.5  # of a run [s]
STEPS = (0.1, 0.05, 0.02, 0.01, 0.002)
GAINS = (5.0, 15.0, 25.0, 50.0)
TOLERANCE = 0.01
SHARES = {"1 − exp(−alpha·dt)": lambda alpha, dt: -math.expm1(-alpha * dt), "alpha·dt": lambda alpha, dt: alpha * dt}


def ran(library, share, alpha, dt) -> tuple:
    """(‖e‖ in the end over ‖e₀‖ e^{−alpha·t}, overshoot −e·e₀/‖e₀‖²) of a run; NaN where the gain is refused."""
    arm, gain = Arm("UR5"), SHARES[share](alpha, dt)
    if library == "mink":
        try:
            mink.FrameTask(arm.tip, "body", position_cost=1.0, orientation_cost=1.0, gain=gain)
        except mink.InvalidGain:
            return math.nan, math.nan
    e, _ = held(LOOPS[library](arm, dt), arm.q, gain, 0, round(TIME / dt) + 1)
    size = np.linalg.norm(e, axis=1)
    return size[-1] / size[0] / math.exp(-alpha * TIME), max(0.0, -float(np.min(e @ e[0]) / size[0] ** 2))


def main():
    cases = [(library, share) for library in LOOPS for share in SHARES]
    print(f"‖e(t)‖ after {TIME:g} s over ‖e₀‖ e^{{−alpha·t}}, alpha = 5 1/s: 1 is what the law says\n")
    ratios = {case: [ran(*case, 5.0, dt)[0] for dt in STEPS] for case in cases}
    rows = [[*case, *(f"{ratio:.3f}" for ratio in each)] for case, each in ratios.items()]
    print(markdown(["", "gain", *(f"dt = {dt:g} s" for dt in STEPS)], rows, left=2))
    print("Overshoot (how far beyond the target, as a share of e₀), dt = 0.1 s\n")
    beyond = {case: [ran(*case, alpha, 0.1)[1] for alpha in GAINS] for case in cases}
    words = lambda b: "refused" if math.isnan(b) else f"{b:.3g}" if b > 1e-3 else "none"  # noqa: E731
    rows = [[*case, *map(words, each)] for case, each in beyond.items()]
    print(markdown(["", "gain", *(f"alpha = {alpha:g} 1/s" for alpha in GAINS)], rows, left=2))
    for library, share in cases:
        if share.startswith("1"):
            assert max(abs(r - 1.0) for r in ratios[library, share]) < TOLERANCE > max(beyond[library, share])


if __name__ == "__main__":
    main()
