"""Words: robots and tasks by name, read without loading JAX."""

ROBOTS = {"panda": "flange", "ur5": "tool flange"}  # {name: its tip}
PLANAR = dict.fromkeys(("planar", "planar-clockwise"), "end of the last link")  # planar:1,1; the paper's turn clockwise
TASKS = ("pose", "position", "orientation")
