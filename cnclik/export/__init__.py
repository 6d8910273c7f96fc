"""From JAX to a controller: the step, the loop, forward kinematics and Jacobian as C.

`c` writes them, `load` builds and calls them; `compiled` is both. `trace`, `loop` and `reach_trace` say what is traced,
`source`, `solve_source`, `lanes_source` and `reach_source` what is written around it; all else is `cnclik.engine`'s.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"write": ["c"], "library": ["Compiled", "compiled", "load"]}
)
