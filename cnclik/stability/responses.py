"""Responses of a loop around a resting place: to a step and to a sine of its target, along each task axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.plan import unless_chosen
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import picard
from cnclik.law import reference as ref
from cnclik.law.law import check_loop
from cnclik.law.paths import shifted
from cnclik.precision import in_float64
from cnclik.record import Array, Float, record
from cnclik.robot.model import as_joint_values, one_off
from cnclik.stability.linear import checked
from cnclik.stability.spectrum import at_rest

SIZE = 1e-3  # of the step and of the sine's amplitude [m, rad]: small, so that geometry plays no part
PERIOD = 30  # of the sine, in samples


@record
class _Probe:
    """SIZE along `unit` (m,), at once (omega = 0) or as sin(omega t)."""

    unit: Float[Array, " m"]
    omega: Float[Array, ""]

    def __call__(self, t):
        return self.unit * (SIZE * self.wanted(t))

    def wanted(self, t):
        return jnp.where(self.omega > 0, jnp.sin(self.omega * t), jnp.ones_like(t))


@one_off(static_argnames=("N", "method"))
def _responses(law, curve, q, Ts, stage, units, omega, drive, *, N, method):
    def one(unit, omega):
        probe = _Probe(unit=unit, omega=omega)
        target = shifted(ref.Reference(curve=curve), law.task, probe)
        run = solve(law, target, q, Ts, N, method, stage, drive=drive)
        wanted = probe.wanted(run.t)
        return wanted, wanted - (run.e / SIZE) @ unit

    return jax.vmap(one)(units, omega)


@in_float64
def responses(law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), drive=Drive(), N=None):
    """Step and sine responses at a resting place, in units of the input. In float64.

    Args:
      law, reference, q, Ts, method, stage, drive: the loop at rest, as for `recommend`; what a drive adds by chance,
        or does at its limits, has no part in this.
      N: samples; by default as many as two periods of the sine and ten times the dead time and lag.
    Returns: an xarray.Dataset over (test, axis, time): `wanted` and `response`.
    """
    import xarray as xr

    method, stage = checked(method, stage)
    check_loop(law)
    errors.number("Ts", Ts, positive=True)
    check_drive(drive, law.chain)
    long = int(np.ceil(10 * np.max(drive.late_by(float(Ts))) / float(Ts)))
    N = errors.integer("N", max(2 * PERIOD, long) if N is None else N, at_least=1, at_most=errors.MOST)
    law, held = at_rest(law, reference, q)
    q = as_joint_values(law.chain, q)
    m, Ts = law.task.m, float(Ts)
    units = np.tile(np.eye(m), (2, 1))
    omega = np.repeat([0.0, 2 * np.pi / (PERIOD * Ts)], m)
    with unless_chosen("plain"):  # twelve runs, once: C takes its compiler seconds
        made = _responses(law, held.curve, q, jnp.asarray(Ts), stage, units, omega, drive, N=N, method=method)
    wanted, response = (np.asarray(v).reshape(2, m, N + 1) for v in made)
    dims = ("test", "axis", "time")
    return xr.Dataset(
        {"wanted": (dims, wanted, {"units": "1"}), "response": (dims, response, {"units": "1"})},
        coords={
            "test": ("test", ["step", "sine"]),
            "axis": ("axis", list(law.task.names)),
            "time": ("time", np.arange(N + 1) * Ts, {"units": "s"}),
        },
        attrs={
            "size": SIZE,
            "period": PERIOD * Ts,
            "shown": 26 if drive.prompt else N + 1,
            "method": method.name,
            "stage": str(stage),
        },
    )
