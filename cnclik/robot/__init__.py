"""The robot: chains and the ways to build one, where the tip is and how it moves."""
