"""Gains by gradient within what the drives allow."""

from cnclik.tuning.parameters import Parameter, scaled_links
from cnclik.tuning.tune import LOSSES, Tuned, tune

__all__ = ["LOSSES", "Parameter", "Tuned", "scaled_links", "tune"]
