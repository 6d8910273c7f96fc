"""Gains by gradient within what the drives allow: `tune`; geometry from measured positions: `calibrate`."""

from cnclik.tuning.calibrate import Calibrated, calibrate
from cnclik.tuning.parameters import Parameter, scaled_links
from cnclik.tuning.tune import LOSSES, Tuned, tune

__all__ = ["LOSSES", "Calibrated", "Parameter", "Tuned", "calibrate", "scaled_links", "tune"]
