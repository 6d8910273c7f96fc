"""Gains by gradient within what the drives allow."""

from cnclik.tuning.parameters import Parameter
from cnclik.tuning.tune import tracking, tune

__all__ = ["Parameter", "tracking", "tune"]
