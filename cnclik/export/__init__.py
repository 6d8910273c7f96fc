"""From JAX to a controller: the step, the loop, forward kinematics and Jacobian as C.

`c` writes them, `load` builds and calls them; `compiled` is both. `trace`, `loop` and `reach_trace` say what is traced,
`source`, `solve_source`, `lanes_source` and `reach_source` what is written around it; all else is `cnclik.engine`'s.
"""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(__name__, {"write": "c", "load": "Compiled compiled load"})
