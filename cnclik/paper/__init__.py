"""Drexler (2016): its experiments under every reading of its text, its claims, its figures.

run = paper.experiment("5dof", "track", "CN")     # one of its runs
found = paper.reproduce("reproduced")             # all of them, with data, claims and figures in a folder
"""

import lazy_loader

from cnclik.paper.choices import DEFAULT, READINGS, reading

_OTHERS = {"claims": ["judge"], "data": ["reproduce"], "readings": ["experiment"]}
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs=_OTHERS)
__all__ = ["DEFAULT", "READINGS", "experiment", "judge", "reading", "reproduce"]
