"""Random chains, tasks and files: no crash, no NaN without a status, nothing accepted silently."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cnclik as ck
from cnclik.integrate.status import Status
from cnclik.problem.names import task_from

pytestmark = pytest.mark.slow
SETTINGS = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
WORD = st.text("abcxyz<>&\"' \n", max_size=6)


# --- files --------------------------------------------------------------------------------------------


@st.composite
def urdf(draw):
    """A URDF text, mostly a tree, with any of its entries broken."""
    n = draw(st.integers(0, 5))
    number = lambda: repr(draw(ANY)) if draw(st.booleans()) else draw(WORD)  # noqa: E731
    odd = lambda value, chance=12: value if draw(st.integers(0, chance)) else draw(WORD)  # noqa: E731
    escape = lambda s: s.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")  # noqa: E731
    lines = [f'<link name="{escape(odd(f"l{i}", 30))}"/>' for i in range(n + 1)]
    for i in range(n):
        kind = odd(draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed", "floating"])), 20)
        parent = odd(f"l{draw(st.integers(0, i))}", 30)
        parts = [f'<parent link="{escape(parent)}"/>', f'<child link="l{i + 1}"/>']
        if draw(st.booleans()):
            parts.append(f'<origin xyz="{escape(odd("0 0 1", 20))}" rpy="{escape(odd("0 1.5 0", 20))}"/>')
        parts.append(f'<axis xyz="{escape(odd("0 0 1", 20))}"/>')
        low, high = ("-1", "1") if draw(st.integers(0, 8)) else (number(), number())
        parts.append(f'<limit lower="{escape(low)}" upper="{escape(high)}" velocity="1"/>')
        if not draw(st.integers(0, 4)):
            parts.append(f'<mimic joint="j{draw(st.integers(0, 5))}" multiplier="{escape(odd("2"))}"/>')
        draw(st.randoms()).shuffle(parts)
        lines.append(f'<joint name="j{i}" type="{escape(kind)}">{"".join(parts)}</joint>')
    text = f'<robot name="r">{"".join(lines)}</robot>'
    if not draw(st.integers(0, 6)):  # a file cut short
        text = text[: draw(st.integers(0, len(text)))]
    return text


@SETTINGS
@given(text=urdf(), tip=st.none() | st.sampled_from(["l1", "l2", "l5"]), base=st.none() | st.just("l0"))
def test_any_file_loads_as_it_is_or_is_refused_in_one_line(tmp_path, text, tip, base):
    file = tmp_path / "robot.urdf"
    file.write_text(text, encoding="utf-8")
    try:
        arm = ck.load_urdf(file, tip, base)
    except ck.ArgumentError as error:
        assert "\n" not in str(error)
        return
    assert arm.n >= 1 and all(lower <= upper for lower, upper in zip(arm.lower, arm.upper, strict=True))
    assert not np.isnan([*arm.lower, *arm.upper, *arm.velocity_limit]).any()
    assert all(f'name="{name.partition("_")[0]}"' in text for name in arm.joint_names)  # j0_x is of a floating j0
    assert np.isfinite(ck.forward(arm, np.linspace(-0.5, 0.5, arm.n)).position).all()


@SETTINGS
@given(data=st.binary(max_size=60))
def test_bytes_are_no_robot(tmp_path, data):
    file = tmp_path / "robot.urdf"
    file.write_bytes(data)
    with pytest.raises(ck.ArgumentError) as error:
        ck.load_urdf(file)
    assert "\n" not in str(error.value)


# --- loops --------------------------------------------------------------------------------------------

LAWS = {
    "pseudoinverse": {},
    "bounded": {"inverse": ck.damped(0.05), "limits": ck.bounded()},
    "scaled": {"inverse": ck.singular_damped(0.05, 0.1), "limits": ck.velocity_scaling()},
}


def dh(values):
    """A 4-joint chain, last joint prismatic, all geometry in arrays: one compilation serves every example."""
    a, alpha, d = np.asarray(values, float).reshape(3, 4)
    bounds = {"lower": [-2.0] * 4, "upper": [2.0] * 4, "velocity_limit": [3.0] * 4}
    return ck.from_dh(a, alpha, d, kinds="RRRP", **bounds)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("task", ["xy", "pose", "rz"])
def test_no_nan_without_a_status(name, task):
    made = task_from(task)
    if name == "pseudoinverse" and made.m > 4:  # more rows than joints only with damping
        made = ck.pose("xyz", "x")
    size = st.floats(-2, 2) | st.sampled_from([0.0, np.pi / 2])

    @settings(SETTINGS, max_examples=15)
    @given(
        geometry=st.lists(size, min_size=12, max_size=12),
        q0=st.lists(st.floats(-3, 3), min_size=4, max_size=4),
        target=st.lists(st.floats(-5, 5) | st.just(1e150), min_size=3, max_size=3),
        z=st.floats(1e-3, 50),
    )
    def check(geometry, q0, target, z):
        law = ck.Law(dh(geometry), made, alpha=z / 0.1, **LAWS[name])
        turn = np.eye(3) if made.orientation else None
        run = ck.solve(law, ck.hold(np.array(target), turn), np.array(q0), 0.1, 12, "EE")
        finite = np.isfinite(np.asarray(run.q[1:])).all(1) & np.isfinite(np.asarray(run.e[:-1])).all(1)
        flagged = (np.asarray(run.status) & int(Status.NON_FINITE)) != 0
        np.testing.assert_array_equal(flagged, ~finite)
        if name == "bounded":  # within limits from wherever it starts, whatever is asked
            speed = np.abs(np.asarray(run.qdot)[finite])
            assert (speed <= 3.0 + 1e-6).all()
            if finite.all():
                inside = np.abs(np.asarray(run.q)) <= np.maximum(2.0, np.abs(q0)) + 1e-6
                assert inside.all()

    check()


@SETTINGS
@given(values=st.lists(ANY | WORD | st.none(), max_size=8), q0=st.lists(ANY, max_size=8))
def test_arguments_are_refused_by_name(values, q0):
    from cnclik.problem.build import problem_from

    try:
        made = problem_from("planar:1,1", q0=q0, target=values, damping=0.1)
    except ck.ArgumentError as error:
        assert "\n" not in str(error) and str(error).startswith("Argument `")
        return
    assert np.isfinite(made.q0).all() and made.q0.shape == (2,)
    assert np.isfinite(np.asarray(made.reference.curve.position)).all()
