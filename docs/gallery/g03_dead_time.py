"""
How far does dead time lower it?
================================

Two closed forms give the limits of a loop with d samples of dead time. It is stable below 2 sin(π/(2(2d + 1))), and
does not overshoot up to dᵈ/(d + 1)ᵈ⁺¹. An exponential step has a limit only from two samples on.
"""

import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, SKY, VERMILION

d = np.arange(13)
stable, exponential = (
    [ck.gains(Ts=1.0, drive=ck.Drive(delay=int(k)), method=method).largest_stable for k in d]
    for method in ("EE", "EXP-EE")
)
quiet = d**d / (d + 1.0) ** (d + 1)

figure, panel = plt.subplots(figsize=(6, 2.9))
panel.plot(d, stable, "s-", color=VERMILION, label="EE, largest stable")
panel.plot(d, exponential, "P-", color=SKY, label="EXP-EE, largest stable")
panel.plot(d, quiet, "o-", color=BLUE, label="EE, no overshoot")
panel.plot(d[:-1], quiet[1:], "o", color=BLUE, mfc="white", label="recommended: one sample to spare")
panel.set(xlabel="dead time [samples]", ylabel="z = alpha·Ts", yscale="log")
panel.legend()
