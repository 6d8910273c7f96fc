"""From JAX to a controller: the step, the loop, forward kinematics and Jacobian as C.

`c` writes them, `load` builds and calls them; `compiled` is both. `trace` and `loop` say what is traced,
`source`, `solve_source` and `lanes_source` what is written around it, `reach_source` both of a search for a target;
all else is `cnclik.engine`'s.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"write": ["c"], "library": ["Compiled", "compiled", "load"]}
)
