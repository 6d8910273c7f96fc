"""Tableaus: what one may leave out, and what is none. Loops of all methods are in test_combinations."""

import dataclasses

import numpy as np

import cnclik as ck
from tests.bank import screws
from tests.oracles import close
from tests.refusals import refusals

# J = 1: one step shrinks the error by R(z), exactly.
SLIDER = screws([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], [0.0, 0.0, 0.0], kinds="P")
SLIDE = ck.Law(SLIDER, ck.position("x"), alpha=1.0)


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
    (lambda: own(order=3), "`order` must be 2, that of the weights, but is 3"),
    (lambda: own(c=(0.0, 0.4)), "`order` must be 1, that of the weights, but is 2"),
    (lambda: own(A=((0.0,), (0.5, 0.0), (0.5,))), "`A` must be lower triangular"),
    (lambda: own(c=(0.0,)), "`c` must have shape"),
    (lambda: own(A=((0.5,), (0.5, 0.0)), c=(0.5, 0.5), exponential=True), "`exponential` must be False"),
    (lambda: own(order=0), "`order` must be at least 1"),
    (lambda: ck.Method(**KUTTA | dict(order=4)), "`order` must be 3, that of the weights, but is 4"),
    (lambda: dataclasses.replace(ck.METHODS["RK4"], b=[0.25] * 4), "`order` must be 2, that of the weights, but is 4"),
)
