"""
Which gain is safe at which sampling time?
==========================================

Every cell is a whole loop of a five-joint arm. The line is the prediction of linear theory. The circle is a loop of
5 1/s at 10 steps a second.
"""

import numpy as np

import cnclik as ck
from cnclik import stability
from cnclik.show.stability import stability_map

arm, q0 = ck.planar_arm([1.0] * 5, clockwise=True), np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0])
law = ck.Law(arm, ck.position("xy"), alpha=5.0)
found = stability.stability_map(
    law, ck.hold([3.0, 1.0]), q0, alpha=np.geomspace(1, 100, 40), Ts=np.geomspace(0.005, 0.5, 30), method="EE", N=60
)
stability_map(found, title="Explicit Euler, 5 joints", operating=(5.0, 0.1))
