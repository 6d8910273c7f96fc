"""Numbers from runs: metrics, outcomes, labelled datasets, files."""

from cnclik.measure.dataset import as_json, provenance, to_dataset
from cnclik.measure.files import markdown, save_netcdf
from cnclik.measure.metrics import METRICS, Metrics, measure_run

__all__ = ["METRICS", "Metrics", "as_json", "markdown", "measure_run", "provenance", "save_netcdf", "to_dataset"]
