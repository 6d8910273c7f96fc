"""Play: a slider over time with play and speed, and the status of the instant that is shown."""

import threading
import time

import numpy as np

from cnclik import markup
from cnclik.show import style
from cnclik.show.viewer.body import GREY
from cnclik.show.viewer.motion import LEVELS
from cnclik.show.viewer.page import lasting

RATE = 30.0  # frames a second
LEAST = 1e-12  # error that a chart shows
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)


class Player:
    """Moves a scene by its own clock."""

    def __init__(self, server, scene):
        self.server, self.scene, self._busy, self._ended = server, scene, threading.Lock(), threading.Event()
        gui = server.gui
        self.caption = gui.add_html("")
        self.slider = gui.add_slider("time", 0.0, 1.0, 0.001, 0.0, hint="Share of the run's time")
        self.playing = gui.add_checkbox("play", True)
        self.speed = gui.add_dropdown("speed", [f"{s:g} ×" for s in SPEEDS], initial_value="1 ×")
        self.slider.on_update(lambda event: self._show(self.slider.value) if event.client is not None else None)
        self._ticking = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._ticking.start()

    def end(self) -> None:
        self._ended.set()

    def put(self, motions) -> None:
        """Show other motions, at the time that is shown now."""
        with self._busy:
            self.scene.put(motions)
        self._show(self.slider.value)

    def _show(self, share):
        share = min(max(share, 0.0), 1.0)  # the browser accepts any number
        with self._busy:
            self.scene.show(share)
            self.caption.content = caption(self.scene.motions, share)

    def _run(self):
        last = time.perf_counter()
        while not self._ended.wait(1 / RATE):
            now, motions = time.perf_counter(), self.scene.motions
            if motions and self.playing.value and self.server.get_clients():
                speed = float(self.speed.value.split()[0])
                share = self.slider.value + speed * (now - last) / max(lasting(motions), 0.05)
                share = share if share <= 1 else 0.0 if self.slider.value >= 1 else 1.0
                self.slider.value = share
                self._show(share)
            last = now


def caption(motions, share) -> str:
    """What is shown now, as HTML: name, time, errors, status in its colour."""
    rows = []
    for motion in motions:
        k = round(share * (len(motion.t) - 1))
        now = f"target {k}" if motion.unit == "target" else f"t = {motion.t[k]:.3f} s"
        errors = ", ".join(
            f"{what.split(' [')[0]} {values[k]:.3g} {what.split('[')[1][:-1]}" for what, values in motion.error.items()
        )
        dot = f"<span style='color:{LEVELS[motion.level[k]]};font-size:1.4em;vertical-align:-0.1em'>●</span>"
        rows.append(
            f"<div style='padding:0.1em 1em;font-size:0.85em'>{dot} <b>{markup.escaped(motion.name)}</b>, {now}<br>"
            f"{markup.escaped(motion.words[k].replace('_', ' ').replace('|', ', '))}<br>{errors}</div>"
        )
    return "".join(rows)


def add_error_chart(gui, motions):
    """A chart of log₁₀ of the errors' norms (its own logarithmic axes have no room for their labels); its handle."""
    data, names = curves(motions)
    return gui.add_uplot(data, series(names), **CHART)


def curves(motions):
    """(time, log₁₀ of each error) on one clock, and their names."""
    first = motions[0]
    t = first.t if len(motions) == 1 else np.linspace(0, max(m.t[-1] for m in motions), 400)
    found, names = [t], []
    for k, motion in enumerate(motions):
        for what, values in motion.error.items():
            shown = np.log10(np.maximum(np.nan_to_num(values, posinf=1e12), LEAST))
            shown = shown if motion is first and len(motions) == 1 else np.interp(t, motion.t, shown, right=np.nan)
            found.append(shown)
            names.append((k, what if k == 0 else f"{what.split(' [')[0]}, beside"))
    return tuple(found), names


def series(names) -> tuple:
    colors = {0: (markup.BLUE, style.ORANGE, *style.COLORS[1:4], *style.COLORS[5:]), 1: (GREY, "#5A6066")}
    looks: list[dict] = [{"label": "t [s]"}]
    for i, (k, what) in enumerate(names):
        some, i = colors[min(k, 1)], i - sum(other < k for other, _ in names)
        looks.append({"label": what, "stroke": some[i % len(some)], "width": 2})
    return tuple(looks)


CHART = {
    "scales": {"x": {"time": False}},
    "axes": (
        {"label": "t [s]", "size": 40, "labelSize": 16},
        {"size": 44, "label": "log₁₀ of the error", "labelSize": 16},
    ),
    "height": 210,
}
