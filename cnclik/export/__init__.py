"""From JAX to a controller: the step, the loop, forward kinematics and Jacobian as C.

`c` writes them, `load` builds and calls them; `compiled` does both. `trace` defines what is traced. `source`,
`solve_source` and `lanes_source` write the C around it, and `reach_source` does both for a search for a target. The
rest is done by `cnclik.engine`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"write": ["c"], "library": ["Compiled", "compiled", "load"]}
)
