import pytest


@pytest.fixture(scope="session")
def results():
    """All runs of the paper's experiments, computed once."""
    from cnclik.paper import data as paper_data

    return paper_data.everything()
