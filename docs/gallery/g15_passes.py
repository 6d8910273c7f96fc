"""
Do implicit steps allow any gain?
=================================

Implicit Euler (IE) allows any gain if its equation is solved. The paper's Crank-Nicolson (CN) even then allows only
z up to 3.24. With the fixed-point passes of the paper, neither does: each pass multiplies an error of the slope by −z,
and with five passes the limit is below that of explicit Euler. `chord` solves the equation at any z. Loops are stable
below the dotted line.
"""

import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik import stability
from cnclik.show.style import COLORS, DASHES, GUIDE, legend

z = np.linspace(0.0, 4.0, 400)
figure, panels = plt.subplots(1, 2, figsize=(7, 2.9), sharey=True)
for panel, name in zip(panels, ("IE", "CN"), strict=True):
    stages = {
        "picard(2)": ck.picard(2),
        "picard(5)": ck.picard(5),
        "picard(10)": ck.picard(10),
        "chord(2)": ck.chord(2),
    }
    for (label, stage), color, dash in zip(stages.items(), COLORS, DASHES, strict=False):
        panel.plot(z, np.abs(stability.amplification(name, z, stage)), color=color, ls=dash, label=label)
    panel.plot(z, np.abs(1 - z), color="0.6", lw=0.8, label="explicit Euler")
    panel.axhline(1, **GUIDE)
    panel.set(title=name, xlabel="z = alpha·Ts", ylim=(0, 2))
panels[0].set_ylabel("|R(z)|: what a step keeps")
legend(panels[0].figure, panels[0])
