"""What `tests.bench.reach` changes in the search, to measure what it is worth, is there to be changed."""

from cnclik.reaching import native
from tests.bench import reach_more


def test_each_changed_part_is_another():
    for changes in reach_more.PARTS.values():
        for (module, name), value in changes.items():
            assert getattr(module, name) is not value
    assert native.SEARCH != reach_more.AT_RANDOM in reach_more.PARTS["seeds at random, not the nearest"].values()
