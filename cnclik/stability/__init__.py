"""Which gain is safe at which sampling time.

Theory (`amplification`, `stability_limit`), the loop's own spectrum and what it advises (`advise`, `recommend`,
`margin`, `analyse`), measured maps (`stability_map`, `passes_map`), regions of attraction, responses, and what a run
did in a sentence (`verdict`). What advises computes in float64 by itself, whatever JAX's setting.
"""

import warnings

from cnclik.measure.outcome import Ending, Outcome, outcome
from cnclik.stability.advice import Advice, advise
from cnclik.stability.attraction import attraction_radius, certified_radius, curvature_bound, sampled_attraction
from cnclik.stability.bounds import LimitAdvice, WallAdvice
from cnclik.stability.driven import DrivenLimits, driven_factors, driven_limits
from cnclik.stability.judged import Behaviour
from cnclik.stability.linear import (
    RealAxisLimits,
    amplification,
    delay_limit,
    delayed_radius,
    gain_per_second,
    gain_per_step,
    real_axis_limits,
    stability_limit,
    stability_region,
)
from cnclik.stability.maps import agreement, gains_map, outcomes, passes_map, stability_map
from cnclik.stability.peers import from_pink, to_pink
from cnclik.stability.plane import plane
from cnclik.stability.recommend import Analysis, Margin, Recommendation, analyse, margin, recommend
from cnclik.stability.remedies import Remedy
from cnclik.stability.responses import responses
from cnclik.stability.spectrum import (
    Spectrum,
    at_rest,
    largest_rate,
    one_step,
    settle,
    spectral_radius,
    spectrum,
    step_maps,
    task_map,
    task_radius,
)
from cnclik.stability.tasks import Leak, StackAdvice, TaskAdvice
from cnclik.stability.verdict import Verdict, verdict

__all__ = ["Advice", "Analysis", "Behaviour", "DrivenLimits", "Ending", "Leak", "LimitAdvice", "Margin", "Outcome"]
__all__ += ["RealAxisLimits", "Recommendation", "Remedy", "Spectrum", "StackAdvice", "TaskAdvice", "Verdict"]
__all__ += ["WallAdvice", "advise", "agreement", "amplification", "analyse", "at_rest", "attraction_radius"]
__all__ += ["certified_radius", "curvature_bound", "delay_limit", "delayed_radius", "driven_factors", "driven_limits"]
__all__ += ["from_pink", "gain_per_second", "gain_per_step", "gains_map", "largest_rate", "margin", "one_step"]
__all__ += ["outcome", "outcomes", "passes_map", "plane", "real_axis_limits", "recommend", "responses"]
__all__ += ["sampled_attraction", "settle", "spectral_radius", "spectrum", "stability_limit", "stability_map"]
__all__ += ["stability_region", "step_maps", "task_map", "task_radius", "to_pink", "verdict"]

_MOVED = {"practice": "advise", "Practice": "Advice"}  # names of the version before, which go with the next one


def __getattr__(name):
    if name not in _MOVED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(f"cnclik.stability.{name} is cnclik.stability.{_MOVED[name]} now", DeprecationWarning, stacklevel=2)
    return globals()[_MOVED[name]]
