"""What a recording says of the loop behind it.

`diagnose`: does it ring, how late is the robot, what gain is that, and which would end it. `fit_drive`: the drive that
lies between recorded commands and the recorded motion. NumPy and SciPy only.
"""

from cnclik.diagnosis.diagnose import Diagnosis, diagnose
from cnclik.diagnosis.fit import DriveFit, fit_drive
from cnclik.diagnosis.judge import Kind

__all__ = ["Diagnosis", "DriveFit", "Kind", "diagnose", "fit_drive"]
