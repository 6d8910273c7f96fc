"""
My robot shakes. What does its recording say?
=============================================

A loop with four samples of dead time and z = 0.3 rings. From a log of its joints, `ck.diagnose` finds the mode that
swings, the drives that have such a mode, and the gain that stops it.
"""

import numpy as np

import cnclik as ck
from cnclik.show.diagnosis import oscillation

rng = np.random.default_rng(1)
e = [1.0] * 5
while len(e) < 150:
    e.append(e[-1] - 0.3 * e[-5])
q = np.outer(e, [0.10, -0.04]) + [0.5, -1.2] + 0.0005 * rng.standard_normal((150, 2))

found = ck.diagnose(q, 0.002, alpha=150.0)
print(found)
oscillation(q, found, ["q1", "q2"])
