"""Loop: the loop in time, as a state and a step that measures, advances, and passes the robot's drives.

`solve` runs it and keeps the trajectory, `outcome` reduces it, tuning differentiates it, sweeps run many. Without
drive and noise a step is `advance`.

A measurement acts through one vector per step, w[k], the difference between the measured error and the error of the
law's own chain. It is constant during a step, as for a controller that measures once per sample.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from cnclik import errors
from cnclik.engine.tracing import checkpointed
from cnclik.integrate.drive import Drive, Sampled, moving
from cnclik.integrate.driven import Driven, averaged, driven, reached, resting
from cnclik.integrate.march import charted, exponential_march, march
from cnclik.integrate.method import Method, evaluations_per_step
from cnclik.integrate.stage import Stage
from cnclik.integrate.status import flags, growing, task_flags
from cnclik.integrate.trajectory import assemble
from cnclik.law.law import Law, evaluate, evaluate_at, observe
from cnclik.law.limits import inside, within
from cnclik.law.paths import shifted
from cnclik.law.reference import Reference, References, check, tangent
from cnclik.record import Array, Float, Int, cast, record, replace
from cnclik.robot import chart
from cnclik.robot.chart import centre, out
from cnclik.robot.model import Model, modelled


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
    model: Sampled | None  # the drive, sampled by `moving`
    noise: Float[Array, "N m"] | None  # added to the measured error
    plant: Model | None  # the real chain, if it is not the law's
    gained: Callable | None  # gained(law, t): the law at time t

    @property
    def measured(self) -> bool:
        """Whether command and motion, or motion and measurement, differ."""
        return not (self.noise is None and self.plant is None and self.drive.prompt)

    @property
    def late(self) -> int:
        """Delay of a measurement [samples]."""
        return 0 if self.drive.feedback == "commanded" else self.drive.measurement_delay

    @property
    def truth(self):
        """The law with the real chain."""
        return self.law if self.plant is None else replace(self.law, chain=self.plant)


class State(NamedTuple):
    """The state of a loop."""

    q: Float[Array, " n"]  # the robot's joint values
    lost: Float[Array, " n"] | None = None  # rounding error of q, in float32
    drives: Driven | None = None
    late: tuple[Array, ...] = ()  # measured errors on their way
    smooth: Float[Array, " m"] | None = None  # filtered error; before the start it was 0


def loop_of(
    law, reference, q0, Ts, N, method, stage, *, t0=0.0, drive=None, model=None, noise=None, plant=None, gained=None
) -> Loop:
    """A loop from q0 (n,), in its dtype. Pure: a part of the program that runs it.

    Args: as for `solve`, and for the attributes; `model` if the drive is already sampled.
    """
    check(reference, law.task)
    drive = drive or Drive()
    if drive.filters == "target":
        must = "smooth the error or the command in a run: a smoothed target is a path of its own, see `resampled`"
        raise errors.fail("drive", must, "smooths the target")
    model = moving(drive, Ts) if model is None else model
    given = modelled(law), modelled(plant), reference, noise, drive, model
    law, plant, reference, noise, drive, model = cast(given, q0.dtype)
    Ts, t0 = jnp.asarray(Ts, q0.dtype), jnp.asarray(t0, q0.dtype)
    return Loop(law, reference, method, stage, Ts, t0, N, drive, model, noise, plant, gained)


def start(loop: Loop, q0, *, compensated=False) -> State:
    """The state at rest at q0 (n,). Args: compensated: whether rounding errors of q are carried, see `summed`."""
    first = observe(loop.truth, loop.reference, loop.t0, q0).e if loop.late else None  # until a measurement arrives
    return State(
        q0,
        lost=jnp.zeros_like(q0) if compensated else None,
        drives=None if loop.model is None else resting(loop.law.chain, loop.drive, loop.model, q0),
        late=() if first is None else (first,) * loop.late,
        smooth=jnp.zeros(loop.law.task.m, q0.dtype) if loop.drive.filters == "error" else None,
    )


def one(loop: Loop, state: State, k):
    """(state after step k, `Step` with q, x and e before it). Pure.

    The extra step at the end, k = N, has length 0: it changes nothing and gives x and e at the last instant.
    """
    law, Ts, q = loop.law, loop.Ts, state.q
    t = loop.t0 + k * Ts
    length = jnp.where(k < loop.N, Ts, 0.0)
    now = law if loop.gained is None else loop.gained(law, t)
    measured = _measured(loop, state, t, k) if loop.measured else (q, loop.reference, None, (), None)
    seen, aimed, at, late, smooth = measured
    made = advance(now, aimed, seen, t, length, loop.method, loop.stage)
    lost, drives = state.lost, state.drives
    moved = made.q if seen is q else chart.moved(law.chain, q, chart.between(law.chain, seen, made.q))
    if loop.model is not None and drives is not None:
        drives = driven(law.chain, loop.drive, loop.model, drives, seen, chart.between(law.chain, seen, made.q), Ts)
        moved, drives = reached(law.chain, q, drives)
    elif lost is not None:
        moved, lost = summed(law.chain, q, length * made.qdot, lost, law)
    after = State(moved, lost, drives, late, smooth)
    if drives is not None or seen is not q:
        made = replace(made, qdot=1 / Ts * chart.between(law.chain, q, moved))
    if at is not None:
        made = replace(made, x=at.x(), e=at.e)
    return after, replace(made, q=q)


def _measured(loop, state, t, k):
    """(joint values the controller uses, its reference then, the true observation, errors still on their way, the
    filtered error or None)"""
    law, reference, q = loop.law, loop.reference, state.q
    at, commanded = observe(loop.truth, reference, t, q), loop.drive.feedback == "commanded"
    seen = state.drives.sent if commanded else q
    # A camera sees the real tip; from its own commands a controller knows only the model's tip.
    found = at.e if seen is q else observe(law if commanded else loop.truth, reference, t, seen).e
    measured = (found, *state.late)[loop.late]
    if loop.noise is not None:
        measured = measured + loop.noise[k.astype(int)]
    smooth = None if state.smooth is None else averaged(loop.drive.kept(loop.Ts), state.smooth, measured)
    exact = loop.noise is None and loop.plant is None and not loop.late and smooth is None
    if not exact:
        believed = observe(law, reference, t, seen)
        reference = shifted(reference, law.task, _between(law.task, measured if smooth is None else smooth, believed))
    return seen, reference, at, (found, *state.late)[: loop.late], smooth


def _between(task, measured, at):
    """The shift w of the targets that turns the error of `at` into the measured error (m,)."""
    parts = zip(task.parts, at.aims, task.slices, strict=True)
    return jnp.concatenate([p.between(at.robot, aim, measured[where], at.e[where]) for p, aim, where in parts])


def run(loop: Loop, q0, *, end=False):
    """The `Trajectory` of a loop from rest at q0 (n,). Pure. Args: end: (q, x, e) of the last instant alone."""
    k, m = jnp.arange(loop.N + 1).astype(q0.dtype), loop.law.task.m
    single = q0.dtype == jnp.float32 and not loop.measured
    state, none, empty = start(loop, q0, compensated=single), jnp.zeros_like(q0), jnp.zeros(m, q0.dtype)
    step = functools.partial(one, loop)
    step = step if loop.measured else checkpointed(step)

    def with_last(carry, k):
        after, made = step(carry[0], k)
        return (after, (made.q, made.x, made.e)), made

    (_, last), steps = jax.lax.scan(with_last, (state, (none, empty, empty)), k)
    if end:
        return last
    cost = loop.N * evaluations_per_step(loop.method, loop.stage, loop.law.chain.n)
    tasks = tuple((name, at.start, at.stop) for name, at in loop.law.task.each)
    made = assemble(loop.t0 + k * loop.Ts, steps, last, cost, tasks)
    if loop.measured:  # with noise an error grows and shrinks at random
        return made
    grown, each = growing(loop.law, loop.reference, made.t, made.e)
    if made.task_status is not None:
        made = replace(made, task_status=made.task_status | each)
    return replace(made, status=made.status | grown)


# --- one step of the loop with any method -------------------------------------------------------------


@record
class Step:
    """One step of the loop: the fields of a `Trajectory` without the time axis.

    Attributes:
      q: (n,) joint values after the step [rad, m].
      x: (m,) task coordinates before it [m, rad].
      e: (m,) error before it, x_d − x [m, rad].
      qdot: (n,) constant joint velocity during it [rad/s, m/s].
      residual: last change of the implicit stage, as a joint displacement; 0 for explicit methods.
      contraction: ratio of the last two changes; at 1 or more the iteration diverges.
      least: least singular value of the task Jacobian before it, an estimate from below; in a stack the least of its
        tasks.
      status: bits of `Status`.
      task_status: (tasks,) bits that each task of a stack has alone; None without a stack.
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
    task_status: Int[Array, " tasks"] | None = None
    walls: Float[Array, " k"] | None = None


def advance(law: Law, reference, q, t, Ts, method, stage) -> Step:
    """Make one step of the loop, of a law whose chain is a `Model`."""
    known = reference if reference.known else tangent(reference, law.task, t)
    at = observe(law, known, t, q)
    if method.exponential:
        made = exponential_march(law, known, q, at, t, Ts, method, stage)
    else:
        made = _of_tableau(law, known, q, at, t, Ts, method, stage)
    if law.limits is not None:
        after, qdot = within(law, centre(law.chain, q), made.qdot, Ts)
        made = made._replace(q=after, qdot=qdot)
    made = made._replace(q=out(law.chain, q, made.q))
    status = flags(law, made.q, made.qdot, made.first.e, made.residual, stage.tolerance, made.first)
    return Step(
        q=made.q,
        x=made.first.x(),
        e=made.first.e,
        qdot=made.qdot,
        residual=made.residual,
        contraction=made.contraction,
        least=jnp.min(made.first.least),
        status=status,
        task_status=task_flags(law, made.first),
        walls=made.first.walls,
    )


def summed(chain, q, step, lost, law):
    """q + step within the law's position limits, and the rounding error of the sum, to be added with the next step
    (Kahan 1965). `lost`: that of the last step. Rotations have no rounding error to carry.

    In single precision, steps below half a spacing of q would otherwise be lost: the loop would stop short of its
    target by ulp(q)/2/(alpha·Ts). The rounding error has no derivatives.
    """
    step, y = step + lost, centre(chain, q)
    after = inside(law, y, y + step)
    return out(chain, q, after), jax.lax.stop_gradient(step - (after - y))


def _of_tableau(law, reference, q, at, t, Ts, method, stage):
    """Make a step of a tableau over the law's field, from its observation at q and t."""

    def field(c, q):
        return evaluate(law, reference, t if type(c) is float and c == 0 else t + c * Ts, q)

    field, y = charted(law.chain, q, field), centre(law.chain, q)
    return march(field, y, Ts, method, stage, evaluate_at(law, q, at))
