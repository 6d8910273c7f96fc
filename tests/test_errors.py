"""One grammar for every message; values are looked at only where they are known, and where they must be it is said."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik import errors
from cnclik import stability as st
from cnclik.errors import ArgumentError
from tests.refusals import refusals

test_messages = refusals(
    (lambda: errors.number("x", -0.1, positive=True), "be positive, but is -0.1."),
    (lambda: errors.number("x", float("nan")), "be finite, but is nan."),
    (lambda: errors.number("x", "fast"), "be a number, but is 'fast'."),
    (lambda: errors.number("x", [[1], []]), "be a number, but is [[1], []]."),
    (lambda: errors.number("x", 10**400), f"be a number, but is 1{'0' * 115}…."),
    (lambda: errors.integer("x", 3.0, at_least=0), "be an integer, but is 3.0."),
    (lambda: errors.integer("x", 10, at_least=0, at_most=9), "be at most 9, but is 10."),
    (lambda: errors.array("x", [1, 2], (3,)), "have 3 numbers, but has 2."),
    (lambda: errors.array("x", np.ones((2, 3)), (), (2, 2)), "have shape () or (2, 2), but has shape (2, 3)."),
    (lambda: errors.array("x", [0, np.nan]), "be finite, but is nan at index (1,)."),
    (lambda: errors.one_of("x", "RK5", ["EE", "RK4"]), "be one of EE, RK4, but is 'RK5' (did you mean 'RK4'?)."),
)


def test_what_is_no_real_number():
    for bad in (np.ones(2, complex), np.ones(2, bool), np.array(["a"]), "5", ["1", "2"], [True, False], [None], [1j]):
        with pytest.raises(ArgumentError, match="real numbers"):
            errors.array("q", bad)


@pytest.mark.parametrize("dtype", [">f8", ">f4", np.longdouble, "i2"])
def test_numbers_of_any_byte_order_and_size_are_what_jax_takes(dtype):
    found = errors.array("q", np.array([1.0, 2.0], dtype))
    assert jnp.asarray(found).tolist() == [1.0, 2.0] and found.dtype == np.float64
    gaps = np.ma.array([1.0, 2.0], mask=[False, True])
    np.testing.assert_array_equal(errors.array("q", gaps, finite=False), [1.0, np.nan])


def test_traced_values_are_checked_by_shape_alone():
    @jax.jit
    def fn(x):
        errors.number("Ts", x, positive=True)
        return errors.array("q", [x, 1.0], (2,)) + errors.array("r", jnp.stack([x, x]), (2,))

    np.testing.assert_array_equal(fn(-1.0), [-2, 0])
    assert np.isnan(fn(jnp.nan)[0])
    with pytest.raises(ArgumentError, match="must have 3 numbers, but has 1"):
        jax.jit(lambda x: errors.array("q", x[None], (3,)))(1.0)


def test_a_message_is_one_short_line_whatever_it_speaks_of():
    for error in (errors.fail("n" * 10**6, "be", "is\n\x1b[31m"), ArgumentError("a\nb \x1b[2J" + "c" * 10**6)):
        said = str(error)
        assert len(said) <= 800 and said.isprintable() and "\\x1b" in said


EVERY = ["EE", "HEUN", "RK4", "MIDPOINT", "EXP-MIDPOINT"]


@pytest.mark.parametrize(
    ("written", "names", "meant"),
    [("ee", EVERY, "EE"), ("Heunn", EVERY, "HEUN"), ("exp_midpoint", EVERY, "EXP-MIDPOINT"), ("rk-4", EVERY, "RK4"),
     ("name", ["question", "axes", "fixed"], ""), ("euler", EVERY, "EE"), ("euler", ["base", "euler_"], "euler_")],
)  # fmt: skip
def test_the_name_that_was_meant(written, names, meant):
    """Whatever its letters' size, by the field's words for a method, and none that is not near."""
    assert errors.nearest(written, names) == (f" (did you mean {meant!r}?)" if meant else "")


def test_numbers_of_numpy_are_written_as_numbers_and_a_text_as_it_is():
    for found, said in (([np.float64(0.1), np.int32(3)], "[0.1, 3]"), ("np.float64(1.5) mm", "'np.float64(1.5) mm'")):
        assert str(errors.fail("alpha", "be a list", f"is {found!r}")).endswith(f"is {said}.")


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
