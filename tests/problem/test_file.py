"""A problem in a Python file: what its function may return, which options it takes, and its errors with their line."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.problem import problem_of

TWO = """
import cnclik as ck
arm = ck.planar_arm([1.0, 0.8, 0.5])
def problem(alpha=5.0):
    tasks = ck.stack(hand=ck.position("xy"), rest=ck.joints())
    levels = ck.levels(["hand"], ["rest"], damping=(1e-3, 0.1))
    return ck.Law(arm, tasks, alpha=alpha, inverse=levels), None, [0.3, 0.5, 0.2]
"""
ONE = """
import cnclik as ck
def problem():
    law, drive = ck.Law(ck.panda(), ck.pose(), alpha=4.0), ck.Drive(delay=2.0, lag=0.05)
    return dict(law=law, drive=drive, Ts=0.004, N=7, method="EE")
"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        (tmp_path / "cell.py").write_text(text)
        return tmp_path / "cell.py"

    return write


def test_a_stack_stays_where_it_starts_and_takes_options_that_are_its_arguments(file):
    made = problem_of(file(TWO), alpha=3.0, Ts=0.02, N=5, delay=1.0)
    assert made.name == "cell" and float(made.law.alpha) == 3.0 and (made.Ts, made.N) == (0.02, 5)
    assert made.drive == ck.Drive(delay=1.0) and made.reference.still
    run = made.run()
    np.testing.assert_allclose(run.q[-1], [0.3, 0.5, 0.2], atol=1e-12)
    assert run["hand"].e.shape == (6, 2)


def test_what_the_file_says_holds_unless_an_option_is_given(file):
    made = problem_of(file(ONE))
    assert (made.Ts, made.N, str(made.method), made.drive) == (0.004, 7, "EE", ck.Drive(delay=2.0, lag=0.05))
    np.testing.assert_array_equal(made.q0, ck.problem.start_from(ck.panda(), ck.pose()))
    made = problem_of(file(ONE), N=3, method="CN", M=2, delay=0.0)
    assert (made.N, str(made.method), made.stage.M, made.drive) == (3, "CN", 2, ck.Drive(lag=0.05))
    same = problem_of(
        file("import cnclik as ck\ndef problem(): return ck.problem.problem_from('ur5', Ts=0.002, damping=0.1)")
    )
    assert same.Ts == 0.002 and same.name == "ur5" and same.law.chain.n == 6


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("x = 1", {}, r"name a Python file with a function problem\(\), but cell.py has none"),
        ("x = (", {}, r"cell.py, line 1: SyntaxError: '\(' was never closed"),
        ("\nimport nothing_such", {}, "cell.py, line 2: ModuleNotFoundError: No module named 'nothing_such'"),
        ("def problem():\n    return 1 / 0", {}, "cell.py, line 2: ZeroDivisionError: division by zero"),
        ("def problem(): return 3", {}, "return a law, a reference and q0, as a tuple or a dict, but returns 3"),
        (ONE.replace("N=7", "steps=7"), {}, r"must be one of .*, but is 'steps'"),
        (ONE.replace("ck.pose()", "ck.position(tip='hand')"), {}, "cell.py, line 4: Argument `tip` must be"),
        (ONE.replace("alpha=4.0", "gain=4.0"), {}, r"cell.py, line 4: .*`gain` \(did you mean 'alpha'\?\)"),
        (TWO.replace("0.2]", "0.2, 1]"), {}, "`q0` must have 3 joint values, but has 4"),
        (TWO, {"task": "xy"}, r"`task` must be an argument of problem\(\) in cell.py, or be left out"),
        (ONE.replace("N=7", "noise=[0.1, 0.2]"), {}, "`noise` must be a single number or have 6 numbers, but has 2"),
        (ONE.replace("N=7", "noise=[0, 0, 0, 0, 0, -0.1]"), {}, "`noise` must be at least 0, but is"),
        (TWO, {"Ts": -1.0}, "`Ts` must be positive"),
        (TWO, {"lag": [0.1, 0.2]}, "`lag` must have 3 numbers, but has 2"),
    ],
)
def test_what_is_wrong_is_one_line(file, text, options, told):
    with pytest.raises(ck.ArgumentError, match=told) as error:
        problem_of(file(text), **options)
    assert "\n" not in str(error.value)


def test_no_file_is_told():
    with pytest.raises(ck.ArgumentError, match=r"`robot` must name a Python file that can be read, but cell.py: No"):
        problem_of("nowhere/cell.py")


def test_a_file_may_import_what_is_beside_it(file):
    path = file("import beside_it\n" + TWO.replace("[1.0, 0.8, 0.5]", "beside_it.LENGTHS"))
    path.with_name("beside_it.py").write_text("LENGTHS = [1.0, 0.5, 0.25]\n")
    assert problem_of(path).law.chain.n == 3
