"""Builders: every chain against a product of matrices that nobody here multiplied out by hand."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.record import stack
from cnclik.robot.chain import assemble
from cnclik.robot.posture import arm_length, start_posture
from tests.bank import screws
from tests.oracles import close, dh_product, planar_jacobian, planar_position, product_of_exponentials, transform
from tests.refusals import refusals

LENGTHS = [0.7, 1.1, 0.4]
ARM, PANDA = ck.planar_arm([1.0, 1.0]), ck.panda()
# Parameters per joint: literal right angles and zeros (which fold) among general numbers.
DH = {
    "a": [0.0, 0.4, -0.2, 0.1],
    "alpha": [math.pi / 2, -math.pi, 0.3, -math.pi / 2],
    "d": [0.3, 0.0, 0.25, -0.1],
    "theta": [0.0, math.pi / 2, 0.5, -1.2],
}
BASE = transform(Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix(), [0.1, -0.2, 0.3])
TOOL = transform(Rotation.from_rotvec([-1.0, 0.2, 0.4]).as_matrix(), [0.05, 0.1, -0.15])


def matrix(chain, q):
    found = ck.forward(chain, q)
    return transform(found.rotation, found.position)


@pytest.mark.parametrize("clockwise", [False, True])
def test_planar_arm_closed_form(clockwise):
    sense = -1.0 if clockwise else 1.0
    arm = ck.planar_arm(LENGTHS, clockwise=clockwise)
    for q in np.random.default_rng(1).uniform(-4, 4, (20, 3)):
        wanted = planar_position(np.array(LENGTHS), q, sense)
        close(ck.forward(arm, q).position, [*wanted, 0], atol=1e-13)
        close(ck.jacobian(arm, q)[:2], planar_jacobian(np.array(LENGTHS), q, sense), atol=1e-13)


@pytest.mark.parametrize("as_array", [False, True], ids=["literal", "leaf"])
@pytest.mark.parametrize("kinds", ["RRRR", "RPRP"])
@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_from_dh(convention, kinds, as_array):
    parameters = {k: np.array(v) if as_array else v for k, v in DH.items()}
    chain = ck.from_dh(**parameters, convention=convention, kinds=kinds)
    chain = ck.with_base(ck.with_tool(chain, TOOL), BASE.tolist())
    for q in np.random.default_rng(2).uniform(-3, 3, (10, 4)):
        wanted = dh_product(*DH.values(), kinds, q, convention, BASE, TOOL)
        close(matrix(chain, q), wanted, atol=1e-13)


def test_from_dh_right_angles_fold():
    """A literal right angle leaves exact zeros and ones: nothing is computed with cos(π/2) = 6e-17."""
    chain = ck.from_dh([0.0, 1.0], [math.pi / 2, -math.pi], [0.0, 0.0])
    entries = {x for j in chain.joints for row in j.origin.rotation for x in row}
    assert entries <= {0.0, 1.0, -1.0} and all(type(x) is float for x in entries)


@pytest.mark.parametrize("as_array", [False, True], ids=["literal", "leaf"])
@pytest.mark.parametrize("kinds", ["RRR", "PRP"])
def test_joints_one_by_one_are_a_product_of_exponentials(kinds, as_array):
    rng = np.random.default_rng(3)
    points, axes = rng.normal(size=(2, 3, 3))
    axes[0] = [0, 0, 2]  # not of length one: normalised
    form = (lambda a: a) if as_array else np.ndarray.tolist
    chain = screws(form(points), form(axes), form(TOOL), kinds=kinds)
    for q in rng.uniform(-3, 3, (10, 3)):
        close(matrix(chain, q), product_of_exponentials(points, axes, TOOL, kinds, q), atol=1e-13)


def test_names_limits_and_repr():
    chain = ck.from_dh([1.0, 1.0], [0.0, 0.0], [0.0, 0.0], kinds="RP", lower=[-1, 0], upper=np.array([1, 2]))
    assert chain.lower == (-1.0, 0.0) and chain.upper == (1.0, 2.0)
    assert ARM.lower == (-math.inf,) * 2 and ARM.velocity_limit == (math.inf,) * 2
    assert repr(chain) == "Chain(RP, joint_names=['q1', 'q2'])"


test_bad_input = refusals(
    (lambda: ck.planar_arm([]), r"`lengths` must have shape \(n,\), but has shape \(0,\)\."),
    (lambda: ck.planar_arm([1.0, -1.0]), r"`lengths\[1\]` must be at least 0, but is -1\."),
    (lambda: ck.from_dh([1.0], [0.0, 0.0], [0.0]), r"`alpha` must have shape \(1,\), but has shape \(2,\)\."),
    (lambda: ck.from_dh([1.0], [0.0], [0.0], convention="Standard"), r"`convention` must be one of standard, modified"),
    (lambda: ck.from_dh([1.0], [0.0], [0.0], kinds="X"), r"`kinds` must be 1 letters R or P, but is 'X'\."),
    (lambda: ck.with_base(ARM, np.eye(3)), r"`base` must be one pose: a 4×4 transform, .*, but is array"),
    (lambda: ck.from_dh([1.0], [0.0], [0.0], velocity_limit=[-1.0]), r"`velocity_limit` must be at least 0, but is -1"),
    (lambda: ck.from_dh([1.0], [0.0], [0.0], lower=[0.0, 0.0]), r"`lower` must have 1 number, but has 2\."),
    (lambda: ck.replace(ARM, velocity_limit=2.0), r"`velocity_limit` must have 2 numbers, but is a single number\."),
    (lambda: ck.replace(ARM, upper=(1.0, -7.0), lower=(0.0, -6.0)), r"must not exceed `upper`, but is -6 > -7"),
    (lambda: ck.from_dh([1e300], [0.0], [0.0]), r"`a\[0\]` must be within ±1e\+12"),
    (lambda: ck.with_tool(ARM, [1.0, 0.0]), r"`tool` must have shape \(3,\), but has shape \(2,\)\."),
    (lambda: assemble([]), r"`joints` must hold at least one joint"),
    (lambda: ck.planar_arm([1.0], clockwise="no"), "`clockwise` must be True or False, but is 'no'"),
    (lambda: ck.with_tool(ARM, [[1, 2], [3]]), r"`tool` must be one pose: .*, or a position \(3,\), but is \[\["),
    (lambda: ck.jacobian(3, [0.0]), "`chain` must be a Chain, but is int"),
)


def test_limits_may_be_traced_and_differ_between_lanes():
    def fast(limit):
        return ck.replace(ARM, velocity_limit=limit).velocity_limit[0]

    assert jax.jit(fast)(jnp.ones(2)) == 1
    several = stack([ck.replace(ARM, velocity_limit=(float(k), 1.0)) for k in range(3)])
    assert ck.replace(several, tips=ARM.tips).velocity_limit[0].tolist() == [0, 1, 2]


@pytest.mark.parametrize("lower", [-np.inf, -1e16, -7.0, -1.0, 0.0, 0.5, 5.0])
@pytest.mark.parametrize("upper", [np.inf, 1e16, 8.0, 5.0])
def test_a_start_is_within_limits_of_every_kind(lower, upper):
    """One-sided, huge and equal ones too; where a limit is far away, it says nothing of where to start."""
    arm = ck.planar_arm([1.0, 0.8])
    one, other = np.array([lower, 0.2]), np.array([upper, np.inf])
    for low, high in ((one, other), (-other, -one)):
        q = start_posture(ck.replace(arm, lower=tuple(low), upper=tuple(high)), ck.position("xy"))
        assert (q >= low).all() and (q <= high).all() and np.abs(q).max() < 20, q


def test_start_postures_stay_what_pages_and_results_begin_at():
    known = {
        (PANDA, ck.pose()): [0.0, 0.0, 0.0, -1.5708, 0.0, 1.8675, 0.0],
        (ck.ur5(), ck.pose()): [1.27591, 0.915156, -1.553167, -0.269059, 1.245593, -0.492557],
        (ck.planar_arm([1.0, 0.8]), ck.position("xy")): [-1.057578, 1.565391],
    }
    for (arm, task), q in known.items():
        close(start_posture(arm, task), np.array(q), atol=1e-6)


def test_the_length_of_an_arm_is_known_or_traced():
    for lengths in ([1.0, 0.8], [2e-4, 1e-4]):
        for length in (arm_length(ck.planar_arm(lengths)), jax.jit(lambda v: arm_length(ck.planar_arm(v)))(lengths)):
            assert length == pytest.approx(max(sum(lengths), 1e-3))
    both = ck.join(ck.planar_arm([0.3]), ck.planar_arm([1.0, 0.8]), prefix="upper_", keep=True)
    assert arm_length(both) == pytest.approx(2.1) and arm_length(both, number=0) == pytest.approx(0.3)


def test_xla_gets_no_products_of_small_matrices():
    """It would call a library for each of them, for ten times the time of all frames."""
    traced = jax.make_jaxpr(functools.partial(ck.forward, PANDA))(jnp.zeros(7))
    assert "dot_general" not in str(traced)
