"""What a log shows: the limits that it breaks, the drive behind it, and why it shakes. NumPy and SciPy only."""

from cnclik.diagnosis.check import Finding, LogCheck, check_log
from cnclik.diagnosis.diagnose import Diagnosis, StackDiagnosis, diagnose, diagnose_tasks
from cnclik.diagnosis.fit import DriveFit, fit_drive

__all__ = ["Diagnosis", "DriveFit", "Finding", "LogCheck", "StackDiagnosis"]
__all__ += ["check_log", "diagnose", "diagnose_tasks", "fit_drive"]
