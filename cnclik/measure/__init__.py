"""Numbers from runs: metrics, outcomes, labelled datasets, files."""

from cnclik.measure.dataset import to_dataset
from cnclik.measure.files import save_netcdf
from cnclik.measure.metrics import METRICS, Metrics, measure_run

__all__ = ["METRICS", "Metrics", "measure_run", "save_netcdf", "to_dataset"]
