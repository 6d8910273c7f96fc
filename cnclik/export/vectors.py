"""Vectors: inputs of a test, and what comes out of them, for `example.c`."""

import numpy as np

from cnclik.native.evaluate import evaluate
from cnclik.reaching.result import ReachStatus
from cnclik.robot.kinematics import pose
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
        targets = [pose(chain, row + random.uniform(-0.05, 0.05, chain.n)) for row in q]
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
    if program.graph is None:
        lost = np.isnan(given["input.q"]).any(1, keepdims=True)
        return {"output.status": np.where(lost, int(ReachStatus.NON_FINITE), int(ReachStatus.SOLVED))}
    found = iter(evaluate(program.graph, program.ends, given))
    return {
        f"{group}.{f.name}": np.stack([next(found) for _ in nodes], -1)
        for group, fields in program.outputs.items()
        for f, nodes in fields
    }
