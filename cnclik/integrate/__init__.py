"""How the loop moves in time."""
