"""Reaching: which joint values put the tip there, for one target or a million, with a reason where none do.

`targets` reads what is asked, `seeds` knows where to start, `step` is the iteration, `native` runs it as C until all is
found. Without a compiler `programs` and `search` do, in batches; `single` is the same for one target and for what JAX
traces. `many` chooses, `public` puts all together, `result` says how it went.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={"map": ["Reachability", "reachability"], "result": ["Reached", "ReachStatus"], "public": ["reach"]},
)
