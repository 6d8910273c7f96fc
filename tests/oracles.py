"""Independent references for the tests: plain NumPy, SciPy, Pinocchio. Nothing here uses cnclik."""

import functools
import importlib.metadata
import pathlib

import numpy as np
import scipy.linalg

# file, tip, base: robots people own, 6 to 8 joints, prismatic and continuous ones among them.
ARMS = {
    "Panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", None),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0", None),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0", None),
    "iCub arm": ("icub_description/robots/icub.urdf", "l_hand", "chest"),
    "Talos arm": ("talos_data/robots/talos_reduced.urdf", "gripper_left_base_link", "torso_2_link"),
    "PR2 arm": ("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", None),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", None, None),
}


@functools.cache
def robots() -> pathlib.Path:
    """Folder of the robots of the example-robot-data wheel."""
    files = importlib.metadata.files("example-robot-data")
    return pathlib.Path(next(f for f in files if f.name == "panda.urdf").locate()).resolve().parents[2]


def robot_file(name) -> pathlib.Path:
    """A robot's URDF file, of those below."""
    files = {
        "panda": "panda_description/urdf/panda.urdf",
        "ur5": "ur_description/urdf/ur5_robot.urdf",
        "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        "baxter": "baxter_description/urdf/baxter.urdf",
        "allegro": "allegro_hand_description/urdf/allegro_right_hand.urdf",
        "pr2": "pr2_description/urdf/pr2.urdf",
        "tiago": "tiago_description/robots/tiago_no_hand.urdf",
        "talos": "talos_data/robots/talos_full_v2.urdf",
    }
    return robots() / files[name]


def planar_position(lengths, q, sense=1.0):
    """Tip of a planar arm that lies along +y at q = 0 (Drexler 2016, Section V), closed form."""
    phi = sense * np.cumsum(q)
    return np.array([-np.sum(lengths * np.sin(phi)), np.sum(lengths * np.cos(phi))])


def planar_jacobian(lengths, q, sense=1.0):
    """Its 2×n Jacobian, closed form."""
    phi = sense * np.cumsum(q)
    reach = lambda v: np.cumsum((lengths * v)[::-1])[::-1]  # Σ over the links after joint i  # noqa: E731
    return sense * np.array([-reach(np.cos(phi)), -reach(np.sin(phi))])


def hat(w):
    """[w]×, so that hat(w) v = w × v."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def transform(rotation=None, position=None):
    """4×4 homogeneous transform."""
    out = np.eye(4)
    out[:3, :3] = np.eye(3) if rotation is None else rotation
    out[:3, 3] = 0.0 if position is None else position
    return out


def exponential(axis, point, value, kind):
    """exp(ξ q) of a joint's twist as a 4×4 matrix, by SciPy's matrix exponential."""
    twist = np.zeros((4, 4))
    if kind == "R":
        twist[:3, :3], twist[:3, 3] = hat(axis), -np.cross(axis, point)
    else:
        twist[:3, 3] = axis
    return scipy.linalg.expm(twist * value)


def product_of_exponentials(points, axes, home, kinds, q):
    """g(q) = exp(ξ₁q₁) … exp(ξₙqₙ) g(0)."""
    out = np.eye(4)
    for point, axis, kind, value in zip(points, axes, kinds, q, strict=True):
        out = out @ exponential(axis / np.linalg.norm(axis), point, value, kind)
    return out @ home


def _rot(axis, angle):
    return transform(scipy.linalg.expm(hat(np.eye(3)[axis]) * angle))


def _trans(axis, length):
    return transform(position=np.eye(3)[axis] * length)


def dh_product(a, alpha, d, theta, kinds, q, convention, base=None, tool=None):
    """Product of the four elementary transforms per joint, in the order each convention prints them."""
    out = np.eye(4) if base is None else base
    for i, kind in enumerate(kinds):
        turn = theta[i] + (q[i] if kind == "R" else 0.0)
        slide = d[i] + (q[i] if kind == "P" else 0.0)
        if convention == "standard":
            out = out @ _rot(2, turn) @ _trans(2, slide) @ _trans(0, a[i]) @ _rot(0, alpha[i])
        else:
            out = out @ _rot(0, alpha[i]) @ _trans(0, a[i]) @ _rot(2, turn) @ _trans(2, slide)
    return out if tool is None else out @ tool


def planar_law(lengths, target, velocity, alpha, sense=1.0, inverse=np.linalg.pinv):
    """f(q, t) of a planar arm: J#(ẋ_d + K e). `target` and `velocity` are functions of t."""
    lengths = np.asarray(lengths, float)
    gains = np.broadcast_to(alpha, 2)

    def f(q, t):
        e = np.asarray(target(t)) - planar_position(lengths, q, sense)
        return inverse(planar_jacobian(lengths, q, sense)) @ (np.asarray(velocity(t)) + gains * e)

    return f


def damped_inverse(damping):
    """Jᵀ(JJᵀ + λ²I)⁻¹ by a general solver."""
    return lambda j: j.T @ np.linalg.inv(j @ j.T + damping**2 * np.eye(len(j)))


def central_differences(f, x, h=2e-4):
    """Jacobian of f at the vector x, to fourth order in h; rows are outputs. f maps a batch (B, n) to a batch."""
    steps = h * np.maximum(1.0, np.abs(x))
    near, far, far_back, near_back = np.split(
        np.asarray(f(np.concatenate([x + c * np.diag(steps) for c in (1, 2, -2, -1)]))), 4
    )
    return ((8 * (near - near_back) - (far - far_back)) / (12 * steps[:, None])).T


def close(found, wanted, atol=0.0, rtol=0.0):
    """|found − wanted| ≤ atol + rtol·|wanted| in every entry; NumPy's own default adds rtol = 1e-7 unasked."""
    np.testing.assert_allclose(found, wanted, rtol=rtol, atol=atol)


def late_by(drive, Ts):
    """The delay of a motion at constant speed behind its command [s]: the dead time, the lag or 2ζ/ω₀, the filter's."""
    lag, kept = 2 * drive.damping_ratio / drive.natural_frequency if drive.order == 2 else drive.lag, drive.kept(Ts)
    late = drive.delay * Ts + lag - 0.5 * Ts * drive.steps_positions
    return late + Ts * kept / (1 - kept) * (drive.filters in ("command", "target"))
