"""Corners: where the velocity of a path jumps, found before the run."""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.law.curves import interval
from cnclik.law.reference import of_each_instant, sample
from cnclik.record import record
from cnclik.task.task import Task

ABRUPT = 4.0  # factor over the median of five velocity changes that makes a change a jump
SHARP = 0.02  # and the smallest jump as a share of the velocity
_HALVINGS = 24  # halvings of a step, to find when it jumps


@record
class Corners:
    """The corners of a path between N + 1 instants."""

    t: jax.Array  # (N + 1,) the instants
    time: jax.Array  # (N + 1,) the last instant before the jump in each step, inf if there is none, and at the end
    sharpness: jax.Array  # (N + 1,) change of velocity over the larger of those before and after
    next: jax.Array  # (N + 1,) index of the first corner from each instant on

    def after(self, t):
        """(time until the next corner, its sharpness) at t."""
        k = interval(self.t, t)
        at = self.next[k]
        at = jnp.where(self.time[at] < t, self.next[k + 1], at)
        return jnp.where(self.time[at] < t, jnp.inf, self.time[at] - t), self.sharpness[at]


def corners(reference, task: Task, t) -> Corners | None:
    """Corners of a path between the instants t (N + 1,), N > 1: jumps of the velocity that a controller gets.

    None of a target that stands still.
    """
    if reference.still:
        return None
    reference, t = lax.stop_gradient((reference, t))
    each, N = functools.partial(of_each_instant, reference=reference, task=task), t.shape[0] - 1

    def velocity(t):
        return sample(reference, task, t)[1]

    def size(w):
        return jnp.sqrt(jnp.sum(w * w, axis=-1))

    w = each(velocity, t)
    change = each(lambda k: size(w[k + 1] - w[k]), jnp.arange(N))

    def corner(k):
        """Of the step from instant k on: (time of its jump or inf, how sharp it is, k or N)."""
        before, after = w[k], w[k + 1]
        larger = jnp.maximum(size(before), size(after))
        # Of five, as a corner at an instant may affect both sides.
        beside = jnp.median(jnp.stack([change[jnp.clip(k + i, 0, N - 1)] for i in range(-2, 3)]))
        jumps = (change[k] > ABRUPT * beside) & (change[k] > SHARP * larger)

        def halve(_, ends):
            low, high = ends
            middle = 0.5 * (low + high)
            at = velocity(middle)
            first = size(at - before) <= size(at - after)
            return jnp.where(first, middle, low), jnp.where(first, high, middle)

        found, _ = lax.fori_loop(0, _HALVINGS, halve, (t[k], t[k + 1]))
        sharpness = change[k] / jnp.where(larger > 0, larger, 1.0)
        return jnp.where(jumps, found, jnp.inf), sharpness, jnp.where(jumps, k, N)

    time, sharpness, index = each(corner, jnp.arange(N))
    return Corners(
        t=t,
        time=jnp.append(time, jnp.inf),
        sharpness=jnp.append(sharpness, 1.0),
        next=lax.cummin(jnp.append(index, N), reverse=True),
    )
