"""From JAX to a controller: the step, the loop, forward kinematics and Jacobian as C.

`c` writes them, `load` builds and calls them; `compiled` is both. `trace` reads what JAX traced into a `graph`,
`scalar` writes it as C99 and `vector` for many lanes at once.
"""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(__name__, {"write": "c", "load": "Compiled compiled load"})
