"""The search as a pure function: where it starts, and that it is the one that C makes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.engine.compiler import can_build
from cnclik.reaching import native, search, single, strategy
from cnclik.reaching.asked import asked_of
from cnclik.reaching.seeds import SETS, compared, seeds
from cnclik.reaching.single import Programs
from cnclik.task.build import pose
from cnclik.threads import shares_threads
from tests.reaching.test_reach import WRIST, drawn, tips


def asked(chain):
    return asked_of(chain, pose(), (1e-6, 1e-6), None, None, 64, 4000, 0, True, True)


def test_tries_beyond_the_sets_start_elsewhere():
    chain = ck.panda()
    to, phase = compared(chain, pose()), strategy.phases(asked(chain))[1]
    of = search.given(asked(chain), seeds(chain).postures, to, np.float64)
    made, bounds = search.nothing((), chain.n, float, jnp), (np.array(chain.lower), np.array(chain.upper))

    def start(k):
        return search.start(of, phase, made, np.eye(1, 12)[0], None, bounds, k)[0]

    tried = jax.jit(jax.vmap(start))(np.arange(3 * SETS))
    assert len(np.unique(np.asarray(tried).round(9), axis=0)) == len(tried)


def test_tries_call_no_lapack():
    """Blocks of them run side by side."""
    chain = ck.panda()
    of = search.given(asked(chain), seeds(chain).postures, compared(chain, pose()), np.float64)
    phase, made = strategy.phases(asked(chain))[0], search.nothing((), chain.n, float, jnp)
    traced = jax.make_jaxpr(lambda target: search.tries(of, phase, made, target, None, 0, 1))(np.eye(1, 12)[0])
    assert not shares_threads(traced.jaxpr)


@pytest.mark.skipif(not can_build(), reason="there is no C compiler")
@pytest.mark.parametrize("near", [False, True])
def test_each_try_comes_to_what_it_comes_to_in_c(near):
    """Plain and careful ones, from seeds and about `near`, within the limits and free of them: to rounding."""
    one, other = native.native_for(asked(WRIST), True), Programs(asked(WRIST), soon=near)
    there = tips(WRIST, drawn(WRIST, 40))
    there = np.concatenate([there[:, :3, 3], there[:, :3, :3].reshape(-1, 9)], axis=1)
    at = drawn(WRIST, 40, seed=1) if near else None
    for k in (0, 1, 4, 5, 15, 16, 17, 40, 200):
        for wide in (False, True):
            found = [made.tried(there, at, np.full(40, k), wide) for made in (one, other)]
            same = [np.isclose(*v, rtol=1e-6, atol=1e-9).reshape(40, -1).all(axis=1) for v in zip(*found, strict=True)]
            assert np.mean(np.all(same[5:], axis=0)) >= 0.95, (k, wide)  # a rounding may cost a look
            assert (found[0].found == found[1].found).mean() >= 0.95
    again = [made.descended(there, at, drawn(WRIST, 40, seed=2)) for made in (one, other)]
    assert (again[0].found == again[1].found).mean() >= 0.95 and again[0].found.sum() > 10


@pytest.mark.slow
@pytest.mark.skipif(not can_build(), reason="there is no C compiler")
def test_hard_targets_have_the_statuses_that_c_finds(monkeypatch):
    """Of the program that an arm without a compiler has for its later tries once many were hard."""
    monkeypatch.setattr(single, "HARD", -1)
    held = ck.replace(WRIST, lower=(-1.0,) * 6, upper=(1.0,) * 6)
    within, beyond = tips(held, drawn(held, 20, seed=3)), tips(WRIST, drawn(WRIST, 20))
    targets, near = np.concatenate([within, beyond]), drawn(held, 40, seed=4)
    for given in ({}, {"near": near}, {"near": near, "jump": 0.3}):
        one = ck.reach(held, targets, **given)
        with ck.use_engine("xla"):
            other = ck.reach(held, targets, **given)
        assert (one.solved == other.solved).all() and (one.status == other.status).mean() >= 0.95
