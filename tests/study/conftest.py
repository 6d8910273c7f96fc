import pytest


@pytest.fixture(scope="session")
def results():
    """All runs of the paper's experiments, computed once."""
    from cnclik.study import paper_data

    return paper_data.everything()
