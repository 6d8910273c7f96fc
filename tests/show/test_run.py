"""Figures of one run, from trajectories made by hand: nothing is solved here."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb

import cnclik as ck
from cnclik.measure import to_dataset
from cnclik.show import run as pictures
from cnclik.show import style

N = 20
LAW = ck.Law(
    ck.from_dh([1.0, 0.8], [0.0, 0.0], [0.0, 0.0], lower=[-1.0, -9.0], upper=[1.0, 9.0], velocity_limit=[0.5, 2.0]),
    ck.pose("x", "z"),
    alpha=1.0,
)
BITS = [bit for bit in ck.Status if bit]


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def run(qdot=None, status=None):
    """A run whose first joint moves at qdot (N,) and whose second rests."""
    qdot = np.c_[np.full(N, 0.1) if qdot is None else qdot, np.zeros(N)]
    q = np.concatenate([np.zeros((1, 2)), np.cumsum(0.1 * qdot, axis=0)])
    return ck.Trajectory(
        t=0.1 * np.arange(N + 1),
        q=q,
        x=q,
        e=np.geomspace(1, 1e-6, N + 1)[:, None] * [1.0, 0.5],
        qdot=qdot,
        residual=np.zeros(N),
        contraction=np.zeros(N),
        status=np.zeros(N, int) if status is None else status,
        evaluations=np.asarray(N),
    )


def limits(panel):
    """Heights of the limit lines of a panel."""
    return sorted(
        line.get_ydata()[0] for line in panel.lines if to_rgb(line.get_color()) == to_rgb(style.LIMIT["color"])
    )


@pytest.mark.parametrize("kind, panels", [("overview", 4), ("joints", 2), ("velocities", 2), ("tip", 1)])
def test_every_kind_is_a_figure(kind, panels, tmp_path):
    figure = pictures.plot(run(), LAW, kind)
    assert isinstance(figure, plt.Figure) and len(figure.axes) == panels
    with style.style():
        style.save(figure, tmp_path / "one.png", {"Title": kind})
    assert (tmp_path / "one.png").stat().st_size > 5000


@pytest.mark.parametrize(
    "swing, drawn", [((0.1, -0.1), []), ((0.4, -0.1), [0.5]), ((0.1, -0.7), [-0.5]), ((1.0, -1.05), [-0.5, 0.5])]
)
def test_velocity_limits_on_each_side_that_comes_near(swing, drawn):
    data = to_dataset(run(np.resize(swing, N)), LAW)
    first, second = pictures.joint_velocities(data, LAW.chain).axes
    assert limits(first) == drawn and limits(second) == []
    assert limits(pictures.joint_velocities(data).axes[0]) == []  # without a chain there are no limits


def test_position_limits_where_a_path_comes_near():
    near = to_dataset(run(np.full(N, 0.4)), LAW)  # from 0 to 0.8 of 1
    assert limits(pictures.joint_paths(near, LAW.chain).axes[0]) == [1.0]


def test_numbers_that_are_not_finite_are_drawn_around():
    qdot = np.where(np.arange(N) < 10, 0.3, np.nan)
    for kind in pictures.KINDS:
        pictures.plot(run(qdot), LAW, kind).canvas.draw()


def test_the_tips_path_is_that_of_the_joints_and_ends_at_its_target():
    space = ck.from_dh([0.0, 1.0], [np.pi / 2, 0.0], [0.5, 0.0])  # turns about z, then lifts
    law = ck.Law(space, ck.position("xz"), alpha=1.0)
    made = run()
    way = np.array([ck.forward(space, q).position for q in made.q])
    made = ck.replace(made, x=way[:, [0, 2]], e=[0.1, -0.2] - 0 * way[:, :2])
    tip, target, start = pictures.plot(made, law, "tip").axes[0].lines
    np.testing.assert_allclose(np.transpose(tip.get_data_3d()), way, atol=1e-12)
    np.testing.assert_allclose(np.transpose(target.get_data_3d()), np.add(way, [0.1, 0.0, -0.2]), atol=1e-12)
    np.testing.assert_allclose(np.transpose(start.get_data_3d()), way[:1], atol=1e-12)
    flat = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=1.0)
    assert pictures.plot(run(), flat, "tip").axes[0].name != "3d"


def test_what_is_lost_is_red_and_a_warning_amber():
    status = np.zeros(N, int)
    status[:2] = ck.Status.DIVERGED, ck.Status.AT_LIMIT
    shown = pictures.plot(run(status=status), LAW).axes[3]
    names = [label.get_text() for label in shown.get_yticklabels()]
    colors = [to_rgb(bars.get_facecolor()[0][:3]) for bars in shown.collections if len(bars.get_paths())]
    rows = ("at limit", "diverged")
    assert sorted(names.index(name) for name in rows) == [names.index(name) for name in rows]
    assert colors == [to_rgb(color) for color in (style.WARNING, style.LOST)]


def test_status_has_a_row_for_every_bit():
    status = np.zeros(N, int)
    status[3:6] = BITS[0].value
    status[5:] |= BITS[-1].value
    panel = pictures.plot(run(status=status), LAW).axes[3]
    assert [t.get_text() for t in panel.get_yticklabels()] == [b.name.replace("_", " ").lower() for b in BITS]
    bars = [[box.get_extents() for box in row.get_paths()] for row in panel.collections]
    assert [len(row) for row in bars] == [1, *[0] * (len(BITS) - 2), 1]  # neighbouring steps are one bar
    np.testing.assert_allclose([bars[0][0].x0, bars[0][0].x1], [0.3, 0.6])
    assert not panel.texts
    assert "every step OK" in pictures.plot(run(), LAW).axes[3].texts[0].get_text()


def test_methods_are_lines_of_their_own():
    data = xr.concat(
        [to_dataset(run(np.full(N, v)), LAW) for v in (0.1, 0.2)], xr.IndexVariable("method", ["EE", "CN"])
    )
    for draw, at in ((pictures.joint_paths, "lines"), (pictures.joint_velocities, "patches")):
        figure = draw(data)
        assert [len(getattr(panel, at)) for panel in figure.axes] == [2, 2]
        assert [t.get_text() for t in figure.legends[0].get_texts()] == ["EE", "CN"]
        colors = [
            to_rgb((getattr(line, "get_color", None) or line.get_edgecolor)()) for line in getattr(figure.axes[0], at)
        ]
        assert colors == [to_rgb(style.METHODS[m].color) for m in ("EE", "CN")]


def test_what_cannot_be_drawn_is_one_line():
    with pytest.raises(ck.ArgumentError, match="did you mean 'joints'"):
        pictures.plot(run(), LAW, "joint")
    batch = ck.replace(run(), residual=np.zeros((3, N)))
    with pytest.raises(ck.ArgumentError, match="Argument `run` must be one lane, but has 1 leading axes"):
        pictures.plot(batch, LAW)


def test_panels_name_their_quantity_and_the_limits_and_none_is_empty():
    near = to_dataset(run(np.full(N, 0.4)), LAW)
    paths, speeds = pictures.joint_paths(near, LAW.chain), pictures.joint_velocities(near, LAW.chain)
    assert [p.get_ylabel() for p in paths.axes] == ["$q$ [rad]"] * 2
    assert [p.get_ylabel() for p in speeds.axes] == [r"$\dot q$ [rad/s]"] * 2
    for figure in (paths, speeds, pictures.overview(near, LAW.chain)):
        told = [text.get_text() for p in figure.axes if p.get_legend() for text in p.get_legend().get_texts()]
        assert told.count("limit") == 1
    arm = ck.panda()
    law = ck.Law(arm, ck.position(), alpha=1.0)
    seven = pictures.joint_paths(to_dataset(ck.solve(law, ck.hold([0.5, 0, 0.5]), np.zeros(7), 0.01, 3), law))
    shown = [p for p in seven.axes if p.axison]
    assert len(shown) == 7 and [p.get_xlabel() for p in shown].count("time $t$ [s]") == 2
    assert shown[6].get_xlabel() and shown[6].xaxis.get_tick_params()["labelbottom"]
