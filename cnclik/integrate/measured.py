"""Measured: the loop as a robot runs it, through its drives, measured with noise, on geometry that the law lacks.

What is measured of the task acts through one number per step: the error that is fed back is the measured one, w[k]
away from what the law's own chain would say. A step holds w[k], as a controller does that measures once per sample.
"""

import jax
import jax.numpy as jnp

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive, driven, measured_joints, moving, resting
from cnclik.integrate.history import blank
from cnclik.integrate.method import named
from cnclik.integrate.solve import advance, cast, check_arguments, early_steps, evaluations_of
from cnclik.integrate.trajectory import Trajectory, assemble, instants
from cnclik.law.law import look
from cnclik.law.reference import check
from cnclik.law.shifted import shifted
from cnclik.record import replace
from cnclik.robot.model import modelled, one_off
from cnclik.robot.rotations import turn_from


def white_noise(sigma, N: int, m: int, seed=0):
    """(N, m) independent normal errors of a measurement, the same for the same seed.

    Args:
      sigma: standard deviation, a number or one per task coordinate (m,) [m, rad]; it may be traced, as may the seed.
    """
    sigma = errors.array("noise", sigma, (), (1,), (m,))
    if errors.concrete(sigma) and (sigma < 0).any():
        raise errors.fail("noise", "be at least 0", f"is {sigma.min():g}")
    errors.seed(seed)
    sigma = jnp.asarray(sigma)
    key = jax.random.key(jnp.asarray(seed).astype(jnp.uint32))
    return sigma * jax.random.normal(key, (N, m), sigma.dtype)


def _between(task, measured, model):
    """What a target is to be moved by so that its error is the measured one, and not the model's (m,)."""
    p = len(task.position)
    if len(task.orientation) < 3:
        return measured - model
    return jnp.concatenate([measured[:p] - model[:p], turn_from(-measured[p:], -model[p:])])


def solve_measured(
    law, reference, q0, Ts, N: int, method, stage, *, drive=Drive(), noise=None, plant=None, gained=None
) -> Trajectory:
    """`solve` on a robot: through its drives, with what is measured; `q`, `e` and `qdot` are what truly happens. Pure.

    The controller steps from the joint values that it looks at; what `Drive` says of them, and of the way from its
    step to the motion, holds from rest at q0 on. No step is marked GROWING: with noise an error grows and shrinks by
    chance.

    Args:
      law, reference, q0, Ts, N, method, stage: as for `solve`, and what it raises.
      drive: see `Drive`.
      noise: (N, m) added to the measured error at each step [m, rad], or None.
      plant: the chain as it really is, the law's being a model of it; None: the same.
      gained: the law at time t, gained(law, t), where it changes; None: the same.
    """
    given = _checked(law, reference, q0, Ts, N, method, stage, drive, noise)
    return _loop(*given, plant, N=N, method=named(method), gained=gained)


def solve_driven(law, reference, q0, Ts, N: int, method, stage, *, drive=Drive(), noise=None) -> Trajectory:
    """`solve_measured`, compiled. Args: as there; the drive is sampled once, before."""
    given = _checked(law, reference, q0, Ts, N, method, stage, drive, noise)
    return _compiled(*given, None, N=N, method=named(method))


def _checked(law, reference, q0, Ts, N, method, stage, drive, noise):
    q0, method = check_arguments(law, reference, q0, Ts, method, stage)
    check(reference, law.task)
    check_drive(drive, law.chain.n)
    if noise is not None:
        noise = errors.array("noise", noise, (N, law.task.m))
    return law, reference, q0, Ts, stage, drive, moving(drive, Ts), noise


def state_at_rest(law, reference, start, drive, model, *, method, plant=None):
    """The state that `through` begins with, from the joint values `start` (n,)."""
    at_drives = None if model is None else resting(drive, model, start)
    zero = jnp.zeros((), start.dtype)
    first = look(_truly(law, plant), reference, zero, start).e  # until the first measurement arrives
    return start, at_drives, (first,) * _late(drive), blank(law, start, method)


def _truly(law, plant):
    return law if plant is None else replace(law, chain=plant)


def _late(drive) -> int:
    return 0 if drive.feedback == "commanded" else drive.measurement_delay


def through(law, reference, Ts, stage, drive, model, *, method, N, noise=None, plant=None, gained=None):
    """The step of a loop on a robot, repeated from `state_at_rest` on: one(starting, state, k) -> (state, `Step`).

    Args: as for `solve_measured`, all of one dtype; `model` as by `moving`.
    """
    differs, true_law = plant is not None, _truly(law, plant)
    commanded, late = drive.feedback == "commanded", _late(drive)
    as_told = noise is None and not differs and drive.prompt and drive.exact  # the loop is `solve`'s own

    def one(starting, state, k):
        q, at_drives, past, history = state
        t, length = k * Ts, jnp.where(k < N, Ts, 0.0)  # see `instants`
        now = law if gained is None else gained(law, t)
        if as_told:
            made = advance(now, reference, q, t, length, method, stage, history, starting=starting)
            return (made.q, at_drives, past, made.history), replace(made, q=q, history=None)
        at, seen = look(true_law, reference, t, q), q
        if commanded:
            seen = at_drives.sent
        elif not drive.exact:
            seen = measured_joints(drive, q, k)
        # A camera sees the tip where it is; of its own commands a controller knows what its model says.
        found = at.e if seen is q else look(law if commanded else true_law, reference, t, seen).e
        measured = (found, *past)[late]
        if noise is not None:
            measured = measured + noise[k.astype(int)]
        exact = noise is None and not differs and not late
        believed = measured if exact else look(law, reference, t, seen).e
        told = reference
        if believed is not measured:
            told = shifted(reference, law.task, _between(law.task, measured, believed))
        made = advance(now, told, seen, t, length, method, stage, history, starting=starting)
        if model is None:
            moved = made.q if seen is q else q + (made.q - seen)
        else:
            step = made.q - seen
            at_drives = driven(drive, model, at_drives, seen, step, Ts)
            moved = at_drives.x[:, 0]
        if moved is not made.q:
            made = replace(made, qdot=1 / Ts * (moved - q))
        return (moved, at_drives, (found, *past)[:late], made.history), replace(
            made, q=q, x=at.x(), e=at.e, history=None
        )

    return one


def _loop(law, reference, q0, Ts, stage, drive, model, noise, plant, *, N, method, gained=None):
    law, plant = modelled(law), modelled(plant)
    law, plant, reference, noise, Ts, drive, model = cast((law, plant, reference, noise, Ts, drive, model), q0.dtype)
    one = through(law, reference, Ts, stage, drive, model, method=method, N=N, noise=noise, plant=plant, gained=gained)
    state = state_at_rest(law, reference, q0, drive, model, method=method, plant=plant)
    k = jnp.arange(N + 1).astype(q0.dtype)
    found = instants(one, state, k, q0, law.task.m, early=early_steps(method, N))
    return assemble(k * Ts, found, evaluations_of(method, stage, law.chain.n, N))


_compiled = one_off(_loop, static_argnames=("N", "method"))
