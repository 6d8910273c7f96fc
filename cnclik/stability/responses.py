"""Responses of a loop around a resting place: to a step and to a sine of its target, along each task axis."""

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.hints import quick_jit
from cnclik.integrate.solve import solve
from cnclik.law import reference as ref
from cnclik.record import record
from cnclik.robot import spatial as sp
from cnclik.robot.kinematics import as_joint_values
from cnclik.stability.linear import named
from cnclik.stability.spectrum import at_rest

SIZE = 1e-3  # of the step and of the sine's amplitude [m, rad]: small, so that geometry plays no part
PERIOD = 30  # of the sine, in samples


@record
class _Probe:
    """A held target moved by SIZE along `unit` (m,), at once (omega = 0) or as sin(omega t)."""

    base: object
    task: object
    unit: object
    omega: object

    def __call__(self, t):
        position, rotation = self.base(t)
        size = SIZE * jnp.where(self.omega > 0, jnp.sin(self.omega * t), jnp.ones_like(t))
        shift = tuple(self.unit[i] * size for i in range(self.task.m))
        linear, turn = shift[: len(self.task.position)], shift[len(self.task.position) :]
        if self.task.position:
            position = sp.vadd(position, linear)
        if self.task.orientation:
            about = dict(zip(self.task.angular, turn, strict=True))
            rotation = sp.matmul(sp.exp_so3(tuple(about.get(i, 0.0) for i in range(3))), rotation)
        return position, rotation


@quick_jit(static_argnames=("N", "method"))
def _responses(law, target, q, Ts, stage, units, omega, *, N, method):
    def one(unit, omega):
        curve = _Probe(base=target.curve, task=law.task, unit=unit, omega=omega)
        run = solve(law, ref.Reference(curve=curve), q, Ts, N, method, stage)
        wanted = jnp.where(omega > 0, jnp.sin(omega * run.t), 1.0)
        return wanted, wanted - (run.e / SIZE) @ unit

    return jax.vmap(one)(units, omega)


def responses(law, q, Ts, method, stage, *, N=2 * PERIOD):
    """Step and sine responses at a resting place, in units of the input.

    Args: law, q (n,), Ts, method, stage: as for `solve`; N: samples.
    Returns: an xarray.Dataset over (test, axis, time): `wanted` and `response`.
    """
    import xarray as xr

    method, stage = named(method, stage)
    q = as_joint_values(law.chain, q)
    m = law.task.m
    units = np.tile(np.eye(m), (2, 1))
    omega = np.repeat([0.0, 2 * np.pi / (PERIOD * Ts)], m)
    target = at_rest(law, None, q)
    made = _responses(law, target, q, jnp.asarray(float(Ts)), stage, units, omega, N=N, method=method)
    wanted, response = (np.asarray(v).reshape(2, m, N + 1) for v in made)
    dims = ("test", "axis", "time")
    return xr.Dataset(
        {"wanted": (dims, wanted, {"units": "1"}), "response": (dims, response, {"units": "1"})},
        coords={
            "test": ("test", ["step", "sine"]),
            "axis": ("axis", list(law.task.names)),
            "time": ("time", np.arange(N + 1) * float(Ts), {"units": "s"}),
        },
        attrs={"size": SIZE, "period": PERIOD * float(Ts), "method": method.name},
    )
