"""The site's calculator against `gains`: 80 drives drawn at random, in a headless Chromium, as the page runs it."""

import json
import pathlib
import shutil
import subprocess

import numpy as np
import pytest

import cnclik as ck

SCRIPT = pathlib.Path(__file__).parents[2] / "docs" / "_static" / "calculator.js"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PAGE = """<!doctype html><meta charset="utf-8"><pre id="out"></pre><script src="{script}"></script><script>
const rows = {loops}.map(([drive, Ts, method, M], i) => {{
  const found = cnclik.gains(drive, Ts, method, M), z = found.recommended;
  const did = z ? cnclik.response(drive, Ts, z, method, M) : {{ settling: 0, overshoot: 0 }};
  const tools = i < 10 ? Object.values(cnclik.elsewhere(drive, Ts)) : [];  // it searches four loops more
  return [found.stable, found.smooth, z, did.settling, did.overshoot, ...tools];
}});
document.getElementById("out").textContent = JSON.stringify(rows, (_, x) => (x === Infinity ? "inf" : x));
</script>"""


def drawn(rng):
    """A loop: its drive, Ts, method and M."""
    Ts, kind = 10 ** rng.uniform(-3, -1.2), rng.integers(4)
    drive = dict(delay=min(rng.choice([0, 1, 2.4, rng.uniform(0, 0.05) / Ts]), 60))
    if kind == 1:
        drive |= dict(lag=10 ** rng.uniform(-2.5, -0.5))
    if kind > 1:
        drive |= dict(natural_frequency=10 ** rng.uniform(0.7, 2.2), damping_ratio=rng.uniform(0.2, 1.5))
    if kind and rng.random() < 0.5:
        drive |= dict(command="position", feedback=rng.choice(["measured", "rebased"]))
    if rng.random() < 0.2:
        drive |= dict(feedback="commanded")
    if rng.random() < 0.4:
        drive |= dict(smoothing=rng.uniform(0.05, 0.9), smoothed=rng.choice(["error", "command", "target"]))
    drive = {k: v if isinstance(v, str) else float(v) for k, v in drive.items()}
    method = str(rng.choice(["EE", "IE", "CN", "TRAPEZOID", "RK4", "EXP-MIDPOINT"]))
    return drive, float(Ts), method, 5 if method in ("IE", "CN", "TRAPEZOID") and rng.random() < 0.5 else None


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_page_answers_as_gains_does(tmp_path):
    rng, loops, wanted = np.random.default_rng(20261129), [], []
    names = dict(natural_frequency="frequency", damping_ratio="damping")
    rest = dict(lag=0, frequency=0, damping=1, command="velocity", feedback="measured", smoothing=0, smoothed="error")
    for drive, Ts, method, M in (drawn(rng) for _ in range(80)):
        found = ck.gains(Ts=Ts, drive=ck.Drive(**drive), method=method, M=M)
        elsewhere = {name: one.value or 0.0 for name, one in (found.elsewhere if len(loops) < 10 else {}).items()}
        did = (found.response.settling_time, found.response.overshoot) if found.response else (0, 0)
        tools = [elsewhere[name] for name in ("pink", "Placo", "MoveIt Servo", "Isaac Lab", "UR servoj") if elsewhere]
        wanted.append([found.largest_stable, found.without_overshoot, found.recommended, *did, *tools])
        loops.append([rest | {names.get(k, k): v for k, v in drive.items()}, Ts, method, M])
    page = tmp_path / "page.html"
    page.write_text(PAGE.format(script=SCRIPT.as_uri(), loops=json.dumps(loops)), encoding="utf-8")
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=600000", "--dump-dom")
    text = subprocess.run(
        [CHROMIUM, *flags, page.as_uri()], capture_output=True, text=True, timeout=300, check=True
    ).stdout
    rows = json.loads(text.split('<pre id="out">')[1].split("</pre>")[0])
    for row, numbers in zip(rows, wanted, strict=True):
        np.testing.assert_allclose([0.0 if x is None else float(x) for x in row], numbers, rtol=1e-6, atol=1e-9)
