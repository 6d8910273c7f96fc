from pathlib import Path

import pytest

COMMITTED = Path(__file__).parents[2] / "results" / "paper"


def load(folder):
    """The datasets of a folder that `cnclik reproduce` has written."""
    import xarray as xr

    from cnclik.paper.data import Results

    return Results(*(xr.load_dataset(folder / f"{name}.nc") for name in Results._fields))


@pytest.fixture(scope="session")
def results():
    """The committed runs: `test_reproduce` compares them with what the code gives, once, for all tests."""
    return load(COMMITTED)
