"""The search in batches: where it starts."""

import numpy as np

import cnclik as ck
from cnclik.law.task import pose
from cnclik.reaching import search
from cnclik.reaching.seeds import SETS, compared, seeds


def test_tries_beyond_the_sets_start_elsewhere():
    """Also where so many targets are left that each gets one seed at a time."""
    chain = ck.panda()
    known = seeds(chain)
    setup = search.Setup(chain, pose(), None, known, compared(known, pose()), np.full(2, 1e-6), 64, 4000, 0)
    targets = search.Targets(np.tile(np.eye(1, 12), (3, 1)), (np.array(chain.lower), np.array(chain.upper)), None)
    places = np.zeros((3, search.PLACES, chain.n))
    tried = np.array([search._starts(setup, targets, done, 1, places)[0] for done in range(3 * SETS)])
    assert len(np.unique(tried.round(9), axis=0)) == len(tried)
