"""What a recording shows about the loop behind it.

`diagnose` finds ringing, the dead time, the present gain, and the gain that stops the ringing; `diagnose_tasks` finds
which task's gain of a stack causes it. `fit_drive` fits the drive between recorded commands and the recorded motion.
NumPy and SciPy only.
"""

from cnclik.diagnosis.diagnose import Diagnosis, diagnose
from cnclik.diagnosis.fit import DriveFit, fit_drive
from cnclik.diagnosis.judge import Kind
from cnclik.diagnosis.tasks import StackDiagnosis, TaskDiagnosis, diagnose_tasks

__all__ = ["Diagnosis", "DriveFit", "Kind", "StackDiagnosis", "TaskDiagnosis"]
__all__ += ["diagnose", "diagnose_tasks", "fit_drive"]
