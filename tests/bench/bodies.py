"""`python -m tests.bench.bodies [--quick]`: motion clips retargeted to G1 on one core, beside mink.

A clip is 600 frames at 30 Hz of walking and waving, whose truth is known. What is seen of it, the poses of 14 frames
with 5 mm and 1° of noise, is followed by two steps a frame: feet before the rest, within position and velocity limits
of the joints. All get the same targets, weights, damping and limits. By CPU time, medians. mink and daqp are needed,
and example-robot-data. A minute and a half; --quick leaves out what is compiled.
"""

import argparse
import functools
import operator
import resource
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.integrate.solve import end
from tests.bench.stacks import _without_meshes
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
PIECES, RUN_IN = 8, 15  # of one clip in lanes
G1 = ck.load_urdf(robot_file("g1"), tips=TIPS, base="free")
BASE = 6  # coordinates of the base


def law(limits=True):
    def poses(tips):
        weights = [WEIGHTS[0]] * 3 + [WEIGHTS[1]] * 3
        return functools.reduce(operator.and_, (ck.pose(tip=tip, weights=weights) for tip in tips))

    inverse = ck.levels(["feet"], ["body"], damping=DAMPING)
    held = ck.bounded(rate=1 / TS) if limits else None
    return ck.Law(G1, ck.stack(feet=poses(FEET), body=poses(BODY)), alpha=1 / TS, inverse=inverse, limits=held)


def retarget(law):
    """(q0 (n,), clip (F, tips, 3, 4)) to q (F, n)."""

    def frame(q, seen):
        held = {tip: ck.hold(seen[i, :, 3], seen[i, :, :3]) for i, tip in enumerate(TIPS)}
        feet, body = (ck.references(**{tip: held[tip] for tip in tips}) for tips in (FEET, BODY))
        q = end(law, ck.references(feet=feet, body=body), q, TS, STEPS, ck.METHODS["EE"], ck.picard(1))[0]
        return q, q

    return lambda q0, clip: jax.lax.scan(frame, q0, clip)[1]


# --- clips ----------------------------------------------------------------------------------------------


def clip(seed):
    """(truth q (F, n), what is seen of it (F, tips, 3, 4))"""
    rng, t = np.random.default_rng(seed), np.arange(FRAMES) / FPS
    w, phase = 2 * np.pi * rng.uniform(0.8, 1.0), rng.uniform(0, 6)
    moves = {f"waist_{axis}": (0.0, size, 1.0) for axis, size in (("yaw", 0.25), ("roll", 0.08), ("pitch", 0.1))}
    for k, side in enumerate(SIDES):
        own = {"hip_pitch": (-0.25, 0.35, 0), "knee": (0.5, 0.4, -1), "ankle_pitch": (-0.25, 0.15, 0.5),
               "hip_roll": (0.03 - 0.06 * k, 0.06, 0), "shoulder_pitch": (0.2, -0.4, 0), "elbow": (0.6, 0.3, 0),
               "shoulder_roll": (0.25 - 0.5 * k, 0.1, 0), "wrist_roll": (0, 0.3, 0),
               "wrist_pitch": (0, 0.2, 0)}  # fmt: skip
        moves |= {f"{side}_{name}": (mean, size, late + k * np.pi) for name, (mean, size, late) in own.items()}
    q = np.zeros((FRAMES, G1.n))
    for name, (mean, size, late) in moves.items():
        q[:, G1.joint_names.index(f"{name}_joint")] = mean + size * np.sin(w * t + phase + late)
    waving = 1 / (1 + np.exp(4 * np.abs(t - 10) - 16))
    for name, size in (("shoulder_pitch", -1.2), ("shoulder_roll", -0.9), ("elbow", 0.4)):
        q[:, G1.joint_names.index(f"right_{name}_joint")] += size * waving
    yaw = 0.35 * t + phase
    turned = Rotation.from_euler("ZYX", np.stack([yaw, 0.08 * np.sin(2 * w * t), 0.05 * np.sin(w * t)], 1))
    ahead = np.cumsum(0.9 / FPS * np.stack([np.cos(yaw), np.sin(yaw)], 1), axis=0)
    q[:, :BASE] = np.column_stack([ahead, 0.78 + 0.03 * np.sin(2 * w * t), turned.as_rotvec()])
    q[:, BASE:] = np.clip(q[:, BASE:], np.array(G1.lower)[BASE:] + 0.02, np.array(G1.upper)[BASE:] - 0.02)
    seen = np.array(poses(q))
    seen[..., 3] += 0.005 * rng.normal(size=seen.shape[:3])
    noise = Rotation.from_rotvec(np.deg2rad(1) * rng.normal(size=(FRAMES * len(TIPS), 3))).as_matrix()
    seen[..., :3] = noise.reshape(*seen.shape[:2], 3, 3) @ seen[..., :3]
    return q, seen


@jax.jit
@jax.vmap
def poses(q):
    """(tips, 3, 4) of all tips."""
    every = [ck.forward(G1, q, tip=tip) for tip in TIPS]
    return jnp.stack([jnp.concatenate([at.rotation, at.position[:, None]], 1) for at in every])


def pieces(seen):
    """One clip in so many, each with the frames before it to run in: (PIECES, RUN_IN + F/PIECES, tips, 3, 4)."""
    length = FRAMES // PIECES
    at = np.arange(PIECES)[:, None] * length + np.arange(-RUN_IN, length)
    return seen[np.maximum(at, 0)]


def begun(q0, seen):
    """Where each of several clips begins: with the first's joints, and the base where it is seen."""
    q, pelvis = np.repeat(q0[None], len(seen), 0), seen[:, 0, TIPS.index("pelvis")]
    q[:, :3], q[:, 3:6] = pelvis[..., 3], Rotation.from_matrix(pelvis[..., :3]).as_rotvec()
    return q


def quality(q, truth):
    """RMS of all links and of the feet off the truth [mm], after half a second; what is beyond limits [rad]."""
    off = np.linalg.norm(np.asarray(poses(q) - poses(truth))[FRAMES // 40 :, :, :, 3], axis=-1)
    beyond = max(0.0, np.max(np.array(G1.lower) - q), np.max(q - np.array(G1.upper)))
    return [1e3 * np.sqrt(np.mean(one**2)) for one in (off, off[:, : len(FEET)])], beyond


# --- what is measured ---------------------------------------------------------------------------------


def cpu(call, rounds=5):
    """(CPU seconds of a call, the median of some; of the first one with its compiler; its answer)"""

    def spent():
        return time.process_time() + resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime

    start = spent()
    found = jax.block_until_ready(call())
    first, each = spent() - start, []
    for _ in range(rounds):
        start = time.process_time()
        jax.block_until_ready(call())
        each.append(time.process_time() - start)
    return statistics.median(each), first, found


def mink_run(truth, seen):
    """A call to q (F, n) by mink, with the same weights, damping and limits."""
    import mink
    import mujoco

    spec = mujoco.MjSpec.from_string(_without_meshes(robot_file("g1")))
    spec.body("pelvis").add_freejoint()
    model = spec.compile()
    more = dict.fromkeys(FEET, DAMPING[1] / DAMPING[0])  # the feet's level as a weight
    place, turn = (lambda tip, w=w: w * more.get(tip, 1.0) for w in WEIGHTS)
    tasks = {tip: mink.FrameTask(tip, "body", position_cost=place(tip), orientation_cost=turn(tip)) for tip in TIPS}
    speeds = dict(zip(G1.joint_names[BASE:], G1.velocity_limit[BASE:], strict=True))
    limits = [mink.ConfigurationLimit(model, gain=1.0), mink.VelocityLimit(model, speeds)]
    start = ck.to_mujoco_q(G1, model, begun(truth[0], seen[None])[0])

    def run():
        configuration, found = mink.Configuration(model, q=start), []
        for frame in seen:
            for tip, one in zip(TIPS, frame, strict=True):
                tasks[tip].set_target(mink.SE3.from_matrix(np.vstack([one, [0.0, 0.0, 0.0, 1.0]])))
            for _ in range(STEPS):
                how = {"damping": DAMPING[1] ** 2, "limits": limits}
                configuration.integrate_inplace(mink.solve_ik(configuration, [*tasks.values()], TS, "daqp", **how), TS)
            found.append(configuration.q.copy())
        return ck.from_mujoco_q(G1, model, np.array(found))

    return run


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one clip without a compiler, and mink")
    jax.config.update("jax_enable_x64", True)
    quick = parser.parse_args(argv).quick
    clips = [clip(seed) for seed in range(1 if quick else CLIPS)]
    (truth, seen), run = clips[0], retarget(law())
    every, starts = np.stack([c[1] for c in clips]), np.stack([begun(q[0], s[None])[0] for q, s in clips])
    cut = pieces(seen)
    whole = lambda q: np.asarray(q)[:, RUN_IN:].reshape(FRAMES, -1)  # noqa: E731
    rows = {}
    if not quick:
        many = ck.lanes(run, cores=1)
        rows["64 clips"] = many, (starts, every), CLIPS, lambda q: np.asarray(q)[0]
        rows["one clip in 8 lanes"] = many, (begun(truth[0], cut), cut), 1, whole
    rows["one clip, no compiler"] = jax.jit(run), (starts[0], seen), 1, np.asarray
    print(f"{'':24} frames/s   first call [s]   rms [mm]   feet [mm]   beyond limits [rad]")
    rates = {}
    for name, (call, given, count, found) in rows.items():
        seconds, first, answer = cpu(lambda call=call, given=given: call(*given))
        rates[name] = _row(name, count * FRAMES / seconds, first, found(answer), truth)
    try:
        seconds, first, q = cpu(mink_run(truth, seen), 1 if quick else 3)
    except ImportError:
        return
    mink = _row("mink, daqp", FRAMES / seconds, first, q, truth)
    print("; ".join(f"{name}: {rate / mink:.1f} times mink" for name, rate in rates.items()))


def _row(name, rate, first, q, truth):
    (rms, feet), beyond = quality(q, truth)
    print(f"{name:24} {rate:8,.0f} {first:16.1f} {rms:10.2f} {feet:11.2f} {beyond:21.1e}", flush=True)
    return rate


if __name__ == "__main__":
    main()
