"""`--report` of every verb that has it: the answer that it prints, its figures, its command, data untouched."""

import json

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.show import report_figures, style
from cnclik.show.viewer import need
from tests.specs import reaching

ARM = "planar:1,0.8"
LOOP = [ARM, "--method", "EE", "--Ts", "0.05"]


@pytest.fixture(autouse=True)
def _no_robot(monkeypatch, tmp_path):
    """Without viser, which has tests of its own: a page takes a second."""
    monkeypatch.setattr(need, "has_viser", lambda: False)
    monkeypatch.chdir(tmp_path)


def page(argv, capsys):
    """(page, what was printed) of a command."""
    main([*argv, "--report", "one.html"])
    with open("one.html", encoding="utf-8") as file:
        text = file.read()
    assert f"cnclik {argv[0]}" in text and "--report one.html" in text and len(text) < 1_000_000
    return text, capsys.readouterr().out


def test_solve(tmp_path, capsys):
    text, shown = page(["solve", *LOOP, "--N", "30", "--no-figures", "--out", "out"], capsys)
    sentence = next(line for line in shown.splitlines() if line.startswith(("Settled", "Converging")))
    assert sentence.split(";")[0] in text and text.count("image/svg+xml") == 5 and "cnclik[viewer]" in text
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["trajectory.nc"] and "Wrote one.html." in shown


STACK = """
[tasks.place]
task = "position"
alpha = 20
damping = 0.01
[tasks.rest]
task = "joints"
alpha = 120
damping = 0.3
"""


@pytest.mark.slow
def test_stability_of_a_stack(tmp_path, capsys):
    """Where it rests at other targets than those it begins at, and a run beyond the limit of its tightest task."""
    (tmp_path / "s.toml").write_text(STACK)
    asked = ["stability", "planar:1,0.8,0.5", "--stack", "s.toml", "--method", "EE", "--target", "1.0", "1.2"]
    text, shown = page([*asked, "--delay", "1"], capsys)
    assert (
        "Linearized where it rests, at q = " in shown
        and "hold from 1 1.2 m." in shown
        and "(default)" not in shown.split("place:")[1][:99]
    )
    for words in ("With the present gains", "UNSTABLE: the gain of rest is too large. Lower it first."):
        assert words in text, words
    assert text.count("image/svg+xml") == 1
    main([*asked, "--json"])
    told = json.loads(capsys.readouterr().out)
    arm = ck.planar_arm([1, 0.8, 0.5])
    off = np.subtract(ck.forward(arm, np.array(told["rest"])).position[:2], [1.0, 1.2])
    assert (
        told["stack"]["unstable"] == ["rest"]
        and np.linalg.norm(off) < 0.05
        and np.linalg.norm(np.subtract(told["rest"], told["q0"])) > 0.1
    )


def test_a_report_that_fails_costs_no_data(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(report_figures, "picture", lambda *_: 1 / 0)
    with pytest.raises(SystemExit) as left:
        main(["solve", *LOOP, "--N", "3", "--out", "out", "--report", "one.html"])
    assert left.value.code == 1 and "Not in one.html: joints" in capsys.readouterr().err
    assert len(list((tmp_path / "out").iterdir())) == 6 and (tmp_path / "one.html").exists()


def test_figures_that_fail_cost_no_report(tmp_path, monkeypatch, capsys):
    save = style.save
    monkeypatch.setattr(
        style, "save", lambda made, path, about: 1 / 0 if path.suffix == ".png" else save(made, path, about)
    )
    with pytest.raises(SystemExit) as left:
        main(["solve", *LOOP, "--N", "3", "--out", "out", "--report", "one.html"])
    told = capsys.readouterr()
    assert left.value.code == 1 and "Not drawn: joints.png" in told.err and "Wrote one.html." in told.out
    assert (tmp_path / "one.html").read_text().count("image/svg+xml") == 5
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["trajectory.nc"]


def test_stability(tmp_path, capsys):
    text, _ = page(["stability", *LOOP, "--delay", "1"], capsys)
    assert "Recommended: alpha = " in text and "largest stable" in text and text.count("image/svg+xml") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["one.html"]


def test_stability_map(capsys):
    text, _ = page(["stability", *LOOP, "--map", "--cells", "3", "--N", "8", "--out", "out"], capsys)
    assert "Recommended: alpha = " in text and text.count("image/svg+xml") == 1


def test_tune(tmp_path, capsys):
    few = ["--damping", "0.01", "--N", "10", "--steps", "3", "--no-figures", "--out", "out"]
    text, shown = page(["tune", *LOOP, *few], capsys)
    assert all(shown.splitlines()[k] in text for k in (2, 5))
    assert "spectral radius" in text and text.count("image/svg+xml") >= 4
    assert "report" not in json.loads((tmp_path / "out" / "tuned.json").read_text())["config"]


def test_reach(capsys):
    text, _ = page(["reach", ARM, "--random", "5"], capsys)
    assert "5 of 5 targets are reached (100 %)." in text and "SOLVED" in text
    text, shown = page(["reach", ARM, "--random", "5", "--json"], capsys)
    assert json.loads(shown)["targets"] == 5


def test_sweep_and_its_best_and_worst_loop(tmp_path, capsys):
    from cnclik.show.viewer.swept import best_and_worst

    spec = reaching(metrics=["max_error", "final_error"], N=6, method=["EE", "CN"], alpha=[2.0, 30.0], Ts=[0.05, 0.1])
    (tmp_path / "one.toml").write_text(spec)
    text, _ = page(["sweep", "one.toml", "--out", "out", "--no-figures"], capsys)
    assert "8 loops" in text and "max_error" in text and "image/svg+xml" in text
    best, worst = best_and_worst(tmp_path / "out")
    assert best.error["position error [m]"].max() <= worst.error["position error [m]"].max()
    assert "alpha = 30" in worst.name and best.chain.n == worst.chain.n
