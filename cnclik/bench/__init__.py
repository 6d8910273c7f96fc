"""What this machine does in a second: `bench.measure_apart(bench.Line(robot="panda", method="EE", stage="picard"))`."""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__,
    {
        "lines": "Line product table",
        "timing": "LineError measure measure_apart",
    },
)
