"""`python -m tests.bench.bodies [--quick]`: motion clips retargeted to G1 on one core, beside mink.

A clip is 600 frames at 30 Hz of walking and waving, whose truth is known. What is seen of it, the poses of 14 frames
with 5 mm and 1° of noise, is followed by two steps a frame: feet before the rest, within position and velocity limits
of the joints. All get the same targets, weights, damping and limits. By CPU time, medians; results/retarget has the
tables. mink and daqp are needed, and example-robot-data. Two minutes; --quick leaves out what is compiled.
"""

import argparse
import functools
import operator
import statistics
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.measure.files import markdown
from tests.bench import timing
from tests.bench.users import without_meshes
from tests.oracles import robot_file

FPS, FRAMES, STEPS, CLIPS = 30.0, 600, 2, 64
TS = 1 / (FPS * STEPS)
SIDES = ("left", "right")
PARTS = ("hip_roll", "knee", "shoulder_yaw", "elbow", "wrist_yaw")
FEET = [f"{side}_ankle_roll_link" for side in SIDES]
BODY = ["pelvis", "torso_link", *(f"{side}_{part}_link" for side in SIDES for part in PARTS)]
TIPS = [*FEET, *BODY]
WEIGHTS = (1.0, 0.05**0.5)  # of positions [1/m] and orientations [1/rad]
DAMPING = (0.02, 0.05)  # of the feet and the rest
G1 = ck.load_urdf(robot_file("g1"), tips=TIPS, base="free")
LEGS = ck.load_urdf(robot_file("g1"), tips=FEET)
BASE = 6  # coordinates of the base


def law():
    def poses(tips):
        weights = [WEIGHTS[0]] * 3 + [WEIGHTS[1]] * 3
        return functools.reduce(operator.and_, (ck.pose(tip=tip, weights=weights) for tip in tips))

    inverse = ck.levels(["feet"], ["body"], damping=DAMPING)
    held = ck.bounded(rate=1 / TS)
    return ck.Law(G1, ck.stack(feet=poses(FEET), body=poses(BODY)), alpha=1 / TS, inverse=inverse, limits=held)


def followed(law, q, seen, steps):
    """Some steps from q (n,) towards what is seen (tips, 3, 4)."""
    held = {tip: ck.hold(seen[i, :, 3], seen[i, :, :3]) for i, tip in enumerate(TIPS)}
    feet, body = (ck.references(**{tip: held[tip] for tip in tips}) for tips in (FEET, BODY))
    aims = ck.references(feet=feet, body=body)
    return jax.lax.scan(lambda q, _: (ck.step(law, aims, q, 0.0, TS, "EE").q, None), q, length=steps)[0]


def retarget(law):
    """(q0 (n,), clip (F, tips, 3, 4)) to q (F, n)."""

    def frame(q, seen):
        q = followed(law, q, seen, STEPS)
        return q, q

    return lambda q0, clip: jax.lax.scan(frame, q0, clip)[1]


# --- clips ----------------------------------------------------------------------------------------------


class Clip(NamedTuple):
    truth: np.ndarray  # q (F, n)
    seen: np.ndarray  # what is seen of it (F, tips, 3, 4)


def clip(seed):
    """Walking along a curve, each foot on the ground for 60 % of its cycle, and waving up to the limit of the elbow."""
    rng, t = np.random.default_rng(seed), np.arange(FRAMES) / FPS
    pace, phase = rng.uniform(0.8, 1.0), rng.uniform()
    w = 2 * np.pi * pace
    q = np.zeros((FRAMES, G1.n))
    moves = {f"waist_{axis}": (0.0, size, 1.0) for axis, size in (("yaw", 0.25), ("roll", 0.08), ("pitch", 0.1))}
    for k, side in enumerate(SIDES):
        own = {"shoulder_pitch": (0.2, -0.4, 0), "elbow": (0.6, 0.3, 0), "shoulder_roll": (0.25 - 0.5 * k, 0.1, 0),
               "wrist_roll": (0, 0.3, 0), "wrist_pitch": (0, 0.2, 0)}  # fmt: skip
        moves |= {f"{side}_{name}": (mean, size, late + k * np.pi) for name, (mean, size, late) in own.items()}
    for name, (mean, size, late) in moves.items():
        q[:, G1.joint_names.index(f"{name}_joint")] = mean + size * np.sin(w * t + 2 * np.pi * phase + late)
    waving = 1 / (1 + np.exp(4 * np.abs(t - 10) - 16))
    for name, size in (("shoulder_pitch", -1.2), ("shoulder_roll", -0.9), ("elbow", 1.6)):
        q[:, G1.joint_names.index(f"right_{name}_joint")] += size * waving
    place, yaw = _path(rng.uniform(0, 6))
    turned = Rotation.from_euler("ZYX", np.stack([yaw(t), 0.05 + 0.03 * np.sin(2 * w * t), 0.04 * np.sin(w * t)], 1))
    q[:, :BASE] = np.column_stack([place(t), 0.73 + 0.015 * np.sin(2 * w * t), turned.as_rotvec()])
    q[:, BASE:] = np.clip(q[:, BASE:], np.array(G1.lower)[BASE:], np.array(G1.upper)[BASE:])
    feet = [_steps(t, pace, phase + 0.5 * k, 0.12 - 0.24 * k, place, yaw) for k in range(2)]
    q[:, [G1.joint_names.index(name) for name in LEGS.joint_names]] = _legs(q[:, :3], turned, feet)
    seen = np.array(poses(q))
    seen[..., 3] += 0.005 * rng.normal(size=seen.shape[:3])
    noise = Rotation.from_rotvec(np.deg2rad(1) * rng.normal(size=(FRAMES * len(TIPS), 3))).as_matrix()
    seen[..., :3] = noise.reshape(*seen.shape[:2], 3, 3) @ seen[..., :3]
    return Clip(q, seen)


def _path(start):
    """Functions of time: place (…, 2) and direction of a walk at 0.45 m/s along a circle."""
    yaw, radius = (lambda t: start + 0.35 * t), 0.45 / 0.35
    return (lambda t: radius * np.stack([np.sin(yaw(t)), -np.cos(yaw(t))], -1)), yaw


def _steps(t, pace, phase, aside, place, yaw):
    """(positions (F, 3), rotations) of a foot that steps so many times a second."""
    cycle = pace * t + phase
    swing = np.clip((cycle % 1 - 0.6) / 0.4, 0, 1)

    def hold(k):  # where it stands: where the walk is in the middle of the time
        middle = (k + 0.3 - phase) / pace
        return place(middle) + aside * np.stack([-np.sin(yaw(middle)), np.cos(yaw(middle))], -1), yaw(middle)

    (here, turn), (there, turned) = hold(np.floor(cycle)), hold(np.floor(cycle) + 1)
    share = swing**2 * (3 - 2 * swing)
    at = np.column_stack([here + share[:, None] * (there - here), 0.035 + 0.06 * np.sin(np.pi * swing) ** 2])
    return at, Rotation.from_euler("z", (turn + share * (turned - turn))[:, None])


def _legs(place, turned, feet):
    """Joint values (F, 12) of the legs that put the feet there, from a base (F, 3) and its rotations."""
    targets, back = {}, turned.inv()
    for tip, (at, turn) in zip(FEET, feet, strict=True):
        targets[tip] = back.apply(at - place), (back * turn).as_matrix()
    squat = np.tile([-0.3, 0.0, 0.0, 0.6, -0.3, 0.0], 2)
    found = ck.reach(LEGS, targets, task=ck.pose(tip=FEET[0]) & ck.pose(tip=FEET[1]), near=squat)
    assert found.solved.all()
    return found.q


@jax.jit
@jax.vmap
def poses(q):
    """(tips, 3, 4) of all tips."""
    every = [ck.forward(G1, q, tip=tip) for tip in TIPS]
    return jnp.stack([jnp.concatenate([at.rotation, at.position[:, None]], 1) for at in every])


def begun(q0, seen):
    """Where each of several clips begins: with the first's joints, and the base where it is seen."""
    q, pelvis = np.repeat(q0[None], len(seen), 0), seen[:, 0, TIPS.index("pelvis")]
    q[:, :3], q[:, 3:6] = pelvis[..., 3], Rotation.from_matrix(pelvis[..., :3]).as_rotvec()
    return q


class Quality(NamedTuple):
    links: float  # RMS off the truth of all links [mm], after half a second
    feet: float  # of the feet [mm]
    beyond: float  # of position limits, at most [rad]
    faster: float  # than velocity limits, at most [rad/s]


def quality(q, clip):
    """How good an answer q (F, n) is."""
    begun, ours, truth = FRAMES // 40, np.asarray(poses(q))[..., 3], np.asarray(poses(clip.truth))[..., 3]
    off, feet = np.linalg.norm(ours - truth, axis=-1)[begun:], slice(0, len(FEET))
    beyond = np.max(np.maximum(np.array(G1.lower) - q, q - np.array(G1.upper)))
    faster = np.max(FPS * np.abs(np.diff(q[:, BASE:], axis=0)) - np.array(G1.velocity_limit)[BASE:])
    rms = [1e3 * float(np.sqrt(np.mean(one**2))) for one in (off, off[:, feet])]
    return Quality(*rms, max(0.0, float(beyond)), max(0.0, float(faster)))


# --- what is measured ---------------------------------------------------------------------------------


def mink_run(truth, seen):
    """A call to q (F, n) by mink, with the same weights, damping and limits."""
    import mink
    import mujoco

    spec = mujoco.MjSpec.from_string(without_meshes(robot_file("g1")))
    spec.body("pelvis").add_freejoint()
    model = spec.compile()
    more = dict.fromkeys(FEET, DAMPING[1] / DAMPING[0])  # the feet's level as a weight
    place, turn = (lambda tip, w=w: w * more.get(tip, 1.0) for w in WEIGHTS)
    tasks = {tip: mink.FrameTask(tip, "body", position_cost=place(tip), orientation_cost=turn(tip)) for tip in TIPS}
    speeds = dict(zip(G1.joint_names[BASE:], G1.velocity_limit[BASE:], strict=True))
    limits = [mink.ConfigurationLimit(model, gain=1.0), mink.VelocityLimit(model, speeds)]
    start = ck.to_model_q(G1, model, begun(truth[0], seen[None])[0])

    def run():
        configuration, found = mink.Configuration(model, q=start), []
        for frame in seen:
            for tip, one in zip(TIPS, frame, strict=True):
                tasks[tip].set_target(mink.SE3.from_matrix(np.vstack([one, [0.0, 0.0, 0.0, 1.0]])))
            for _ in range(STEPS):
                how = {"damping": DAMPING[1] ** 2, "limits": limits}
                configuration.integrate_inplace(mink.solve_ik(configuration, [*tasks.values()], TS, "daqp", **how), TS)
            found.append(configuration.q.copy())
        return ck.from_model_q(G1, model, np.array(found))

    return run


def speeds(clips, quick):
    """Rows (what, frames/s, CPU seconds of the first call, answer q (F, n) of the first clip)."""
    (truth, seen), run = clips[0], retarget(law())
    calls = {}
    if not quick:
        many = ck.lanes(run, cores=1)
        every, starts = np.stack([c.seen for c in clips]), np.stack([begun(c.truth[0], c.seen[None])[0] for c in clips])
        short = [np.asarray(x, np.float32) for x in (starts, every)]
        calls["64 clips, `lanes`"] = lambda: many(starts, every), len(clips), lambda q: np.asarray(q)[0]
        calls["64 clips, `lanes`, float32"] = lambda: many(*short), len(clips), lambda q: np.asarray(q, float)[0]
        alone = jax.jit(run)
        calls["one clip, `jax.jit`"] = lambda: alone(begun(truth[0], seen[None])[0], seen), 1, np.asarray
    calls["one clip without a C compiler, `jax.jit`"] = without_compiler(clips[0], seen), 1, np.asarray
    calls["mink, daqp"] = mink_run(truth, seen), 1, np.asarray
    rows = []
    for name, (call, count, answer) in calls.items():
        first = timing.first(call)  # with its compiler
        seconds = statistics.median(timing.cpu(call) for _ in range(3))
        rows.append((name, count * FRAMES / seconds, first, answer(call())))
        print(f"{name}: {rows[-1][1]:,.0f} frames/s, first call {first:.1f} s", flush=True)
    return rows


def without_compiler(clip, seen):
    """A call to q (F, n) of one clip, as where there is no C compiler."""
    alone, start = jax.jit(retarget(law())), begun(clip.truth[0], seen[None])[0]

    def run():
        with ck.use_engine("plain"):
            return alone(start, seen)

    return run


def table(rows, clip):
    """Speeds and accuracies as Markdown."""
    slow = rows[-1][1]
    head = ("", "frames/s", "times mink", "first call, CPU [s]", "RMS of all links [mm]", "of the feet [mm]")
    off = [quality(q, clip) for *_, q in rows]
    each = [(name, f"{rate:,.0f}", f"{rate / slow:.3g}", f"{first:.2g}", f"{q.links:.2f}", f"{q.feet:.2f}")
            for (name, rate, first, _), q in zip(rows, off, strict=True)]  # fmt: skip
    return markdown(head, each)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one clip without a compiler, and mink")
    jax.config.update("jax_enable_x64", True)
    quick = parser.parse_args(argv).quick
    clips = [clip(seed) for seed in range(1 if quick else CLIPS)]
    print(table(speeds(clips, quick), clips[0]))


if __name__ == "__main__":
    timing.one_core()
    main()
