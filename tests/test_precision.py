"""What decides by numbers says in one line that it was called inside jit, vmap or grad, and computes in float64."""

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik import stability as st
from tests.refusals import refusals

ARM = ck.planar_arm([1.0, 0.8])
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
Q, GOAL, TS = np.array([0.3, 1.1]), ck.hold([1.0, 0.7]), 0.1


def run(q):
    return ck.solve(LAW, GOAL, q, TS, 3)


def law(x):
    return ck.replace(LAW, alpha=x[0])


DOORS = {  # what is traced of each, and how it is called
    ("gains", "Ts"): lambda x: st.gains(Ts=x[0]),
    ("gains", "drive"): lambda x: st.gains(Ts=TS, drive=ck.Drive(lag=x)),
    ("advise", "law"): lambda x: st.advise(law(x), Ts=TS),
    ("advise", "Ts"): lambda x: st.advise(LAW, Ts=x[0]),
    ("advise", "drive"): lambda x: st.advise(LAW, Ts=TS, drive=ck.Drive(lag=x[0])),
    ("verdict", "run"): lambda x: st.verdict(LAW, GOAL, run(x)),
    ("verdict", "law"): lambda x: st.verdict(law(x), GOAL, run(Q)),
    ("stability_map", "q0"): lambda x: st.stability_map(LAW, GOAL, x, alpha=[1.0, 2.0], Ts=TS),
    ("diagnose", "signal"): lambda x: ck.diagnose(jnp.tile(x, 20), TS),
    ("fit_drive", "command"): lambda x: ck.fit_drive(None, jnp.tile(x, 20), jnp.tile(x, 20), TS),
    ("tune", "q0"): lambda x: ck.tune(LAW, GOAL, x, Ts=TS, N=3),
    ("tune", "bounds"): lambda x: ck.tune(LAW, GOAL, Q, Ts=TS, N=3, bounds={"alpha": (x[0], x[1])}),
    ("sweep", "alpha"): lambda x: ck.sweep(lambda alpha: {"a": alpha}, alpha=x),
    ("to_dataset", "run"): lambda x: ck.measure.to_dataset(run(x), LAW),
    ("require_ok", "run"): lambda x: ck.require_ok(run(x)),
    ("plot", "run"): lambda x: ck.plot(run(x), LAW),
    ("reach", "tolerance"): lambda x: ck.reach(ARM, [1.0, 0.5, 0.0], task="position", tolerance=x),
}


test_what_decides_by_numbers_names_what_is_traced = refusals(
    *(
        (
            lambda fn=fn: jax.eval_shape(fn, Q),
            f"`{name}` must hold numbers, but is traced by JAX: call {door} outside of",
        )
        for (door, name), fn in DOORS.items()
    )
)
