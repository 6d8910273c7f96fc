"""Pictures: every function takes data and returns a matplotlib Figure; one `save` writes it.

Modules: `run` (one loop), `stability`, `diagnosis`, `sweeps`, `tuning`; `style` (the look, `save`); `output` (`draw`);
`viewer` (robots in a browser), `report` (one page for a result).
"""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__,
    {
        "output": "FigureError draw",
        "run": "plot",
        "style": "save",
        "viewer.front": "view",
    },
)
