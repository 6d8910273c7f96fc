"""What a log shows: the limits that it breaks, the drive behind it, and why it shakes. NumPy and SciPy only."""

from cnclik.diagnosis.check import Finding, LogCheck, check_log
from cnclik.diagnosis.diagnose import Diagnosis, Kind, diagnose
from cnclik.diagnosis.fit import DriveFit, fit_drive

__all__ = ["DriveFit", "Finding", "LogCheck", "check_log", "fit_drive"]
