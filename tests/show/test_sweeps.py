"""Figures of sweeps, on synthetic data: what goes where, where the theory's boundary is, and one of each kind."""

import itertools

import numpy as np
import pytest
import xarray
from matplotlib import colors
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import QuadContourSet

from cnclik.show import style, sweeps
from cnclik.show.sweeps import arrange, defaults, view
from tests.refusals import refusals

METHODS = ["EE", "IE", "CN"]
LIMITS = [2.0, 1.0, 1.2]
UNITS = {"alpha": ("α", "1/s"), "Ts": ("Ts", "s"), "z": ("z = α·Ts", "1")}


def data(limit=True, **axes):
    """A dataset such as a sweep makes: an error over the axes, infinite at the end of the last one, and its cost."""
    rng, shape, dims = np.random.default_rng(0), tuple(map(len, axes.values())), tuple(axes)
    coords = {}
    for name, values in axes.items():
        label, unit = UNITS.get(name, (name, "1"))
        coords[name] = (name, values, {"units": unit, "long_name": label})
    if "q0" in axes:
        coords["q0_value"] = (("q0", "q0_0"), rng.random((len(axes["q0"]), 2)), {"units": "rad"})
    if limit and "method" in axes:
        coords["limit"] = ("method", LIMITS, {"units": "1"})
    grid = xarray.Dataset(coords=coords)
    z = grid["z"] if "z" in axes else grid.get("alpha", 1.0) * grid.get("Ts", 1.0)
    grid = grid.assign_coords(alpha_Ts=z)
    error = (xarray.DataArray(rng.random(shape) * 1e-3 + 1e-6, dims=dims) + np.abs(1 - z) ** 5).transpose(*dims)
    error.values[..., -1] = np.inf
    evaluations = np.broadcast_to(np.arange(1, shape[-1] + 1.0) * 10, shape)
    about = {"units": "m", "long_name": "error ‖e‖, largest"}
    return grid.assign(max_error=(dims, 2 * error.values, about), evaluations=(dims, evaluations, {"units": "1"}))


PLANE = {"method": METHODS, "alpha": np.geomspace(1, 40, 12), "Ts": np.geomspace(0.01, 0.5, 10)}
HEAT = {"kind": "heat", "x": "alpha", "y": "Ts"}
WORK = {"kind": "slices", "x": "evaluations", "select": {"alpha": 5.0}}


def drawn(found, table):
    """The one figure of a table."""
    with style.style():
        (draw,) = sweeps.drawings(found, [table]).values()
        return draw()


# --- what goes where ----------------------------------------------------------------------------------

STAGES = {"case": ["reach", "track"], "stage": ["picard", "chord"]}
STARTS = {"method": METHODS, "q0": np.arange(20), "alpha": np.linspace(1, 9, 5), "Ts": np.linspace(0.1, 0.3, 4)}


@pytest.mark.parametrize(
    ("axes", "table", "places"),
    [
        (STAGES, {"kind": "heat"}, {"x": "alpha", "y": "Ts", "panels": "stage", "rows": "method", "middle": ("case",)}),
        (STAGES, {"kind": "slices"}, {"lines": "stage", "panels": "method", "rows": "case", "middle": ("Ts",)}),
        (STAGES, {"kind": "best"}, {"panels": "stage", "rows": "case"}),
        (STAGES, {"kind": "slices", "x": "evaluations"}, {"over": "Ts", "lines": "stage", "panels": "method"}),
        (STARTS, {"kind": "heat", "reduce": "min"}, {"reduced": ("q0",)}),
    ],
)
def test_every_dimension_gets_a_place(axes, table, places):
    layout = arrange(data(**axes, **({} if axes is STARTS else PLANE)), table)._asdict()
    assert {role: layout[role] for role in places} == places


def test_samples_are_summed_up():
    found = data(**STARTS)
    for reduce in ("min", "median"):
        shown = view(found, arrange(found, {"kind": "heat", "reduce": reduce}))
        np.testing.assert_array_equal(shown.max_error, getattr(found.max_error, reduce)("q0"))
        assert shown.max_error.attrs["units"] == "m"
    found["converged"] = (found.max_error < 0.5) * 1.0
    found.converged.attrs["long_name"] = "1 if ‖e[N]‖ ≤ tolerance"
    shown = view(found, arrange(found, {"kind": "slices", "value": "converged", "x": "Ts", "reduce": "mean"}))
    assert shown.converged.attrs["long_name"] == "share with ‖e[N]‖ ≤ tolerance"
    assert found.converged.attrs["long_name"].startswith("1 if")


def test_selections_and_middles():
    found = data(case=["a", "b"], M=np.arange(3), **PLANE, limit=False)
    shown = view(found, arrange(found, {"kind": "heat", "panels": "method", "select": {"case": "b", "M": 1}}))
    assert str(shown.case.values) == "b" and int(shown.M) == 1
    found = data(**PLANE)
    shown = view(found, arrange(found, {"kind": "slices", "x": "Ts", "select": {"alpha": 4.9}}))
    assert float(shown.alpha) == found.alpha.values[np.argmin(abs(found.alpha.values - 4.9))]
    assert drawn(found, {"kind": "slices", "x": "Ts"}).get_suptitle() == "α = 7.479 1/s"  # the middle of twelve
    found = data(arm=["5dof", "2.0"], **PLANE, limit=False)
    title = drawn(found, {"kind": "heat", "panels": "method", "select": {"arm": "2.0"}}).get_suptitle()
    assert title == "arm = 2.0" and sweeps.described(found.arm[0]) == "5dof"


test_figures_that_cannot_be = refusals(
    ({"kind": "heat", "value": "max_eror"}, "did you mean 'max_error'"),
    ({"kind": "heat", "select": {"alpha": 2.0}}, "must have two numeric axes, but is 'heat'"),
    ({"kind": "slices", "select": {"method": "RK4"}}, "`figure[0].select.method` must be one of EE, IE, CN"),
    ({"kind": "best", "select": {"method": "EE"}}, "must be 'heat' for a single method"),
    of=lambda **table: drawn(data(**PLANE), table),
)


def test_defaults_follow_from_the_grid():
    one = defaults(data(alpha=np.geomspace(1, 40, 12), Ts=[0.01], limit=False))  # an axis of one value has no plane
    assert [(t["kind"], t["x"]) for t in one] == [("slices", "alpha")]
    kinds = [(t["kind"], t.get("x")) for t in defaults(data(**PLANE))]
    assert kinds == [("heat", "alpha"), ("best", "alpha"), ("slices", "evaluations")]
    line = data(M=np.arange(3), alpha=np.linspace(1, 2, 4)).drop_vars("evaluations")
    assert [(t["kind"], t["x"], t["y"]) for t in defaults(line)] == [("heat", "alpha", "M")]
    tables = [{"kind": "heat"}, {"kind": "heat", "log": True}, {"kind": "heat", "name": "mine"}]
    assert list(sweeps.drawings(data(**PLANE), tables)) == ["heat_max_error", "heat_max_error_2", "mine"]
    assert "best_max_error" in sweeps.drawings(data(**PLANE), [])


WIDE, NARROW = np.geomspace(1e-14, 1, 100), np.linspace(1, 2, 50)


@pytest.mark.parametrize(
    ("values", "look", "logarithmic", "ends"),
    [
        (np.append(WIDE, [np.inf, np.nan]), {}, True, (1e-9, 1.0)),
        (np.append(WIDE, [2e3, 1e57]), {}, True, (1e-9, 1.0)),  # two that ran away
        (WIDE, {"limits": (0.1, 0.5)}, True, (0.1, 0.5)),
        (WIDE, {"log": False}, False, (1e-14, 1.0)),
        (NARROW, {}, False, (1, 2)),
        (NARROW, {"limits": (0, 5), "log": True}, True, (1, 5)),  # no logarithm begins at 0
        (np.full(3, np.nan), {}, False, (0, 1)),
        (np.zeros(4), {"log": True}, False, (0, 0)),  # nothing that a logarithm could show
    ],
)
def test_scales_follow_the_values(values, look, logarithmic, ends):
    found = sweeps.norm(values, arrange(data(**PLANE), {"kind": "heat"} | look))
    assert isinstance(found, colors.LogNorm) == logarithmic and (found.vmin, found.vmax) == ends


# --- the theory's boundary ----------------------------------------------------------------------------


def boundaries(figure):
    """The boundary's points in every panel of a figure."""
    lines = [[c for c in ax.collections if isinstance(c, QuadContourSet)] for ax in figure.axes[:-1]]
    return [[line.get_paths()[0].vertices for line in each] for each in lines]


def test_the_boundary_is_each_panels_own_limit():
    figure = drawn(data(**PLANE), HEAT | {"panels": "method"})
    for (points,), limit in zip(boundaries(figure), LIMITS, strict=True):
        np.testing.assert_allclose(points[:, 0] * points[:, 1], limit, rtol=1e-9)  # along an edge z is linear
    assert "limit" in figure.legends[0].get_texts()[0].get_text()
    assert len({(ax.collections[0].norm.vmin, ax.collections[0].norm.vmax) for ax in figure.axes[:3]}) == 1  # one scale
    assert boundaries(drawn(data(**PLANE, limit=False), HEAT)) == [[], [], []]
    other = data(method=METHODS, damping=np.geomspace(1e-3, 1, 6), distance=np.geomspace(1e-3, 1, 5))
    assert boundaries(drawn(other, {"kind": "heat", "x": "damping", "y": "distance"})) == [[], [], []]


def test_axes_out_of_order_are_drawn_in_order():
    found = data(**PLANE)
    turned = found.isel(alpha=np.r_[5:12, 0:5], Ts=slice(None, None, -1))
    (there, *_), (here, *_) = (drawn(some, HEAT | {"panels": "method"}).axes for some in (found, turned))
    np.testing.assert_array_equal(here.collections[0].get_array(), there.collections[0].get_array())
    np.testing.assert_array_equal(here.collections[0].get_coordinates(), there.collections[0].get_coordinates())


def test_a_limit_over_passes_meets_each():
    found = data(M=np.array([0, 1, 2, 5]), z=np.linspace(0.1, 3, 30))
    found = found.assign_coords(limit=("M", [2.0, 1.0, 1.35, np.inf]))
    figure = drawn(found, {"kind": "heat", "x": "z", "y": "M"})
    assert list(figure.axes[0].get_yticks()) == [0, 1, 2, 5]  # of few values: between them nothing was run
    ((points,),) = boundaries(figure)
    at = {M: z for z, M in points if M in (0, 1, 2)}
    assert at == pytest.approx({0: 2.0, 1: 1.0, 2: 1.35})


def test_who_is_best_beyond_every_limit_is_not_shown():
    found, best = data(**PLANE), HEAT | {"kind": "best"}
    beyond = np.outer(found.Ts, found.alpha) > 2.0
    np.testing.assert_array_equal(sweeps.share_of_limit(found.max_error, arrange(found, best)) > 1, beyond)
    assert sweeps.share_of_limit(data(**PLANE, limit=False).max_error, arrange(found, best)) is None
    shown = drawn(found, best).axes[0].collections[0].get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(shown), beyond | (np.arange(10) == 9)[:, None])


# --- one of each --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "x", "y"),
    [
        (HEAT, "α [1/s]", "Ts [s]"),
        ({"kind": "best", "x": "Ts", "y": "alpha"}, "Ts [s]", "α [1/s]"),
        ({"kind": "slices", "x": "alpha"}, "α [1/s]", "error ‖e‖, largest [m]"),
        (WORK, "evaluations", "error ‖e‖, largest [m]"),
    ],
)
def test_each_kind_is_drawn_with_units(table, x, y):
    found = data(**PLANE)
    figure = drawn(found, table)
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    assert (axes.get_ylabel(), figure.axes[-2 if table["kind"] == "heat" else -1].get_xlabel()) == (y, x)
    words = " ".join(t.get_text() for legend in figure.legends for t in legend.get_texts())
    assert table["kind"] == "heat" or words == "EE IE CN"
    found["ok"] = found.max_error < 0.5  # a verdict
    assert drawn(found, table | {"value": "ok"})


def test_curves_hold_the_datas_numbers():
    found = data(**PLANE)
    figure = drawn(found, {"kind": "slices", "x": "Ts", "select": {"alpha": 5.0}})
    here = found.max_error.sel(alpha=5.0, method="nearest")
    for line, values in zip(figure.axes[0].lines, here.values, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), np.where(np.isfinite(values), values, np.nan))
    figure = drawn(found, WORK)
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_xdata(), np.arange(1, 11) * 10)
    found.max_error[0] = 0.0  # an error of 0 lies on the axis
    panel = drawn(found, {"kind": "slices", "x": "Ts", "log": True}).axes[0]
    assert (panel.lines[0].get_ydata() == panel.get_ylim()[0]).all()


def test_panels_that_share_an_axis_show_all_values():
    found = data(case=["small", "large"], z=np.linspace(0.1, 0.9, 5))
    found["max_error"] = found.max_error * xarray.DataArray([1.0, 1e4], dims="case")
    figure = drawn(found, {"kind": "slices", "x": "z", "panels": "case", "log": True})
    shown = found.max_error.values[np.isfinite(found.max_error.values)]
    assert all(ax.get_ylim()[0] < shown.min() and ax.get_ylim()[1] > shown.max() for ax in figure.axes)


def test_gains_that_are_vectors_are_lines():
    found = data(alpha=[0, 1, 2], Ts=np.geomspace(0.01, 0.5, 5))
    found = found.assign_coords(alpha_value=(("alpha", "alpha_0"), [[3, 5], [1, 2], [8, 9]], {"units": "1/s"}))
    figure = drawn(found, defaults(found)[0])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["[3, 5]", "[1, 2]", "[8, 9]"]
    figure = drawn(found, {"kind": "slices", "select": {"alpha": 2}})
    assert figure.get_suptitle() == "α = [8, 9] 1/s"


def test_long_words_stay_within_the_figure_and_apart():
    found = data(case=["2dof", "5dof"], size=[1e-3, 0.03, 0.1, 0.3, 1.0], **PLANE)
    found["size"].attrs["units"] = "rad"
    found.max_error.attrs["long_name"] = "how far the farthest joint goes beyond its limit, 0 if none does"
    figure = drawn(found, {"kind": "slices", "x": "Ts", "panels": "size", "rows": "case", "lines": "method"})
    FigureCanvasAgg(figure).draw()
    for row in (figure.axes[:5], figure.axes[5:]):
        titles = [ax.title.get_window_extent() for ax in row]
        assert all(a.x1 < b.x0 for a, b in itertools.pairwise(titles))
    label = figure.axes[0].yaxis.label.get_window_extent()
    assert label.y0 >= 0 and label.y1 <= figure.bbox.height
