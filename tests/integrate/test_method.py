"""Implicit Euler by diffrax; tableaus: what one may leave out, what is none. All methods are in test_combinations."""

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from tests.bank import screws
from tests.oracles import close
from tests.refusals import refusals

# J = 1: one step shrinks the error by R(z), exactly.
SLIDER = screws([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], [0.0, 0.0, 0.0], kinds="P")
SLIDE = ck.Law(SLIDER, ck.position("x"), alpha=1.0)
LENGTHS, START = np.array([0.7, 1.1, 0.4]), np.array([0.3, -0.9, 0.6])
FIGURE = ck.lissajous([0.4, 1.2], [0.3, 0.2], period=np.pi, phase=[0.0, 0.5])


def closed_form(t, q, alpha):
    """A 3-joint arm on a Lissajous figure, written without cnclik: tip by sums, J by jacfwd, J# by jnp.linalg."""

    def tip(q):
        phi = jnp.cumsum(q)
        return jnp.array([-jnp.sum(LENGTHS * jnp.sin(phi)), jnp.sum(LENGTHS * jnp.cos(phi))])

    target = lambda t: jnp.array([0.3 * jnp.sin(2 * t) + 0.4, 0.2 * jnp.sin(4 * t + 0.5) + 1.2])  # noqa: E731
    x_d, xdot_d = jax.jvp(target, (t,), (jnp.ones_like(t),))
    return jnp.linalg.pinv(jax.jacfwd(tip)(q)) @ (xdot_d + alpha * (x_d - tip(q)))


def test_against_diffrax():
    """Implicit Euler by its own Newton's method."""
    import diffrax  # a second, of all workers, if it is at the top
    import optimistix

    law = ck.Law(ck.planar_arm(LENGTHS.tolist()), ck.position("xy"), alpha=4.0)
    run = ck.solve(law, FIGURE, START, 0.05, 20, "IE", ck.picard(40))
    solver = diffrax.ImplicitEuler(root_finder=optimistix.Newton(rtol=1e-12, atol=1e-12))
    wanted = diffrax.diffeqsolve(
        *(diffrax.ODETerm(closed_form), solver, 0.0, 1.0, 0.05, jnp.asarray(START)),
        args=jnp.asarray(4.0),
        saveat=diffrax.SaveAt(t0=True, steps=True),
        stepsize_controller=diffrax.ConstantStepSize(),
        max_steps=21,
    )
    close(run.q, wanted.ys[:21], atol=1e-11)
    close(run.t, wanted.ts[:21], atol=1e-14)


KUTTA = dict(
    name="KUTTA3", A=[[], [0.5], [-1, 2]], b=[1 / 6, 2 / 3, 1 / 6], c=[0, 0.5, 1], order=3, source="Kutta 1901"
)


def test_an_explicit_tableau_may_leave_out_its_diagonal():
    """Rows as they are printed for explicit methods, of integers too."""
    short = ck.Method(**KUTTA)
    whole = ck.Method(**KUTTA | dict(A=((0.0,), (0.5, 0.0), (-1.0, 2.0, 0.0))))
    assert short == whole and hash(short) == hash(whole) and not short.implicit
    run = ck.solve(SLIDE, ck.hold([1.0]), np.zeros(1), 0.5, 2, short)
    close(1 - run.q[1:, 0], [1 - 0.5 + 0.125 - 0.125 / 6, (1 - 0.5 + 0.125 - 0.125 / 6) ** 2], atol=1e-14)


TWO = dict(A=((0.0,), (0.5, 0.0)), b=(0.0, 1.0), c=(0.0, 0.5), order=2)


def own(**changed):
    return ck.Method(name="own", source="", **TWO | changed)


test_tableaus_that_are_none = refusals(
    (lambda: ck.exponential("IE"), "`method` must be an explicit tableau .*, but is IE"),
    (lambda: ck.exponential("EXP-EE"), "`method` must be an explicit tableau .*, but is EXP-EE"),
    (lambda: own(b=(0.0, 2.0)), "`b` must hold weights whose sum is 1, but has a sum of 2"),
    (lambda: own(A=((0.0,), (0.5, 0.0), (0.5,))), "`A` must be lower triangular"),
    (lambda: own(c=(0.0,)), "`c` must have shape"),
    (lambda: own(A=((0.5,), (0.5, 0.0)), c=(0.5, 0.5), exponential=True), "`exponential` must be False"),
    (lambda: own(order=0), "`order` must be at least 1"),
)
