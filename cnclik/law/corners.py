"""Corners: where the velocity of a path jumps, found before the path is run."""

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.law.curves import Hold, Path, interval
from cnclik.law.reference import Reference, sample
from cnclik.law.task import Task
from cnclik.record import record

ABRUPT = 4.0  # a change of velocity from instant to instant this many times the middle one of five is a jump
SHARP = 0.02  # and this part of the velocity
_HALVINGS = 24  # of a step, to say when it jumps


@record
class Corners:
    """The corners of a path between N + 1 instants.

    Attributes:
      t: (N + 1,) the instants.
      time: (N + 1,) the last instant before the jump in each step, inf where there is none, and at the end.
      sharpness: (N + 1,) change of velocity over the larger of those before and after.
      next: (N + 1,) index of the first corner from each instant on.
    """

    t: jax.Array
    time: jax.Array
    sharpness: jax.Array
    next: jax.Array

    def after(self, t):
        """(time until the next corner, its sharpness) at t."""
        k = interval(self.t, t)
        at = self.next[k]
        at = jnp.where(self.time[at] < t, self.next[k + 1], at)
        return jnp.where(self.time[at] < t, jnp.inf, self.time[at] - t), self.sharpness[at]


def corners(reference: Reference, task: Task, t) -> Corners | None:
    """Corners of a path between the instants t (N + 1,), N > 1: jumps of the velocity that a controller is told.

    None of a target that stands still.
    """
    if isinstance(reference.curve, Hold):
        return None
    reference, t = lax.stop_gradient((reference, t))

    def velocity(t):
        return sample(reference, task, t)[2]

    def velocities(t):  # a user's own function may do what can't be done to many instants at once
        return lax.map(velocity, t) if isinstance(reference.curve, Path) else jax.vmap(velocity)(t)

    def size(w):
        return jnp.sqrt(jnp.sum(w * w, axis=-1))

    w = velocities(t)
    change, larger = size(w[1:] - w[:-1]), jnp.maximum(size(w[1:]), size(w[:-1]))
    padded = jnp.concatenate([change[:1], change[:1], change, change[-1:], change[-1:]])
    # Of five, as a corner at an instant may show on both sides of it.
    beside = jnp.median(jnp.stack([padded[i : i + change.shape[0]] for i in range(5)]), axis=0)
    jumps = (change > ABRUPT * beside) & (change > SHARP * larger)

    def halve(_, ends):
        low, high = ends
        middle = 0.5 * (low + high)
        at = velocities(middle)
        before = size(at - w[:-1]) <= size(at - w[1:])
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    found, _ = lax.fori_loop(0, _HALVINGS, halve, (t[:-1], t[1:]))
    count = t.shape[0] - 1
    index = jnp.append(jnp.where(jumps, jnp.arange(count), count), count)
    return Corners(
        t=t,
        time=jnp.append(jnp.where(jumps, found, jnp.inf), jnp.inf),
        sharpness=jnp.append(change / jnp.where(larger > 0, larger, 1.0), 1.0),
        next=lax.cummin(index, reverse=True),
    )
