"""Gains by gradient, stability as a constraint: `tune`, `calibrate`, and what goes into and comes out of them."""

from cnclik.tuning.conditions import Conditions
from cnclik.tuning.controller import controller_lines
from cnclik.tuning.descent import Descent
from cnclik.tuning.field import end_responses, radius_field
from cnclik.tuning.losses import LOSSES, View
from cnclik.tuning.objective import Goal, judge, loop_objective
from cnclik.tuning.page import page
from cnclik.tuning.parameters import Parameter, parameter, scaled_links
from cnclik.tuning.result import Performance, Tuned, gradient_in_words, to_json
from cnclik.tuning.tune import Calibrated, calibrate, tune

__all__ = ["LOSSES", "Calibrated", "Conditions", "Descent", "Goal", "Parameter", "Performance", "Tuned", "View"]
__all__ += ["calibrate", "controller_lines", "end_responses", "gradient_in_words", "judge", "loop_objective", "page"]
__all__ += ["parameter", "radius_field", "scaled_links", "to_json", "tune"]
