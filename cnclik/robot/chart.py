"""Charts: how a robot with a free base, or another floating joint, moves in time.

A floating joint has x, y, z [m] and the rotation vector w [rad], R = exp([w]×), ‖w‖ ≤ π. Its velocity is a twist: ṗ of
the joint's frame along the axes of the frame that carries it, and ω in its own axes, Ṙ = R [ω]×. So each step works in
a chart centred at its start q₀ (Munthe-Kaas 1999; Iserles, Munthe-Kaas, Nørsett & Zanna 2000, Section 4),

  R = R₀ exp([d]×),   y = (p, d, joints),   at the centre d = 0,
  ḋ = dexp⁻¹(ω) = ω + ½ d × ω + c(‖d‖²) d × (d × ω),   c(x) = 1/12 + x/720 + x²/30240 + …,

where a method adds vectors as usual. At the centre ḋ = ω. For a robot without such joints y is q.
"""

import jax.numpy as jnp

from cnclik.robot.rotations import log_quaternion, quaternion

_C = (  # of c: |B₂ₖ|/(2k)! for k = 2, 3, …; exact to rounding below 1.2 rad, to 1e-8 at π, and finite beyond
    *(1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600),
    *(3617 / 10670622842880000, 43867 / 5109094217170944000, 174611 / 802857662698291200000),
    77683 / 14101100039391805440000,
)


def centre(chain, q):
    """Return y (n,) of q (n,) in the chart centred there."""
    return _each(chain, q, lambda at: 0.0 * q[at])


def into(chain, start, q):
    """Return y (n,) of q (n,) in the chart centred at `start` (n,)."""
    return _each(chain, q, lambda at: _joined(-start[at], q[at]))


def out(chain, start, y):
    """Return q (n,) of y (n,) in the chart centred at `start` (n,)."""
    return _each(chain, y, lambda at: _joined(start[at], y[at]))


def rates(chain, y, qdot):
    """Return ẏ (n,) of a robot at y with the velocity q̇."""
    return _each(chain, qdot, lambda at: _dexp_inverse(y[at], qdot[at]))


def between(chain, start, q):
    """Return the displacement (n,) from one posture to another: q − start, with log(R₀ᵀ R) for rotations."""
    return into(chain, start, q) - centre(chain, start)


def moved(chain, q, step):
    """Return the posture (n,) after a displacement."""
    return out(chain, q, centre(chain, q) + step)


def _each(chain, vector, fn):
    """Return the vector with the entries of each rotation replaced by `fn` of their indices."""
    for _, i in chain.balls:
        vector = jnp.concatenate([vector[:i], fn(slice(i, i + 3)), vector[i + 3 :]])
    return vector


def _joined(a, b):
    """Return log(exp(a) exp(b)) of rotation vectors (3,), of length at most π."""
    (wa, va), (wb, vb) = quaternion(a), quaternion(b)
    w, v = wa * wb - va @ vb, wa * vb + wb * va + jnp.cross(va, vb)
    sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)  # the shorter rotation
    return log_quaternion(sign * w, sign * v)


def _dexp_inverse(d, w):
    squared, c, once = d @ d, 0.0, jnp.cross(d, w)
    for k in _C[::-1]:
        c = k + squared * c
    return w + 0.5 * once + (1 / 12 + squared * c) * jnp.cross(d, once)
