"""`python -m tests.bench.stacks [ROBOT ...]`: steps of stacks on one core, beside Pinocchio's C++, pink and mink.

The same step for all: poses of several tips, of the hand positions, weighted, damped, explicit Euler; all are compared
first, to 1e-9. By CPU
time, in one run, in turn; medians. `pin`, Eigen's headers (`EIGEN3_INCLUDE_DIR`), pin-pink, mink and daqp are needed,
and example-robot-data; what is not installed is left out. Five minutes.
"""

import argparse
import ctypes
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik.integrate.solve import end
from cnclik.robot.model import modelled
from tests.bench.pinocchio_cpp import HERE, compiled
from tests.oracles import robots

ALPHA, DAMPING, WEIGHTS, TS = 10.0, 0.05, (1.0, 0.5), 0.01
LANES, STEPS, ROUNDS, ALONE = 8192, 10, 5, 200
G1 = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
FEET, HANDS = [f"{side}_ankle_roll_link" for side in ("left", "right")], ["left_rubber_hand", "right_rubber_hand"]
MORE = [f"{side}_{part}_link" for side in ("left", "right") for part in ("knee", "elbow", "shoulder_yaw", "hip_yaw")]
HAND = "Allegro, 4 fingertips"
ROBOTS = {
    "Baxter, both arms": ("baxter_description/urdf/baxter.urdf", ["left_gripper", "right_gripper"]),
    "G1, 5 tips": (G1, [*FEET, *HANDS, "torso_link"]),
    "G1, 13 frames": (G1, [*FEET, *HANDS, "torso_link", *MORE]),
    HAND: ("allegro_hand_description/urdf/allegro_right_hand.urdf", [f"link_{i}.0_tip" for i in (3, 7, 11, 15)]),
}


class Case:
    """A robot with tips, starts (B, n) and targets (B, tips, 4, 4) a little off them."""

    def __init__(self, name, batch=LANES):
        file, tips = ROBOTS[name]
        self.name, self.path, self.tips = name, robots() / file, tips
        self.robot = ck.load_urdf(self.path, tips=tips)
        self.weights = (WEIGHTS[0], 0.0) if name == HAND else WEIGHTS
        self.task = ck.stack(**{f"tip{i}": self._one(tip) for i, tip in enumerate(tips)})
        self.law = ck.Law(self.robot, self.task, alpha=ALPHA, inverse=ck.damped(DAMPING))
        rng = np.random.default_rng(0)
        low, high = (np.clip(np.array(b), -1.0, 1.0) for b in (self.robot.lower, self.robot.upper))
        self.q = rng.uniform(0.5 * low, 0.5 * high, (batch, self.robot.n))
        off = self.q + 0.1 * rng.normal(size=self.q.shape)
        self.targets = np.asarray(jax.jit(jax.vmap(self._tips))(off))

    def _one(self, tip):
        if not self.weights[1]:
            return ck.position(tip=tip)
        return ck.pose(tip=tip, weights=[self.weights[0]] * 3 + [self.weights[1]] * 3)

    def _tips(self, q):
        def one(tip):
            at = ck.forward(self.robot, q, tip=tip)
            top = jnp.concatenate([at.rotation, at.position[:, None]], axis=1)
            return jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]])])

        return jnp.stack([one(tip) for tip in self.tips])

    def reference(self, targets):
        holds = {f"tip{i}": ck.hold(targets[i, :3, 3], targets[i, :3, :3]) for i in range(len(self.tips))}
        return ck.references(**holds)

    def loop(self, N):
        """(q, targets) to q after N steps."""

        def run(q, targets):
            return end(self.law, self.reference(targets), q, TS, N, ck.METHODS["EE"], ck.picard(1))[0]

        return run


class Pinocchio:
    """The step in C++."""

    def __init__(self, case):
        chain, model = case.robot, modelled(case.robot)
        library = ctypes.CDLL(str(compiled(HERE / "pinocchio_stack.cpp")))
        self._new, self._run, self._delete = library.stack_new, library.stack_run, library.stack_delete
        pointer, real, whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
        self._new.restype, self._new.argtypes = pointer, [whole, *[pointer] * 3, whole, *[pointer] * 2]
        self._run.restype = real
        self._run.argtypes = [pointer, whole, whole, pointer, pointer, real, real, pointer, real]
        self._delete.restype, self._delete.argtypes = None, [pointer]
        # Each joint turns about an axis of its own frame; a frame turned so that this is one of x, y, z.
        axes = np.array([j.axis for j in chain.joints])
        which = np.abs(axes).argmax(axis=1)
        turns = [_onto(axis, k) for axis, k in zip(axes, which, strict=True)]
        origins = np.asarray(model.transforms[0]) + np.asarray(model.transforms[2])  # A + C: where the value is 0
        before = [np.eye(4) if p < 0 else turns[p].T for p in chain.parents]
        places = np.stack([b @ o @ t for b, o, t in zip(before, origins, turns, strict=True)])
        offsets = np.stack([turns[c].T @ np.asarray(t) for c, t in zip(model.carriers, model.tips, strict=True)])
        self._kept = [np.ascontiguousarray(v) for v in (
            np.array(chain.parents, np.int32), which.astype(np.int32), places,
            np.array(model.carriers, np.int32), offsets,
        )]  # fmt: skip
        parents, which, places, carriers, offsets = (v.ctypes.data for v in self._kept)
        self._stack = self._new(len(chain.joints), parents, which, places, len(case.tips), carriers, offsets)
        self._weights = np.array(case.weights)

    def run(self, q, targets, N):
        """(q after N steps, CPU seconds)"""
        q, targets = np.array(q), np.ascontiguousarray(targets)
        given = q.ctypes.data, targets.ctypes.data, ALPHA, DAMPING, self._weights.ctypes.data, TS
        return q, self._run(self._stack, len(q), N, *given)


def _onto(axis, k):
    """A rotation (4, 4) that takes the unit vector k onto an axis."""
    unit = np.eye(3)[k]
    v, c = np.cross(unit, axis), float(unit @ axis)
    made = np.eye(4)
    if c < -1 + 1e-12:
        made[:3, :3] = np.diag([-1.0 if i != (k + 1) % 3 else 1.0 for i in range(3)])
    else:
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        made[:3, :3] = np.eye(3) + cross + cross @ cross / (1 + c)
    return made


def pink_step(case):
    """() to q̇ of the first start, with daqp; None where pink is not installed."""
    try:
        import pink
        import pinocchio as pin
    except ImportError:
        return None
    model = pin.buildModelFromUrdf(str(case.path))
    full = pin.neutral(model)
    full[[model.joints[model.getJointId(name)].idx_q for name in case.robot.joint_names]] = case.q[0]
    tasks = [pink.FrameTask(tip, *case.weights, gain=ALPHA * TS) for tip in case.tips]
    for task, target in zip(tasks, case.targets[0], strict=True):
        task.set_target(pin.SE3(target[:3, :3], target[:3, 3]))
    configuration = pink.Configuration(model, model.createData(), full)

    def step():
        configuration.update(full)
        return pink.solve_ik(configuration, tasks, TS, "daqp", damping=DAMPING**2, limits=[])

    return step


def mink_step(case):
    """The same with mink; None where it is not installed, or MuJoCo can't read the file."""
    try:
        import mink
        import mujoco
    except ImportError:
        return None
    try:
        spec = mujoco.MjSpec.from_string(_without_meshes(case.path))
        model = spec.compile()
    except (ValueError, mujoco.FatalError):
        return None
    full = np.zeros(model.nq)
    full[[model.joint(name).qposadr[0] for name in case.robot.joint_names]] = case.q[0]
    bodies = [tip for tip in case.tips if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip) >= 0]
    if len(bodies) < len(case.tips):  # links without mass are joined with the ones that carry them
        return None
    tasks = [mink.FrameTask(tip, "body", *case.weights, gain=ALPHA * TS) for tip in case.tips]
    for task, target in zip(tasks, case.targets[0], strict=True):
        task.set_target(mink.SE3.from_matrix(target))
    configuration = mink.Configuration(model)

    def step():
        configuration.update(full)
        return mink.solve_ik(configuration, tasks, TS, "daqp", damping=DAMPING**2, limits=[])

    return step


def _without_meshes(path):
    """A robot's file with its links' masses and nothing to be seen, whose meshes MuJoCo would want."""
    from xml.etree import ElementTree

    root = ElementTree.parse(path).getroot()
    for link in root.iter("link"):
        for shown in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shown)
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.attrib.update(fusestatic="false", balanceinertia="true", discardvisual="true", strippath="false")
    return ElementTree.tostring(root, encoding="unicode")


def cpu(call, least=0.2):
    """CPU seconds of a call: the median of those in so many seconds."""
    found, stop = [], time.perf_counter() + least
    while not found or time.perf_counter() < stop:
        start = time.process_time()
        call()
        found.append(time.process_time() - start)
    return statistics.median(found)


def compare(case, peer):
    """The largest difference of joint values from Pinocchio's after all steps, of some lanes."""
    some = slice(0, 64)
    made = np.asarray(ck.lanes(case.loop(STEPS), cores=1)(case.q[some], case.targets[some]))
    return float(np.abs(made - peer.run(case.q[some], case.targets[some], STEPS)[0]).max())


def measure(name):
    """Rows (contender, µs a step, times Pinocchio's)."""
    case = Case(name)
    peer = Pinocchio(case)
    off = compare(case, peer)
    assert off < 1e-9, f"{name}: {off:g} rad off Pinocchio"
    rows: dict = {}
    found, calls = {}, {}
    for dtype in ("float64", "float32"):
        given = case.q.astype(dtype), case.targets.astype(dtype)
        begun, made = time.perf_counter(), ck.lanes(case.loop(STEPS), cores=1)
        made(*given)
        rows[f"first call of lanes, {dtype} [s]"] = time.perf_counter() - begun
        calls[f"cnclik in lanes, {dtype}"] = (lambda made=made, given=given: made(*given)), LANES * STEPS
    reference = case.reference(case.targets[0])
    whole = lambda: ck.solve(case.law, reference, case.q[0], TS, ALONE, "EE")  # noqa: E731
    one = lambda: ck.step(case.law, reference, case.q[0], 0.0, TS, "EE")  # noqa: E731
    with ck.use_engine("native"):
        whole(), one()
    calls["cnclik, one loop, a step of 200"] = whole, ALONE
    calls["cnclik, `step` from Python"] = one, 1
    for peer_name, make in (("pink, daqp", pink_step), ("mink, daqp", mink_step)):
        if (step := make(case)) is not None:
            calls[peer_name] = step, 1
    for _ in range(ROUNDS):
        found.setdefault("Pinocchio C++", []).append(peer.run(case.q[:512], case.targets[:512], STEPS)[1] / 512 / STEPS)
        for row, (call, steps) in calls.items():
            with ck.use_engine("native"):
                found.setdefault(row, []).append(cpu(call) / steps)
    base = found["Pinocchio C++"]
    for row, seconds in found.items():
        ratio = statistics.median(b / s for b, s in zip(base, seconds, strict=True))
        rows[row] = (1e6 * statistics.median(seconds), ratio)
    return case, off, rows


def gradients(batch=2048, N=20):
    """Rows (what, µs a loss, times the value) of a loss of 20 steps of G1's arms, and how many numbers are not finite.

    Its derivatives are by both arms' target positions and all 17 joint values: forward in one direction of them all,
    reverse by each. A quarter of the arms are straight.
    """
    robot = ck.load_urdf(robots() / G1, tips=HANDS)
    task = ck.stack(left=ck.pose(tip=HANDS[0]), right=ck.pose(tip=HANDS[1]))
    law = ck.Law(robot, task, alpha=ALPHA, inverse=ck.damped(DAMPING))
    rng = np.random.default_rng(0)
    q = 0.3 * rng.normal(size=(batch, robot.n))
    q[: batch // 4] = 0.0
    at = [ck.forward(robot, np.zeros(robot.n), tip=tip) for tip in HANDS]
    targets = np.stack([np.asarray(one.position) for one in at]) + 0.05 * rng.normal(size=(batch, 2, 3))

    def loss(q, targets):
        holds = [ck.hold(x, np.asarray(one.rotation)) for x, one in zip(targets, at, strict=True)]
        made, e = end(law, ck.references(left=holds[0], right=holds[1]), q, TS, N, ck.METHODS["EE"], ck.picard(1))
        return e @ e + 1e-3 * made @ made

    forward = lambda q, x: jax.jvp(loss, (q, x), (jnp.ones_like(q), jnp.ones_like(x)))  # noqa: E731
    kinds = {"value": loss, "forward": forward, "reverse": jax.value_and_grad(loss, (0, 1))}
    calls, found, wrong = {name: ck.lanes(fn, cores=1) for name, fn in kinds.items()}, {}, 0
    for call in calls.values():
        wrong += sum(int(np.sum(~np.isfinite(v))) for v in jax.tree.leaves(call(q, targets)))
    for _ in range(ROUNDS):
        for name, call in calls.items():
            found.setdefault(name, []).append(cpu(lambda call=call: call(q, targets)) / batch)
    ratios = {k: statistics.median(a / b for a, b in zip(v, found["value"], strict=True)) for k, v in found.items()}
    return {name: (1e6 * statistics.median(v), ratios[name]) for name, v in found.items()}, wrong


def main(argv=None):
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(prog="python -m tests.bench.stacks", description=__doc__)
    parser.add_argument("robots", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--gradients", action="store_true", help="of a loss of 20 steps of G1's arms, alone")
    args = parser.parse_args(argv)
    if args.gradients:
        rows, wrong = gradients()
        for row, (seconds, ratio) in rows.items():
            print(f"  {row:<10}{seconds:8.2f} µs {ratio:6.2f} times the value")
        print(f"  {wrong} numbers are not finite")
        return
    for name in args.robots or ROBOTS:
        case, off, rows = measure(name)
        print(f"{name}: {case.task.m} rows × {case.robot.n} joints; within {off:.1e} rad of Pinocchio")
        for row, found in rows.items():
            print(
                f"  {row:<36}" + (f"{found:8.2f}" if isinstance(found, float) else "{:8.3f} µs {:7.2f}".format(*found))
            )


if __name__ == "__main__":
    main()
