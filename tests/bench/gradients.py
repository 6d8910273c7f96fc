"""`python -m tests.bench.gradients`: a loss of 20 steps of a Panda's pose loop, and its gradients, beside JAX's own.

The same loop with the kinematics of frax, of jaxlie and of a textbook under `jit(vmap)`. The loss is ‖e‖² at the end;
forward gradients are in one direction, reverse ones by all seven joint values and the target's position. All agree
first; then CPU times of one core in turn, medians, float64. frax and jaxlie are needed. Three minutes.
"""

import functools
import statistics

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from tests.bench import cases, textbook, timing
from tests.bench.cases import panda_matrices

BATCH, STEPS, ROUNDS = 4096, 20, 5


def ours():
    law = cases.case().law

    def loss(q, position, rotation):
        e = cases.end(law, ck.hold(position, rotation), q, cases.TS, STEPS)[1]
        return e @ e

    return loss


def with_jax(pose_and_jacobian):
    def loss(q, position, rotation):
        def step(q, _):
            how = dict(alpha=cases.ALPHA, damping=cases.DAMPING, Ts=cases.TS)
            return textbook.step(pose_and_jacobian, q, position, rotation, **how), None

        q = jax.lax.scan(step, q, None, length=STEPS)[0]
        e = textbook.error(pose_and_jacobian(q)[0], position, rotation)
        return e @ e

    return loss


def of_frax():
    from frax.assets import FRANKA_ASSETS_DIR
    from frax.core.manipulator import Manipulator

    robot = Manipulator(FRANKA_ASSETS_DIR / "panda.urdf", ee_offset=panda_matrices()[1])
    return lambda q: robot.velocity_control_matrices(q)[::-1]


def of_jaxlie():
    import jaxlie

    origins, tip = panda_matrices()
    before, after = [jaxlie.SE3.from_matrix(origin) for origin in origins], jaxlie.SE3.from_matrix(tip)

    def at(q):
        pose, frames = jaxlie.SE3.identity(), []
        for origin, angle in zip(before, q, strict=True):
            pose = pose @ origin @ jaxlie.SE3.from_rotation(jaxlie.SO3.from_z_radians(angle))
            frames.append(pose.as_matrix())
        pose = (pose @ after).as_matrix()
        return pose, textbook.geometric_jacobian(jnp.stack(frames), pose)

    return at


def main():
    jax.config.update("jax_enable_x64", True)
    given = tuple(cases.inputs(cases.case(), BATCH, "float64").values())
    losses = {
        "cnclik": ours(),
        "frax": with_jax(of_frax()),
        "jaxlie": with_jax(of_jaxlie()),
        "textbook": with_jax(textbook.panda(*panda_matrices())),
    }
    kinds = {
        "value": lambda fn: fn,
        "forward": lambda fn: lambda *x: jax.jvp(lambda q: fn(q, *x[1:]), x[:1], (jnp.ones_like(x[0]),)),
        "reverse": lambda fn: jax.value_and_grad(fn, (0, 1)),
    }
    for kind, derived in kinds.items():
        calls = {}
        for name, loss in losses.items():
            fn = derived(loss)
            calls[name] = ck.lanes(fn, cores=1) if name == "cnclik" else jax.jit(jax.vmap(fn))
        wanted, *others = (jax.tree.map(np.asarray, call(*given)) for call in calls.values())
        off = jax.tree.map(lambda *x: max(np.abs(x[0] - one).max() for one in x[1:]), wanted, *others)
        assert max(jax.tree.leaves(off)) < 1e-6, off
        runs = {name: functools.partial(call, *given) for name, call in calls.items()}
        seconds = timing.in_turn(runs, ROUNDS, least=0.2)
        for name, each in seconds.items():
            ratio = timing.ratio(each, seconds["cnclik"])
            micro = 1e6 * statistics.median(each) / BATCH
            print(f"{kind:<10}{name:<10}{micro:8.2f} µs a loss {ratio:7.1f} times cnclik's")


if __name__ == "__main__":
    timing.one_core()
    main()
