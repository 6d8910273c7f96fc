"""Pictures: every function takes data and returns a matplotlib Figure; one `save` writes it.

Modules: `run` (one loop), `stability`, `diagnosis`, `sweeps`; `style` (the look, `save`); `output` (`draw`); `viewer`
(a run in a browser).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={"run": ["plot"], "viewer": ["view"]},
)
