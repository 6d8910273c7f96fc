"""Sweeps: many loops over a labelled grid, from Python (`ck.sweep`) or from one TOML file.

data = sweeps.run_spec("sweeps/plane.toml")                # in memory
data = sweeps.run_spec("sweeps/plane.toml", "sweep-plane")   # in a store that survives a kill
"""

from cnclik.sweeps.spec import read as read_spec
from cnclik.sweeps.store import read as open_sweep
from cnclik.sweeps.summary import table as summarize
from cnclik.sweeps.sweep import run_spec

__all__ = ["open_sweep", "read_spec", "run_spec", "summarize"]
