"""Vectors: inputs of a test, and what comes out of them, for `example.c`."""

import jax
import numpy as np

from cnclik.hints import QUICK_COMPILE, known_options
from cnclik.reaching.result import ReachStatus
from cnclik.robot.kinematics import forward
from cnclik.robot.posture import start_posture

COUNT = 8
TOLERANCE = {8: 1e-9, 4: 1e-3}  # by the size of a number: other compilers round differently


def inputs(asked, program, count=COUNT) -> dict:
    """{"group.name": (count, size)}: postures around a good one, targets near by; the last with a NaN in it."""
    random, chain, task = np.random.default_rng(0), asked.law.chain, asked.law.task
    start = np.asarray(start_posture(chain, task), float)
    q = start + random.uniform(-0.2, 0.2, (count, chain.n))
    known = {"q": q, "t": np.linspace(0, 1, count)[:, None], "Ts": np.full((count, 1), 0.01)}
    if any(f.name in ("position", "rotation") for f in program.inputs["input"]):
        targets = [forward(chain, row + random.uniform(-0.05, 0.05, chain.n)) for row in q]
        known["position"] = np.array([np.asarray(x.position)[list(task.linear)] for x in targets])
        known["rotation"] = np.array([np.ravel(x.rotation) for x in targets])
        known["velocity"] = random.uniform(-0.1, 0.1, (count, task.m))
    made = {}
    for group, fields in program.inputs.items():
        for f in fields:
            if group == "input":
                value = known[f.name]
            else:
                value = np.broadcast_to(np.ravel(0 if group == "history" else f.value), (count, f.size))
            value = value.astype(asked.dtype if f.kind == "real" else np.int32)
            made[f"{group}.{f.name}"] = value
    made["input.q"][-1, 0] = np.nan
    return made


def results(program, given) -> dict:
    """{"group.name": (count, size)} of all results; of a search the status alone."""
    if program.fn is None:
        lost = np.isnan(given["input.q"]).any(1, keepdims=True)
        return {"output.status": np.where(lost, int(ReachStatus.NON_FINITE), int(ReachStatus.SOLVED))}
    fields = [(f"{g}.{f.name}", f) for g, some in program.inputs.items() for f in some]
    flat = [given[key].reshape(-1, *f.shape) for key, f in fields]
    for i, value in sorted(program.fixed.items()):
        flat.insert(i, np.broadcast_to(value, (len(flat[0]), *value.shape)))
    with jax.enable_x64(any(x.dtype == np.float64 for x in flat)):
        found = jax.jit(jax.vmap(program.fn), compiler_options=known_options(QUICK_COMPILE))(*flat)
    keys = [f"{g}.{f.name}" for g, some in program.outputs.items() for f in some]
    return {key: np.asarray(x).reshape(len(x), -1) for key, x in zip(keys, found, strict=True)}
