"""
Where can the arm reach, and in how many orientations?
======================================================

`ck.reachability` tries every place of a plane in evenly distributed orientations: here 10 for a Panda, over 20 × 20
places. The left panel shows the share of orientations that the tip reaches, the right panel its distance from a
singularity. Pale grey is out of reach.
"""

import cnclik as ck
from cnclik.show.reach import reachability

found = ck.reachability(ck.panda(), "xz", cells=20, orientations=10)
reachability(found, title="Panda")
some, every = (found.share > 0).sum(), (found.share == 1).sum()
print(f"{some} of {found.share.size} places reached in some orientation, {every} of these in all")
