"""Around a tuned loop: its spectral radius over gains and sampling times, and its responses at the end of the path."""

import numpy as np

from cnclik.precision import in_float64
from cnclik.stability.responses import responses
from cnclik.tuning.linear import radius_over
from cnclik.tuning.parameters import Adjustable, scheduled


@in_float64
def radius_field(tuned, q=None):
    """Spectral radius of the linear loop at rest at q over gains and sampling times around a tuned loop.

    With the drive of the tuning; in float64 whatever JAX's setting is.

    Args:
      tuned: `Tuned`. q: (n,) [rad, m]; default: the end of the tuned run.
    Returns: an xarray.Dataset over (Ts, alpha), where alpha is the gain's largest |eigenvalue| [1/s].
    """
    import xarray as xr

    q = np.asarray(tuned.after.run.q)[-1] if q is None else q
    alpha = np.geomspace(tuned.after.z / tuned.Ts / 20, tuned.after.z / tuned.Ts * 8, 40)
    Ts = np.geomspace(tuned.Ts / 8, tuned.Ts * 8, 25)
    drive = tuned.conditions.drive
    radius = radius_over(tuned.law, q, alpha, Ts, tuned.method, tuned.stage, drive=drive)
    gain = "gain α" if np.ndim(tuned.law.alpha) == 0 else "largest gain of α"
    return xr.Dataset(
        {"radius": (("Ts", "alpha"), radius, {"units": "1", "long_name": "spectral radius"})},
        coords={"alpha": ("alpha", alpha, {"units": "1/s"}), "Ts": ("Ts", Ts, {"units": "s"})},
        attrs={"Ts_before": float(tuned.before.run.t[1] - tuned.before.run.t[0]), "gain": gain, "delay": drive.delay},
    )


@in_float64
def end_responses(tuned):
    """Step and sine responses of a tuned loop around the end of its run, through its drive, see `stability.responses`.

    With the gain that a schedule ends at; in float64 whatever JAX's setting is.
    """
    law = scheduled(Adjustable(law=tuned.law, Ts=tuned.Ts, schedule=tuned.schedule), 1.0)
    rest = np.asarray(tuned.after.run.q)[-1]
    loop = dict(Ts=tuned.Ts, method=tuned.method, stage=tuned.stage, drive=tuned.conditions.drive)
    return responses(law, None, rest, **loop)
