"""The figure of where a robot can put its tip: the numbers it was given, where they are."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import cnclik as ck
from cnclik.show import reach as pictures

ARM = ck.planar_arm([1.0, 0.6])


@pytest.fixture(scope="module")
def found():
    return ck.reachability(ARM, "xy", task="position", cells=9)


def shown(panel):
    """What a panel's colours are of, NaN where it is left empty."""
    return np.ma.filled(panel.collections[0].get_array().astype(float), np.nan)


def test_a_plane_has_its_share_and_its_distance_from_singular_answers(found):
    figure = pictures.reachability(found, title="arm")
    share, singular, *bars = figure.axes
    assert (share.get_xlabel(), share.get_ylabel()) == ("x [m]", "y [m]") and len(bars) == 2
    assert [bar.get_xlabel() for bar in bars] == ["reached", "least singular value, median (lengths in m)"]
    values = shown(share).reshape(9, 9)
    np.testing.assert_array_equal(np.nan_to_num(values), found.share.T)  # y up; what is not reached is left empty
    x, y = np.meshgrid(*found.places)
    away = np.hypot(x, y)
    reached = (away > 0.4) & (away < 1.6)  # the ring between the stretched and the folded arm
    clear = (np.abs(away - 0.4) > 1e-3) & (np.abs(away - 1.6) > 1e-3)
    np.testing.assert_array_equal(~np.isnan(values[clear]), reached[clear])
    line = singular.lines[-1]
    np.testing.assert_allclose(np.transpose(line.get_data()), found.arm[:, :2])
    plt.close(figure)


def test_a_box_has_the_best_along_each_axis():
    found = ck.reachability(ck.panda(), "box", task="position", cells=4, seeds=4)
    figure = pictures.reachability(found)
    panels = figure.axes[:3]
    assert [(p.get_xlabel(), p.get_ylabel()) for p in panels] == [
        ("x [m]", "y [m]"),
        ("x [m]", "z [m]"),
        ("y [m]", "z [m]"),
    ]
    for panel, gone in zip(panels, (2, 1, 0), strict=True):
        np.testing.assert_array_equal(np.nan_to_num(shown(panel).reshape(4, 4)), found.share.max(gone).T)
    plt.close(figure)
