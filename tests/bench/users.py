"""What a user writes for a stack of poses in pink, mink and cnclik, and how soon and how fast it answers.

Each text runs in a process of its own, as Python's main module: from a URDF file to joint values after 200 steps. It
tells when it had answered, what a step takes then, and how far the tips are from their targets. Lines are those of the
text.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from typing import NamedTuple
from xml.etree import ElementTree

from tests.bench.first import environment

PINK = """
import numpy as np, pinocchio as pin, pink
root = {"planar": (pin.JointModelPlanar(),), "free": (pin.JointModelFreeFlyer(),), "fixed": ()}[BASE]
model = pin.buildModelFromUrdf(URDF, *root)
q = pin.neutral(model)
for name, value in START.items():
    q[model.joints[model.getJointId(name)].idx_q] = value
robot = pink.Configuration(model, model.createData(), q)
tasks = [pink.FrameTask(tip, *WEIGHTS, gain=ALPHA * TS) for tip in TIPS]
for task, target in zip(tasks, TARGETS):
    task.set_target(pin.SE3(np.array(target)))
limits = [pink.limits.ConfigurationLimit(model, 1.0), pink.limits.VelocityLimit(model)] if LIMITS else []
def step():
    velocity = pink.solve_ik(robot, tasks, TS, "daqp", damping=DAMPING**2, limits=limits, safety_break=LIMITS)
    robot.integrate_inplace(velocity, TS)
for _ in range(N):
    step()
"""

MINK = """
import numpy as np, mink, mujoco
spec = mujoco.MjSpec.from_file(URDF)
if BASE == "free":
    spec.body(ROOT).add_freejoint()
if BASE == "planar":
    for name, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0])):
        spec.body(ROOT).add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    spec.body(ROOT).add_joint(name="yaw", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
model = spec.compile()
robot = mink.Configuration(model)
q = robot.q.copy()
for name, value in START.items():
    q[model.joint(name).qposadr] = value
robot.update(q)
tasks = [mink.FrameTask(tip, "body", *WEIGHTS, gain=ALPHA * TS) for tip in TIPS]
for task, target in zip(tasks, TARGETS):
    task.set_target(mink.SE3.from_matrix(np.array(target)))
limits = [mink.ConfigurationLimit(model, 1.0), mink.VelocityLimit(model, SPEEDS)] if LIMITS else []
def step():
    velocity = mink.solve_ik(robot, tasks, TS, "daqp", damping=DAMPING**2, limits=limits)
    robot.integrate_inplace(velocity, TS)
for _ in range(N):
    step()
"""

CNCLIK = """
import jax, numpy as np, cnclik as ck
jax.config.update("jax_enable_x64", True)
ck.use_cache()
robot = ck.load_urdf(URDF, tips=TIPS, base=BASE)
weights = np.repeat(WEIGHTS, 3)
tasks = ck.stack(**{tip: ck.pose(tip=tip, weights=weights) for tip in TIPS})
limits = ck.bounded(rate=1 / TS) if LIMITS else None
law = ck.Law(robot, tasks, alpha=ALPHA, inverse=ck.damped(DAMPING), limits=limits)
aims = ck.references(**{tip: ck.hold(at[:3, 3], at[:3, :3]) for tip, at in zip(TIPS, np.array(TARGETS))})
q = np.array([START.get(name, 0.0) for name in robot.joint_names])
def step():
    global q
    q = ck.step(law, aims, q, 0.0, TS, "EE").q
for _ in range(N):
    step()
"""

WHERE = {  # of a tip
    "pink": "robot.get_transform_frame_to_world(tip).translation",
    "mink": 'robot.get_transform_frame_to_world(tip, "body").translation()',
    "cnclik": "ck.forward(robot, q, tip=tip).position",
}
TEXTS = {"cnclik": CNCLIK, "pink": PINK, "mink": MINK}
_BEFORE = "import json, sys\nglobals().update(json.load(open(sys.argv[1])))\n"
_AFTER = """
import json, resource, time
used, spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)], []
off = max(float(np.linalg.norm(np.asarray(WHERE) - np.array(at)[:3, 3])) for tip, at in zip(TIPS, TARGETS))
for _ in range(5):
    begun = time.process_time()
    for _ in range(N):
        step()
    spent.append((time.process_time() - begun) / N)
print(json.dumps({"answered": sum(one.ru_utime + one.ru_stime for one in used), "step": sorted(spent)[2], "off": off}))
"""


class Told(NamedTuple):
    """What a process told; medians of rounds."""

    first: float  # CPU seconds from its start to its answer, a compiler's too
    again: float  # the same in the next process, which has what the first one kept
    step: float  # CPU seconds of a step, warm
    off: float  # the tip that is farthest from its target after 200 steps [m]


def lines(name) -> int:
    """Lines of a user's text."""
    return len(TEXTS[name].strip().splitlines())


def run(name, given, rounds=3) -> Told | None:
    """A user's text with these values (`Case.given`); None where the library is not installed."""
    firsts, told = [], []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            values, text, urdf = (os.path.join(folder, name) for name in ("given.json", "user.py", "robot.urdf"))
            for path, content in (
                (urdf, without_meshes(given["URDF"])),
                (values, json.dumps(given | {"URDF": urdf})),
                (text, _BEFORE + TEXTS[name] + _AFTER.replace("WHERE", WHERE[name])),
            ):
                with open(path, "w", encoding="utf-8") as file:
                    file.write(content)
            for kept in (firsts, told):
                line, own = [sys.executable, text, values], environment(folder)
                done = subprocess.run(line, env=own, capture_output=True, text=True)
                if "ModuleNotFoundError" in done.stderr:
                    return None
                if done.returncode:
                    raise RuntimeError(f"{name}: {done.stderr[-2000:]}")
                kept.append(json.loads(done.stdout.splitlines()[-1]))
    middle = lambda some, what: statistics.median(one[what] for one in some)  # noqa: E731
    return Told(middle(firsts, "answered"), middle(told, "answered"), middle(told, "step"), told[0]["off"])


def without_meshes(path) -> str:
    """A robot's file with nothing to be seen, whose meshes MuJoCo would want, and masses that it takes."""
    root = ElementTree.parse(path).getroot()
    for link in root.iter("link"):
        for part in ("visual", "collision", "inertial"):
            for shown in link.findall(part):
                link.remove(shown)
        mass = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(mass, "mass", value="1")
        ElementTree.SubElement(mass, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.attrib.update(fusestatic="false", discardvisual="true", strippath="false")
    return ElementTree.tostring(root, encoding="unicode")
