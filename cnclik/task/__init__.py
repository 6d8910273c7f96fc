"""Tasks: coordinates of tips and joints, their errors and their rows of the task Jacobian."""
