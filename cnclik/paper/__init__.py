"""Drexler (2016): its experiments under every reading of its text, its claims, its figures.

run = paper.experiment("5dof", "track", "CN")     # one of its runs
found = paper.reproduce("reproduced")             # all of them, with data, claims and figures in a folder
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "data": ["reproduce"],
        "readings": ["experiment"],
    },
)
