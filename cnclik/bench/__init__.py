"""What this machine does in a second: `bench.measure_apart(bench.Line(robot="panda", method="EE", stage="picard"))`."""

from cnclik.bench.lines import Line, product, table
from cnclik.bench.timing import LineError, measure, measure_apart

__all__ = ["Line", "LineError", "measure", "measure_apart", "product", "table"]
