"""What a log shows: the limits that it breaks, the drive behind it, and why it shakes. NumPy and SciPy only."""

from cnclik.diagnosis.check import Finding, LogCheck, check_log

__all__ = ["Finding", "LogCheck", "check_log"]
