"""Reaching: joint values that put the tip at one target or at a million, and the reason where there are none.

`targets` reads the targets, `seeds` has the start postures, `step` is the iteration, `strategy` the order of tries.
`search` is the search as a pure function, c/search.c the same in C. `native` runs the C; `single` runs the function, in
programs of its own and in those of others. `many` chooses between them, `public` is the entry, `result` the record.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={"result": ["Reached", "ReachStatus"], "public": ["reach"]},
)
