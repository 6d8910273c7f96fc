"""
Four fingertips: does each keep to its path?
============================================

The Allegro hand has sixteen joints. Each fingertip follows a circle of its own, and the posture is a second level.
``ck.plot(run, law, "tip")`` has a panel for each tip, all of one scale.
"""

import importlib.metadata

import jax
import numpy as np

import cnclik as ck

jax.config.update("jax_enable_x64", True)
installed = importlib.metadata.files("example-robot-data") or []
file = next(one for one in installed if one.name == "allegro_right_hand.urdf").locate()
tips = {"index": "link_3.0_tip", "middle": "link_7.0_tip", "ring": "link_11.0_tip", "thumb": "link_15.0_tip"}
hand = ck.load_urdf(file, tips=list(tips.values()))
q0 = np.clip(0.5, np.array(hand.lower) + 0.1, np.array(hand.upper) - 0.1)
tasks = ck.stack(**{name: ck.position(tip=tip) for name, tip in tips.items()}, rest=ck.joints())
law = ck.Law(hand, tasks, alpha=20.0, inverse=ck.levels(list(tips), ["rest"], damping=(1e-3, 0.3)))
at = {name: np.asarray(ck.forward(hand, q0, tip=tip).position) for name, tip in tips.items()}
circles = {name: ck.circle(place - [0, 0, 0.008], 0.008, period=1.0, normal=[1, 0, 0]) for name, place in at.items()}
run = ck.solve(law, ck.hold_at(hand, tasks, q0, **circles), q0, 0.01, 120)
figure = ck.plot(run, law, "tip")
off = max(np.linalg.norm(run[name].e[60:], axis=1).max() for name in tips)
print(f"after half a second the tips are at most {1e3 * off:.2g} mm off")
