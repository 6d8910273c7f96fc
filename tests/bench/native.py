"""`python -m tests.bench.native`: functions without robots in them, inside a user's own jit, plain and as C (a minute).

docs/how-fast.md shows the table. On one core, by CPU time, in turn, the least of several rounds.
"""

import functools
import time

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from tests.bench import timing

LANES, ROUNDS = 4096, 15
LINKS = np.array([0.5, 0.4, 0.3], np.float32)


def tip(q):
    """Where a chain of three links ends."""
    angles = jnp.cumsum(q)
    return jnp.stack([LINKS @ jnp.cos(angles), LINKS @ jnp.sin(angles)])


def chain(q, _):
    """Joints of the chain after 50 steps of damped least squares."""

    def closer(q, _):
        J = jax.jacfwd(tip)(q)
        return q + 0.01 * J.T @ jnp.linalg.solve(J @ J.T + 0.01 * jnp.eye(2), jnp.ones(2)), None

    return jax.lax.scan(closer, q[:3], length=50)[0]


def swing(state, lengths):
    """A double pendulum after half a second: 200 steps of the midpoint method. state: two angles, two velocities."""

    def slope(s):
        a, b, u, v = s
        c, d = jnp.cos(a - b), jnp.sin(a - b)
        mass = jnp.array([[2 * lengths[0], lengths[1] * c], [lengths[0] * c, lengths[1]]])
        force = d * jnp.array([-lengths[1] * v**2, lengths[0] * u**2]) - 9.81 * jnp.array([2, 1]) * jnp.sin(s[:2])
        return jnp.concatenate([s[2:], jnp.linalg.solve(mass, force)])

    def step(s, _):
        return s + 0.0025 * slope(s + 0.00125 * slope(s)), None

    return jax.lax.scan(step, state, length=200)[0]


def height(fn):
    """How high the lower mass swings, as a function to be differentiated by the lengths."""
    return lambda lengths, state: -jnp.dot(lengths, jnp.cos(fn(state, lengths)[:2]))


def value(fn):
    """Of all pendulums."""
    return jax.jit(jax.vmap(fn, (0, None)))


def gradient(fn):
    """Of all pendulums."""
    return jax.jit(lambda states, lengths: jax.vmap(jax.grad(height(fn)), (None, 0))(lengths, states))


PROGRAMS = {
    "chain × 50 steps": (value, chain),
    "value": (value, swing),
    "gradient by the lengths": (gradient, swing),
}


def main():
    """Print the table."""
    states = np.random.default_rng(0).normal(size=(LANES, 4)).astype(np.float32)
    lengths = np.array([1.0, 0.7], np.float32)
    print(f"| {LANES:,}; pendulums × 200 steps | jit(vmap) [ms] | with `ck.native` [ms] | ratio | first calls [s] |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for name, (make, fn) in PROGRAMS.items():
        runs, first, best = [make(fn), make(ck.native(fn))], [], [np.inf] * 2
        for run in runs:
            begun = time.perf_counter()
            jax.block_until_ready(run(states, lengths))
            first.append(time.perf_counter() - begun)
        for _ in range(ROUNDS):
            for k, run in enumerate(runs):
                best[k] = min(best[k], timing.cpu(functools.partial(run, states, lengths)))
        a, b = (1e3 * t for t in best)
        print(f"| {name} | {a:.1f} | {b:.2f} | {a / b:.0f} | {first[0]:.1f}, {first[1]:.1f} |")


if __name__ == "__main__":
    timing.one_core()
    main()
