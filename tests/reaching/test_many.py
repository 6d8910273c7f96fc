"""Batches: cut into pools, with progress that goes on."""

import numpy as np

import cnclik as ck
from cnclik.reaching import many


def test_more_targets_than_a_pool_holds(monkeypatch):
    arm, told = ck.planar_arm([1.0, 1.0]), []
    targets = np.stack([np.linspace(0.2, 1.9, 50), np.zeros(50), np.zeros(50)], axis=1)
    task = ck.position("xy")
    whole = ck.reach(arm, targets, task=task)
    monkeypatch.setattr(many, "POOL", 20)
    parts = ck.reach(arm, targets, task=task, progress=lambda done, total: told.append((done, total)))
    assert parts.solved.all() and parts.q.shape == whole.q.shape
    assert told[-1] == (50, 50) and {total for _, total in told} == {50}
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    near = ck.reach(arm, targets, task=task, near=whole.q, jump=0.1)
    assert near.solved.all() and near.distance.max() < 1e-5
