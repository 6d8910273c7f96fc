"""Advance: one step of the loop with any method."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cnclik.integrate.history import Begun, History, Stepped, mark, over_history
from cnclik.integrate.march import charted, exponential_march, march
from cnclik.integrate.method import starter
from cnclik.integrate.status import Status, flags, task_flags
from cnclik.law.law import Law, evaluate, evaluate_at, observe
from cnclik.law.limits import inside, within
from cnclik.law.reference import tangent
from cnclik.record import Array, Float, Int, record
from cnclik.robot.chart import centre, out


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
      history: memory of a multistep method for its next step; None for one-step methods.
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
    history: History | None = None


def advance(law: Law, reference, q, t, Ts, method, stage, history=None, *, starting=False) -> Step:
    """One step of the loop, of a law whose chain is a `Model`.

    Args:
      history: of a multistep method, see `cnclik.integrate.history.blank`; None for others.
      starting: whether a multistep method makes a step of its `starter`, which it remembers.
    """
    known = reference if reference.known else tangent(reference, law.task, t)
    at, begun = observe(law, known, t, q), None
    if method.steps == 1 or starting:
        made_with = starter(method) if starting else method
        # A loop over the stages compiles several times faster, but runs 15 to 25 % slower.
        looped = starting or not (made_with.implicit or len(made_with.b) < 3)
        looped = looped and made_with.c[0] == 0
        begun = _of_tableau(law, known, q, at, t, Ts, made_with, stage, looped=looped)
    if begun is not None and method.steps == 1:
        one = Stepped(begun.moved)
    else:
        one = over_history(law, known, q, at, mark(law, reference, at, t), t, Ts, method, history, begun)
    made = one.moved
    if law.limits is not None:
        after, qdot = within(law, centre(law.chain, q), made.qdot, Ts)
        made = made._replace(q=after, qdot=qdot)
    made = made._replace(q=out(law.chain, q, made.q))
    status = flags(law, made.q, made.qdot, made.first.e, made.residual, stage.tolerance, made.first)
    if one.restarted is not None:
        status |= jnp.where(one.restarted, int(Status.RESTARTED), 0)
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
        history=one.history,
    )


def summed(chain, q, step, lost, law=None):
    """q + step, and the rounding error of the sum, to be added with the next step (Kahan 1965). `lost`: that of the
    last step. With a law, within its position limits. Rotations have no rounding error to carry.

    In single precision, steps below half a spacing of q would otherwise be lost: the loop would stop short of its
    target by ulp(q)/2/(alpha·Ts). The rounding error has no derivatives.
    """
    step, y = step + lost, centre(chain, q)
    after = y + step if law is None else inside(law, y, y + step)
    return out(chain, q, after), jax.lax.stop_gradient(step - (after - y))


def _of_tableau(law, reference, q, at, t, Ts, method, stage, *, looped) -> Begun:
    """A step of a tableau, from the law's observation at q and t."""
    if method.exponential:
        return Begun(*exponential_march(law, reference, q, at, t, Ts, method, stage, looped=looped))

    def field(c, q):
        return evaluate(law, reference, t if type(c) is float and c == 0 else t + c * Ts, q)

    field, y = charted(law.chain, q, field), centre(law.chain, q)
    return Begun(march(field, y, Ts, method, stage, evaluate_at(law, q, at), looped=looped))
