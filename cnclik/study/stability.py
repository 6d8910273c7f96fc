"""Stability in one place: linear theory, the loop's spectrum, the region of attraction, measured maps."""

from cnclik.study.attraction import attraction_radius, certified_radius, curvature_bound, sampled_attraction
from cnclik.study.linear import (
    Limits,
    amplification,
    delay_limit,
    delayed_radius,
    gain_per_second,
    gain_per_step,
    limits,
    stability_limit,
    stability_region,
)
from cnclik.study.maps import agreement, measure, passes_map, stability_map, starts
from cnclik.study.outcome import Kind, Outcome, outcome, stable
from cnclik.study.spectrum import (
    Margin,
    Recommendation,
    Spectrum,
    margin,
    recommend,
    settle,
    spectral_radius,
    spectrum,
    task_map,
)

__all__ = [
    "Kind",
    "Limits",
    "Margin",
    "Outcome",
    "Recommendation",
    "Spectrum",
    "agreement",
    "amplification",
    "attraction_radius",
    "certified_radius",
    "curvature_bound",
    "delay_limit",
    "delayed_radius",
    "gain_per_second",
    "gain_per_step",
    "limits",
    "margin",
    "measure",
    "outcome",
    "passes_map",
    "recommend",
    "sampled_attraction",
    "settle",
    "spectral_radius",
    "spectrum",
    "stability_limit",
    "stability_map",
    "stability_region",
    "stable",
    "starts",
    "task_map",
]
