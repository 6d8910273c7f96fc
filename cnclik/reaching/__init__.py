"""Reaching: which joint values put the tip there, for one target or a million, with a reason where none do.

`targets` reads what is asked, `seeds` knows where to start, `step` is the iteration, `strategy` how a search goes on.
`search` is that search as a pure function, c/search.c as C. `native` runs the C, `single` the function, in programs of
its own and in those of others; `many` chooses, `public` puts all together, `result` says how it went.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={"map": ["Reachability", "reachability"], "result": ["Reached", "ReachStatus"], "public": ["reach"]},
)
