"""Gains by gradient within what the drives allow."""

from cnclik.tuning.parameters import Parameter, scaled_links
from cnclik.tuning.tune import LOSSES, tune

__all__ = ["LOSSES", "Parameter", "scaled_links", "tune"]
