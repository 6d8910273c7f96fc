"""Loop: the loop in time, as a state and a step that measures, advances, and passes the robot's drives.

A measurement acts through one vector per step, the difference between the measured error and that of the law's own
chain. It is constant during a step, as for a controller that measures once per sample.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cnclik.engine.tracing import checkpointed
from cnclik.integrate.drive import Drive, Sampled, sampled
from cnclik.integrate.march import charted, exponential_march, march
from cnclik.integrate.method import Method, evaluations_per_step
from cnclik.integrate.stage import Stage
from cnclik.integrate.status import flags, growing
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.law import Law, evaluate, evaluate_at, observe
from cnclik.law.limits import inside, within
from cnclik.law.paths import Reference
from cnclik.law.reference import References, check, tangent
from cnclik.record import Array, Float, Int, cast, record, replace
from cnclik.robot import chart
from cnclik.robot.chart import centre, out
from cnclik.robot.model import modelled
from cnclik.robot.rotations import exp_so3, log_so3
from cnclik.task.task import error


@dataclasses.dataclass(frozen=True, eq=False)
class Loop:
    """The constants of a loop, of one dtype: made by `loop_of`."""

    law: Law
    reference: Reference | References
    method: Method
    stage: Stage
    Ts: Float[Array, ""]
    t0: Float[Array, ""]
    N: int
    drive: Drive  # between command and motion
    model: Sampled | None  # the drive from sample to sample; None: ideal
    noise: Float[Array, "N m"] | None  # added to the measured error

    @property
    def direct(self) -> bool:
        """Whether the robot does what the law asks for, and the controller knows its error."""
        return self.model is None and self.noise is None


class Driven(NamedTuple):
    """The state of the drives."""

    x: Float[Array, "n s"]
    line: Float[Array, "d n"]  # commands that still act, newest first
    sent: Float[Array, " n"]  # the sum of the controller's steps
    late: tuple[Array, ...]  # measured errors on their way, newest first
    smooth: Any  # the filtered error (m,), command (n,), or target of each part of the task; None without a filter


class State(NamedTuple):
    """The state of a loop."""

    q: Float[Array, " n"]  # the robot's joint values
    lost: Float[Array, " n"] | None = None  # rounding error of q, in float32 without drive and noise
    drives: Driven | None = None


def loop_of(law, reference, q0, Ts, N, method, stage, *, t0=0.0, drive=None, model=None, noise=None) -> Loop:
    """Return a loop from q0 (n,), in its dtype. Pure: a part of the program that runs it.

    Args: as for `solve`; `model` if the drive is already sampled.
    """
    check(reference, law.task)
    drive = drive or Drive()
    model = None if drive.prompt else model or sampled(drive, Ts)
    law, reference, drive, model, noise = cast((modelled(law), reference, drive, model, noise if N else None), q0.dtype)
    Ts, t0 = jnp.asarray(Ts, q0.dtype), jnp.asarray(t0, q0.dtype)
    return Loop(law, reference, method, stage, Ts, t0, N, drive, model, noise)


def start(loop: Loop, q0, *, compensated=False) -> State:
    """Return the state at rest at q0 (n,). Args: compensated: whether rounding errors of q are kept, see `summed`."""
    if loop.model is None:
        return State(q0, jnp.zeros_like(q0) if compensated else None)
    law, drive, model = loop.law, loop.drive, loop.model
    at = observe(law, loop.reference, loop.t0, q0)
    late = (at.e * (drive.filters != "target"),) * (0 if drive.feedback == "commanded" else drive.measurement_delay)
    held = q0 if drive.steps_positions else jnp.zeros_like(q0)  # what was commanded before
    smooth: Any = {"error": jnp.zeros_like(at.e), "command": held}.get(drive.filters)
    if drive.filters == "target":  # which was where the robot is, so no error is on its way
        smooth = tuple(part.here(at.robot) for part in law.task.parts)
    x = jnp.zeros((*q0.shape, model.size), q0.dtype).at[..., 0].set(chart.centre(law.chain, q0))
    return State(q0, drives=Driven(x, jnp.tile(held, (model.remembered, 1)), q0, late, smooth))


def one(loop: Loop, state: State, k):
    """Return (the state after step k, its `Step` with q, x and e before it). Pure.

    One at the last instant gives x and e there; the state after it is of no use.
    """
    law, q, lost = loop.law, state.q, state.lost
    t = loop.t0 + k * loop.Ts
    if loop.direct:
        made = advance(law, loop.reference, q, t, loop.Ts, loop.method, loop.stage)
        after = made.q
        if lost is not None:
            after, lost = summed(law, q, loop.Ts * made.qdot, lost)
        return State(after, lost), replace(made, q=q)
    seen, offset, at, drives = _measured(loop, state, t, k)
    made = advance(law, loop.reference, seen, t, loop.Ts, loop.method, loop.stage, offset)
    after, qdot = made.q, made.qdot
    if drives is not None:
        after, drives = _driven(loop, drives, q, seen, chart.between(law.chain, seen, made.q))
        qdot = 1 / loop.Ts * chart.between(law.chain, q, after)
    return State(after, drives=drives), replace(made, q=q, qdot=qdot, x=at.x(), e=at.e)


def _measured(loop, state, t, k):
    """Return (joint values that the controller uses, what its measured error has beside theirs, the truth, drives)."""
    law, reference, drives, seen = loop.law, loop.reference, state.drives, state.q
    at = observe(law, reference, t, seen)
    if drives is not None and loop.drive.feedback == "commanded":  # from its commands a controller knows its own tip
        seen = drives.sent
    known = at if seen is state.q else observe(law, reference, t, seen)
    found, filters, kept = known.e, loop.drive.filters, loop.drive.kept(loop.Ts)
    if filters == "target":
        parts = zip(law.task.parts, drives.smooth, at.aims, strict=True)
        drives = drives._replace(
            smooth=tuple(turned(kept, *v) if part.turns else averaged(kept, *v) for part, *v in parts)
        )
        found = error(law.task, known.robot, drives.smooth)
    errors = found, *(drives.late if drives is not None else ())
    measured = errors[-1]
    if loop.noise is not None:
        measured = measured + loop.noise[k.astype(int)]
    if filters == "error":
        measured = averaged(kept, drives.smooth, measured)
        drives = drives._replace(smooth=measured)
    offset = None if measured is known.e else measured - known.e
    return seen, offset, at, None if drives is None else drives._replace(late=errors[:-1])


def run(loop: Loop, q0) -> Trajectory:
    """Return the `Trajectory` of a loop from rest at q0 (n,). Pure."""
    k, task, N = jnp.arange(loop.N + 1).astype(q0.dtype), loop.law.task, loop.N
    state = start(loop, q0, compensated=q0.dtype == jnp.float32 and loop.direct)
    step = functools.partial(one, loop)
    step = checkpointed(step) if loop.direct else step

    def with_last(carry, k):  # beside the rows: a program that asks for the end alone then stores none
        after, made = step(carry[0], k)
        return (after, (made.q, made.x, made.e)), made

    empty = jnp.zeros(task.m, q0.dtype)
    (_, last), steps = jax.lax.scan(with_last, (state, (jnp.zeros_like(q0), empty, empty)), k)

    steps = jax.tree.map(lambda rows: jax.lax.slice_in_dim(rows, 0, N), steps)
    made = Trajectory(
        t=loop.t0 + k * loop.Ts,
        **{name: jnp.concatenate([getattr(steps, name), end[None]]) for name, end in zip("qxe", last, strict=True)},
        **{name: getattr(steps, name) for name in ("qdot", "residual", "contraction", "status", "walls")},
        evaluations=jnp.asarray(N * evaluations_per_step(loop.method, loop.stage, loop.law.chain.n)),
        tasks=tuple((name, at.start, at.stop) for name, at in task.each),
    )
    if not loop.direct:  # with noise an error grows and shrinks at random
        return made
    return replace(made, status=made.status | growing(loop.law, loop.reference, made.t, made.e))


# --- drives and filters within the loop ---------------------------------------------------------------


def _driven(loop, drives, q, seen, step):
    """Return the joint values one sample after q, and the drives then, for a step from the values the law used."""
    chain, drive, smooth = loop.law.chain, loop.drive, drives.smooth
    sent = chart.moved(chain, seen if drive.feedback == "rebased" else drives.sent, step)
    command = sent if drive.steps_positions else step / loop.Ts
    if drive.filters == "command":
        command = smooth = averaged(drive.kept(loop.Ts), smooth, command)
    line = jnp.concatenate([command[None], drives.line])[: len(drives.line)]
    x = loop.model.moved(drives.x, drives.line, command)
    after = chart.out(chain, q, x[:, 0])
    if chain.balls:
        x = x.at[:, 0].set(chart.centre(chain, after))
    return after, drives._replace(x=x, line=line, sent=sent, smooth=smooth)


def averaged(kept, before, new):
    """Return one sample of the filter: ρ before + (1 − ρ) new."""
    return kept * before + (1 - kept) * new


def turned(kept, before, new):
    """Return one sample of the filter of a rotation."""
    return exp_so3((1 - kept) * log_so3(new @ before.T)) @ before


# --- one step of the loop with any method -------------------------------------------------------------


@record
class Step:
    """One step of the loop: the fields of a `Trajectory`, without the time axis.

    Attributes:
      q: (n,) joint values after the step [rad, m].
      x, e: (m,) task coordinates and error before it [m, rad].
      qdot: (n,) constant joint velocity during it [rad/s, m/s].
      residual, contraction: last change of the implicit stage, as a joint displacement, and its ratio to that before.
      least: least singular value of the task Jacobian before it, an estimate from below; in a stack the least of its
        tasks.
      status: bits of `Status`.
      walls: (k,) margin of the approach velocity at each wall, see `Trajectory`; None without walls.
    """

    q: Float[Array, " n"]
    x: Float[Array, " m"]
    e: Float[Array, " m"]
    qdot: Float[Array, " n"]
    residual: Float[Array, ""]
    contraction: Float[Array, ""]
    least: Float[Array, ""]
    status: Int[Array, ""]
    walls: Float[Array, " k"] | None = None


def advance(law: Law, reference, q, t, Ts, method, stage, offset=None) -> Step:
    """Make one step of the loop, of a law whose chain is a `Model`. Args: offset: see `observe`."""
    known = reference if reference.known else tangent(reference, law.task, t)
    at = observe(law, known, t, q, offset)
    if method.exponential:
        made = exponential_march(law, known, q, at, t, Ts, method, stage)
    else:

        def field(c, q):
            return evaluate(law, known, t if type(c) is float and c == 0 else t + c * Ts, q, offset)

        field, y = charted(law.chain, q, field), centre(law.chain, q)
        made = march(field, y, Ts, method, stage, evaluate_at(law, q, at))
    y, qdot = made.q, made.qdot
    if law.limits is not None:
        y, qdot = within(law, centre(law.chain, q), qdot, Ts)
    after = out(law.chain, q, y)
    status = flags(law, after, qdot, made.residual, stage.tolerance, made.first)
    return Step(
        q=after,
        x=at.x(),
        e=at.e,
        qdot=qdot,
        residual=made.residual,
        contraction=made.contraction,
        least=jnp.min(made.first.least),
        status=status,
        walls=made.first.walls,
    )


def summed(law, q, step, lost):
    """Return q + step within the law's position limits, and the rounding error of the sum (Kahan 1965).

    In single precision, steps below half a spacing of q would otherwise be lost, and the loop stop short of its target.

    Args: lost: the rounding error of the last step, to be added with this one.
    """
    step, y = step + lost, centre(law.chain, q)
    after = inside(law, y, y + step)
    return out(law.chain, q, after), jax.lax.stop_gradient(step - (after - y))
