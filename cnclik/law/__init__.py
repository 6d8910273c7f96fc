"""The law q̇ = f(q, t) that the loop follows."""

from cnclik.law.bounded import bounded
from cnclik.law.inverse import (
    damped,
    error_damped,
    levels,
    manipulability_damped,
    pseudoinverse,
    singular_damped,
    transpose,
)
from cnclik.law.law import Law
from cnclik.law.limits import saturation, velocity_scaling, weighted_least_norm
from cnclik.law.null import maximize_manipulability, posture
from cnclik.law.paths import causal, circle, hold, hold_at, line, lissajous, path, waypoints, with_feedforward
from cnclik.law.reference import Reference, References, references
from cnclik.law.walls import wall, wall_distance, wall_margin

__all__ = [
    "Law",
    "Reference",
    "References",
    "bounded",
    "causal",
    "circle",
    "damped",
    "error_damped",
    "hold",
    "hold_at",
    "levels",
    "line",
    "lissajous",
    "manipulability_damped",
    "maximize_manipulability",
    "path",
    "posture",
    "pseudoinverse",
    "references",
    "saturation",
    "singular_damped",
    "transpose",
    "velocity_scaling",
    "wall",
    "wall_distance",
    "wall_margin",
    "waypoints",
    "weighted_least_norm",
    "with_feedforward",
]
