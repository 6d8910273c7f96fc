"""Integration: how the loop moves in time."""
