"""Programs kept whole: the same question finds its program again, any other one does not, and results are the same."""

import functools
import shutil
import subprocess
import sys
import types

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik import programs
from cnclik.hints import quick_jit
from cnclik.integrate.solve import whole_run
from cnclik.record import record, replace

ARM = ck.planar_arm([1.0, 0.8])
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
Q = np.array([0.3, 1.1])


@pytest.fixture
def folder(tmp_path):
    programs.keep(tmp_path)
    programs.loaded.clear()
    yield tmp_path
    programs.keep(None)
    programs.loaded.clear()


@pytest.fixture(scope="module")
def of_asked(tmp_path_factory):
    """Folder with the program of `asked()`, made once."""
    place = tmp_path_factory.mktemp("programs")
    programs.keep(place)
    programs.loaded.clear()
    asked()
    return place


@pytest.fixture
def begun(of_asked, folder):
    """A folder that has the program of `asked()`, and a process that has not loaded it."""
    shutil.copytree(of_asked, folder, dirs_exist_ok=True)
    return folder


def files(folder):
    return {path.name for path in folder.iterdir()}


def asked(law=LAW, target=(1.2, 0.9), N=4, method="EE", q=Q, Ts=0.1, solve=None):
    solve = solve or quick_jit(whole_run, static_argnames=("N", "method"))
    method = ck.METHODS[method]
    known = law, ck.hold(np.array(target)), ck.picard(3), None, method
    return solve(*known, q, np.float64(Ts), np.float64(0.0), None, None, N=N)


def test_a_program_is_found_again_and_gives_the_same(folder):
    first = asked()
    kept = files(folder)
    assert len(kept) == 1
    programs.loaded.clear()  # as another process would begin
    again = asked()
    assert files(folder) == kept
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert repr(first) == repr(again) and type(again) is ck.Trajectory
    # Other numbers in arrays are no other program.
    moved = asked(target=(1.1, 0.8), Ts=0.2, q=Q + 0.1)
    assert files(folder) == kept and np.abs(moved.q - first.q).max() > 0.05
    plain = ck.solve(LAW, ck.hold([1.1, 0.8]), Q + 0.1, 0.2, 4, "EE")
    np.testing.assert_allclose(moved.q, plain.q, atol=1e-13)


@pytest.mark.parametrize(
    "change",
    [
        {"law": ck.Law(ARM, ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))},
        {"law": replace(LAW, chain=ck.planar_arm([1.0, 0.9]))},
        {"method": "CN"},
        {"q": Q.astype("float32")},
    ],
    ids=["inverse", "robot", "method", "dtype"],
)
def test_what_is_compiled_in_makes_another_program(begun, change):
    before = files(begun)
    got = asked(**change, Ts=0.01).q[-1]  # where CN does not amplify roundings, as with 0.1 s
    assert len(files(begun) - before) == 1
    law = change.get("law", LAW)
    with ck.use_engine("plain"):
        wanted = ck.solve(law, ck.hold([1.2, 0.9]), change.get("q", Q), 0.01, 4,
                          change.get("method", "EE"), ck.picard(3)).q[-1]  # fmt: skip
    np.testing.assert_allclose(got, wanted, rtol=1e-5 if "q" in change else 1e-12)


def test_settings_make_another_program(begun):
    before = files(begun)
    with ck.use_hints(False):
        asked()
    with jax.default_matmul_precision("float32"):
        asked()
    assert len(files(begun) - before) == 2


def test_a_function_of_the_users_is_never_kept(folder):
    path = ck.path(lambda t: (1.0 + 0.1 * t, 0.9 + 0.0 * t))
    solve = quick_jit(whole_run, static_argnames=("N", "method"))
    known = LAW, path, ck.picard(3), None, ck.EE
    run = solve(*known, Q, np.float64(0.1), np.float64(0.0), None, None, N=3)
    assert not files(folder) and run.q.shape == (4, 2)
    gain = 2.0

    def user(x):
        return gain * x

    user.__module__ = "__main__"
    assert quick_jit(user)(1.5) == 3.0 and not files(folder)


def test_a_closure_is_known_by_what_it_holds(folder):
    def times(gain):
        def scaled(x):
            return gain * x

        own = {"__name__": "cnclik.test"}  # as a module of the package has it
        return quick_jit(types.FunctionType(scaled.__code__, own, "scaled", None, scaled.__closure__))

    assert [float(times(gain)(1.5)) for gain in (2.0, 3.0, 2.0)] == [3.0, 4.5, 3.0]
    assert len(files(folder)) == 2


def test_what_only_looks_like_ours_is_never_kept(folder):
    gain = 2.0

    @functools.wraps(ck.solve)
    def user(x):
        return gain * x

    assert quick_jit(user)(1.5) == 3.0 and not files(folder)

    @record
    class Mine:
        size: object

        def go(self):
            return 3 * self.size

    Mine.__module__, Mine.__qualname__ = __name__, "Mine"
    own = {"__name__": "cnclik.test"}
    go = types.FunctionType((lambda one: one.go()).__code__, own)
    assert quick_jit(go)(Mine(size=np.arange(2.0))).tolist() == [0.0, 3.0] and not files(folder)


def test_sources_that_are_younger_than_the_process_keep_nothing(folder, monkeypatch):
    monkeypatch.setattr(programs, "_BEGUN", 0.0)
    programs.surroundings.cache_clear()
    try:
        assert asked().q.shape == (5, 2) and not files(folder)
    finally:
        programs.surroundings.cache_clear()


def test_what_is_damaged_is_made_again(begun):
    first = asked()
    (file,) = begun.iterdir()
    for content in (b"", file.read_bytes()[:-7]):
        file.write_bytes(content)
        programs.loaded.clear()
        np.testing.assert_array_equal(asked().q, first.q)
        assert len(file.read_bytes()) > 1000  # and kept once more


def test_an_entry_in_anothers_place_is_made_again(begun):
    (file,) = begun.iterdir()
    first, other = asked(), asked(method="CN")
    (another,) = files(begun) - {file.name}
    file.write_bytes((begun / another).read_bytes())
    programs.loaded.clear()
    np.testing.assert_array_equal(asked().q, first.q)
    np.testing.assert_array_equal(asked(method="CN").q, other.q)
    file.unlink()
    file.symlink_to("/dev/zero")
    programs.loaded.clear()
    np.testing.assert_array_equal(asked().q, first.q)
    assert not file.is_symlink()


def test_many_programs_of_one_function_stand_side_by_side(begun):
    """What was loaded once, from JAX's cache or from here, can't be kept: functions are missing then."""
    wanted = {N: asked(N=N).q for N in (2, 3, 4)}
    programs.loaded.clear()
    for _ in range(2):
        for N, q in wanted.items():
            np.testing.assert_array_equal(asked(N=N).q, q)


_JUDGED = """
import sys, numpy as np, cnclik as ck
from cnclik import programs
from cnclik.tuning.objective import judge, loop_objective
programs.keep(ck.use_cache(sys.argv[1]))
made, make = [], programs._made
programs._made = lambda *given: made.append(given) or make(*given)
law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=5.0)
objective = loop_objective(law, ck.hold([1.2, 0.9]), np.array([0.3, 1.1]), Ts=0.1, N=4, method="EE")
print(judge(objective, [(np.asarray(5.0),)])[0].loss, len(made))
"""


def test_a_program_that_calls_c_is_found_by_another_process(tmp_path):
    command = [sys.executable, "-c", _JUDGED, str(tmp_path)]
    first, again = (subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() for _ in "12")
    assert first[0] == again[0] and int(first[1]) > 0
    assert again[1] == "0"


def test_nothing_is_kept_where_nobody_asked(tmp_path):
    assert programs.place is None
    asked()
