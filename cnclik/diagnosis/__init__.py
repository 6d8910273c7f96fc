"""What a recording says of the loop behind it.

`diagnose`: does it ring, how late is the robot, what gain is that, and which would end it; `diagnose_tasks`: which
task's gain of a stack it is. `fit_drive`: the drive that lies between recorded commands and the recorded motion. NumPy
and SciPy only.
"""

from cnclik.diagnosis.diagnose import Diagnosis, diagnose
from cnclik.diagnosis.fit import DriveFit, fit_drive
from cnclik.diagnosis.judge import Kind
from cnclik.diagnosis.tasks import StackDiagnosis, TaskDiagnosis, diagnose_tasks

__all__ = [
    "Diagnosis",
    "DriveFit",
    "Kind",
    "StackDiagnosis",
    "TaskDiagnosis",
    "diagnose",
    "diagnose_tasks",
    "fit_drive",
]
