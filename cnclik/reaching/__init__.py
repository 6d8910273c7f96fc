"""Reaching: which joint values put the tip there, for one target or a million, with a reason where none do.

`targets` reads what is asked, `seeds` knows where to start, `step` is the iteration, `programs` runs it for batches,
`search` tries until all is found, `single` is the same for one target and for what JAX traces, `reach` puts them
together and says how it went.
"""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__, {"map": "Reachability reachability", "reach": "reach", "result": "Reached ReachStatus"}
)
