"""
Where can the arm reach, and in how many orientations?
======================================================

`ck.reachability` tries every place of a plane in orientations that fill the turns evenly: here 10 of them for a
Panda, over 20 × 20 places.
"""

import cnclik as ck
from cnclik.show.reach import reachability

found = ck.reachability(ck.panda(), "xz", cells=20, orientations=10)
reachability(found, title="Panda")
print(found.reached)
