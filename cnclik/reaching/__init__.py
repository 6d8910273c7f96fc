"""Reaching: which joint values put the tip there, for one target or a million, with a reason where none do.

`targets` reads what is asked, `seeds` knows where to start, `step` is the iteration, `native` runs it as C until all is
found. Without a compiler `programs` and `search` do, in batches; `single` is the same for one target and for what JAX
traces. `many` chooses, `reach` puts all together, `result` says how it went.
"""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__, {"map": "Reachability reachability", "reach": "reach", "result": "Reached ReachStatus"}
)
