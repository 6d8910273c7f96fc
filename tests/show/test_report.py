"""Reports: one page that is whole, small and opens offline; what can't be drawn costs itself alone."""

import re
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.show import report as reports
from cnclik.show.output import FigureError
from cnclik.show.report_figures import MOST_BYTES, picture
from cnclik.show.viewer import need


class Page(HTMLParser):
    """Ids, references to ids, addresses, and tags that are open, of a page; it fails where tags don't match."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.references, self.addresses, self.tags, self.open = [], [], [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)
        self._look(attributes)

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)
        self._look(attributes)

    def _look(self, attributes):
        for name, value in attributes:
            value = value or ""
            if name == "id":
                self.ids.append(value)
            if name in ("href", "xlink:href", "src") and not value.startswith("data:"):
                (self.references if value.startswith("#") else self.addresses).append(value.removeprefix("#"))
            self.references += re.findall(r"url\(#([^)]+)\)", value)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def curve(points=50):
    figure, panel = plt.subplots(figsize=(3, 2))
    panel.plot(np.linspace(0, 1, points), np.random.default_rng(0).random(points), "o-")
    panel.set_xlabel("$t$ [s]")
    panel.fill_between([0, 1], [0, 1], color="0.9", hatch="//")
    return figure


def made(**changes):
    figures = {name: (curve, {"Title": name}) for name in ("a.png", "b.png")}
    given = dict(title="<arm>", answer="Settled & well.", facts=[("error", "1 m")], figures=figures, command="cnclik x")
    return reports.Report(**given | changes)


def test_a_page_has_no_address():
    page = Page(reports.page(made()))
    assert len(page.ids) == len(set(page.ids)) and set(page.references) <= set(page.ids)
    assert not page.addresses and page.tags.count("img") == 2 and "script" not in page.tags


def test_a_page_says_what_it_is_of():
    text = reports.page(made(tables=[("Gains", ("a", "b"), [(1, 2)] * 70)], lines=["so <it> is"]))
    for part in ("&lt;arm&gt;", "Settled &amp; well.", "cnclik x", "float64", "so &lt;it&gt; is", "10 more rows"):
        assert part in text
    for name in ("cnclik", "jax", "numpy", "python"):
        assert f">{name}</td>" in text
    assert 'name="viewport"' in text and "@media print" in text and "prefers-color-scheme:dark" in text


@pytest.mark.parametrize("points", [100, 20_000])
def test_a_figure_is_small_whatever_it_shows(points):
    assert len(picture(lambda: curve(points), "a", {})) < 1.5 * MOST_BYTES


def test_a_figure_of_many_shapes_becomes_a_picture():
    def many():
        figure, panel = plt.subplots(figsize=(3, 2))
        for k in range(600):
            panel.plot(np.random.default_rng(k).random(20))
        return figure

    assert picture(many, "a", {}).startswith('<img alt="a" class="pixels" src="data:image/png;base64,')


def test_what_cannot_be_drawn_costs_itself_alone(tmp_path):
    def broken():
        raise ValueError("no ink")

    figures = {"a.png": (broken, {}), "b.png": (curve, {})}
    with pytest.raises(FigureError, match=r"Not in one.html: a \(ValueError: no ink\); all else is."):
        reports.write(made(figures=figures), tmp_path / "one.html")
    text = (tmp_path / "one.html").read_text()
    assert "Not drawn: ValueError: no ink" in text and text.count("image/svg+xml") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["one.html"]


def test_without_viser_the_page_says_so(monkeypatch):
    monkeypatch.setattr(need, "has_viser", lambda: False)
    text = reports.page(made(motions=lambda: pytest.fail("not asked for")))
    assert "pip install &#x27;cnclik[viewer]&#x27;" in text and "<iframe" not in text


def test_a_robot_that_cannot_be_drawn_costs_itself_alone(monkeypatch):
    monkeypatch.setattr(need, "has_viser", lambda: True)
    failed = {}
    text = reports.page(made(motions=lambda: 1 / 0), failed)
    assert "ZeroDivisionError" in failed["the moving robot"] and "could not be drawn" in text


@pytest.mark.parametrize("name", ["a.pdf", "none/a.html", "folder.html", "x" * 250 + ".html"])
def test_where_a_page_cannot_be_is_told_before_anything_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(SystemExit) as left:
        main(["solve", "planar:1,1", "--report", name])
    assert left.value.code == 2 and "Option `--report` must" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["folder.html"]


# --- what notebooks show --------------------------------------------------------------------------------------


def test_a_chain_is_a_table_in_a_notebook():
    text = ck.panda()._repr_html_()
    assert (
        Page(text).tags.count("tr") == 8 and "panda_joint4" in text and "-3.0718 rad" in text and "2.61 rad/s" in text
    )


def test_a_law_is_its_sentence_in_a_notebook():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=5.0)
    text = law._repr_html_()
    assert Page(text).tags.count("p") == 1 and "q̇ = J#(ẋ_d + α e) of 2 coordinates on 2 joints" in text
    assert all(f">{name}</td>" in text for name in ("task", "chain", "alpha", "inverse", "limits"))


def trajectory(N=20, **changes):
    size = np.geomspace(1, 1e-8, N + 1)[:, None]
    return ck.replace(
        ck.Trajectory(
            t=0.1 * np.arange(N + 1),
            **dict.fromkeys(("q", "x", "e"), size),
            qdot=np.zeros((N, 1)),
            residual=np.zeros(N),
            contraction=np.zeros(N),
            status=np.where(np.arange(N) == 3, 2, 0),
            evaluations=np.asarray(N),
        ),
        **changes,
    )


def test_a_trajectory_is_a_plot_in_a_notebook():
    text = trajectory()._repr_html_()
    page = Page(text)
    assert page.tags.count("svg") == 1 and page.tags.count("rect") == 1 and "NEAR_SINGULAR 1" in text
    points = np.array([p.split(",") for p in re.search(r"points='([^']*)'", text)[1].split()], float)
    assert len(points) == 21 and np.all(np.diff(points[:, 1]) > 0)
    np.testing.assert_allclose(np.diff(points[:, 1], 2), 0, atol=0.11)  # a straight fall, on a logarithmic scale


@pytest.mark.parametrize("e", [np.zeros((21, 1)), np.full((21, 1), np.nan), np.full((21, 1), 1e150)])
def test_a_trajectory_of_any_error_is_a_plot(e):
    assert "nan" not in re.sub(r"<pre>.*?</pre>", "", trajectory(e=e)._repr_html_(), flags=re.S)


def test_a_batch_of_trajectories_is_a_text():
    batch = trajectory(status=np.zeros((3, 20), int), residual=np.zeros((3, 20)))
    assert "3 lanes" in batch._repr_html_() and "<svg" not in batch._repr_html_()
