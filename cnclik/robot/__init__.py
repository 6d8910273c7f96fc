"""The robot: chains and the ways to build one, where the tip is and how it moves."""

from cnclik.record import register_waiting

register_waiting()  # from here on JAX is needed
