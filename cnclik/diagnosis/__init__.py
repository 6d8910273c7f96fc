"""What a log shows: the limits that it breaks, the drive behind it, and why it shakes. NumPy and SciPy only."""

from cnclik.diagnosis.check import check_log
from cnclik.diagnosis.diagnose import diagnose, diagnose_tasks
from cnclik.diagnosis.fit import fit_drive

__all__ = ["check_log", "diagnose", "diagnose_tasks", "fit_drive"]
