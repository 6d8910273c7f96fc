"""Numbers from runs: metrics, outcomes, labelled datasets, files."""

from cnclik.measure.dataset import to_dataset
from cnclik.measure.metrics import METRICS, measure_run

__all__ = ["METRICS", "measure_run", "to_dataset"]
