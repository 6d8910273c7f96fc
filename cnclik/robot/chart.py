"""Charts: how a robot with a free base, or another floating joint, moves in time.

Its q is one flat vector (n,): of a floating joint x, y, z [m] and the rotation vector w [rad], R = exp([w]×), ‖w‖ ≤ π.
Its velocity q̇ (n,) is a twist: the velocity ṗ of the joint's frame along the axes of the frame that carries it (of a
base the world's), and its angular velocity ω in its own axes, Ṙ = R [ω]×. It is no derivative of w, so q is not
integrated itself. Each step works in a chart centred where it begins, at q₀ (Munthe-Kaas 1999; Iserles, Munthe-Kaas,
Nørsett & Zanna 2000, Section 4): y is q, but with rotations counted from there,

  R = R₀ exp([d]×),   y = (p, d, joints),   at the centre d = 0,
  ḋ = dexp⁻¹(ω) = ω + ½ d × ω + c(‖d‖²) d × (d × ω),   c(x) = 1/12 + x/720 + x²/30240 + …,

in which a method moves by sums, as it does elsewhere; what it ends at becomes q by w = log(exp(w₀) exp(d)). At the
centre ḋ = ω, so Jacobians of functions of q are taken there. Of a robot without such joints y is q itself: nothing is
computed, and programs are those of a world without charts.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np

from cnclik.robot.rotations import log_quaternion, quaternion

TERMS = 12  # of c: to rounding below 1.2 rad, 1e-8 at π, and finite beyond
_C = [2 * sum(n ** (-2.0 * k) for n in range(1, 200)) / (2 * math.pi) ** (2 * k) for k in range(2, TERMS)]


def centre(chain, q):
    """y (n,) of q (n,) in the chart that is centred there."""
    return _each(chain, q, lambda at: 0.0 * q[at])


def into(chain, start, q):
    """y (n,) of q (n,) in the chart centred at `start` (n,)."""
    return _each(chain, q, lambda at: joined(-start[at], q[at]))


def out(chain, start, y):
    """q (n,) of y (n,) in the chart centred at `start` (n,)."""
    return _each(chain, y, lambda at: joined(start[at], y[at]))


def rates(chain, y, qdot):
    """ẏ (n,) of a robot that is at y and moves by q̇."""
    return _each(chain, qdot, lambda at: _dexp_inverse(y[at], qdot[at]))


def between(chain, start, q):
    """The displacement (n,) that leads from one posture to another: q − start, rotations by log(R₀ᵀ R)."""
    return into(chain, start, q) - centre(chain, start)


def apart(chain, starts, several):
    """The same (..., n) of many postures, and of one or as many starts."""
    if not chain.balls:
        return several - starts
    starts = jnp.broadcast_to(jnp.asarray(starts), np.shape(several))
    return jnp.vectorize(functools.partial(between, chain), signature="(n),(n)->(n)")(starts, jnp.asarray(several))


def moved(chain, q, step):
    """The posture (n,) that a displacement leads to."""
    return out(chain, q, centre(chain, q) + step)


def _each(chain, vector, fn):
    """The vector with the three entries of each rotation as `fn` of their places says."""
    for _, i in chain.balls:
        vector = jnp.concatenate([vector[:i], fn(slice(i, i + 3)), vector[i + 3 :]])
    return vector


def joined(a, b):
    """log(exp(a) exp(b)) of rotation vectors (3,), of length at most π."""
    (wa, va), (wb, vb) = quaternion(a), quaternion(b)
    w, v = wa * wb - va @ vb, wa * vb + wb * va + jnp.cross(va, vb)
    sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)  # the shorter way
    return log_quaternion(sign * w, sign * v)


def _dexp_inverse(d, w):
    squared, c, once = d @ d, 0.0, jnp.cross(d, w)
    for k in _C[::-1]:
        c = k + squared * c
    return w + 0.5 * once + (1 / 12 + squared * c) * jnp.cross(d, once)
