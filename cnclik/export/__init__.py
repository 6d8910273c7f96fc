"""From JAX to a controller: a step of the loop, or a robot's kinematics, as C.

`c` writes the files. `trace` defines the exported function, `source` writes the C around it, `example` its test
vectors and README. The statements come from `cnclik.engine`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submod_attrs={"write": ["c"]})
