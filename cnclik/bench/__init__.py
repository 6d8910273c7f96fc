"""What this machine does in a second: `bench.measure_apart(bench.Line(robot="panda", method="EE", stage="picard"))`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"lines": ["Line", "product", "table"], "timing": ["LineError", "measure", "measure_apart"]}
)
