"""The search in batches: where it starts."""

import numpy as np

import cnclik as ck
from cnclik.law.task import pose
from cnclik.reaching import search
from cnclik.reaching.asked import asked_of
from cnclik.reaching.seeds import SETS


def test_tries_beyond_the_sets_start_elsewhere():
    """Also where so many targets are left that each gets one seed at a time."""
    chain = ck.panda()
    setup = search.setup_of(asked_of(chain, pose(), (1e-6, 1e-6), None, None, 64, 4000, 0, True, True))
    targets = search.Targets(np.tile(np.eye(1, 12), (3, 1)), (np.array(chain.lower), np.array(chain.upper)), None)
    places = np.zeros((3, search.PLACES, chain.n))
    tried = np.array([search._starts(setup, targets, done, 1, places)[0] for done in range(3 * SETS)])
    assert len(np.unique(tried.round(9), axis=0)) == len(tried)
