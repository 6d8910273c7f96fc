"""Live: sliders that run a loop anew, its error and factors beside the robot, and a run kept to compare with."""

import sys
import threading
import time

import numpy as np

from cnclik.engine.plan import as_here
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import METHODS
from cnclik.markup import escaped
from cnclik.show.viewer import play
from cnclik.show.viewer.look import Sliders, look, loop_of, with_loop
from cnclik.show.viewer.motion import BAD, GOOD, LEVELS, WARNING, motion_of
from cnclik.stability.loop import UNSTABLE
from cnclik.stability.verdict import verdict

MOST_DELAY = 20  # [samples] largest delay on the slider
MOST_Z = 3.0  # largest alpha·Ts on the slider, at the first sampling time


def tell(text) -> None:
    """A line for the terminal; beside what a command prints."""
    print(text, file=sys.stderr, flush=True)


class Live:
    """A problem with sliders. The first run is made before anything is shown; later ones in a thread of their own."""

    def __init__(self, problem, *, links=None, say=tell):
        self.problem, self.links, self.say = problem, links, say
        self.begun, self.known, self.kept, self.status = loop_of(problem), set(), None, None
        self.seen = self._look(self.begun)
        self.waiting, self.wake, self.ended = None, threading.Condition(), False

    # --- runs ---------------------------------------------------------------------------------------------

    def _look(self, loop):
        if loop.program not in self.known:
            self._tell(f"Compiling {words(loop)} …")
        begun = time.perf_counter()
        seen = look(self.problem, loop)
        seconds = time.perf_counter() - begun
        if loop.program not in self.known:
            self.known.add(loop.program)
            self._tell(f"{words(loop)} is compiled: {seconds:.1f} s; other gains and sampling times run at once.")
        return seen

    def _tell(self, text):
        self.say(text)
        if self.status is not None:
            self.status.content = f"<div style='padding:0 1em'>{escaped(text)}</div>"

    def motion(self):
        """The run that is shown."""
        loop, law = self.seen.loop, self.problem.law
        name = f"{self.problem.name}: α = {loop.alpha:.3g} 1/s, Ts = {1e3 * loop.Ts:.3g} ms, {words(loop)}"
        return motion_of(self.seen.run, law, name=name, links=self.links, radius=self.seen.radius)

    def motions(self):
        return [self.motion(), *([self.kept] if self.kept else [])]

    # --- the panel ----------------------------------------------------------------------------------------

    def put_on(self, server, player) -> None:
        """The panel's sliders, chart and factors; from here on sliders run the loop."""
        gui, first, self.player = server.gui, self.begun, player
        most = max(4 * first.alpha, MOST_Z / first.Ts)
        self.alpha = gui.add_slider("α [1/s]", 0.0, most, most / 1000, min(first.alpha, most), hint="Gain of the error")
        low, high = first.Ts / 10, 4 * first.Ts
        self.Ts = gui.add_slider("Ts [ms]", 1e3 * low, 1e3 * high, 1e3 * first.Ts / 100, 1e3 * first.Ts)
        self.method = gui.add_dropdown("method", sorted({*METHODS, first.method}), initial_value=first.method)
        whole = 1 if float(first.delay).is_integer() else 0.25
        delay_most = max(MOST_DELAY, int(4 * first.delay))
        self.delay = gui.add_slider("delay [samples]", 0, delay_most, whole, first.delay, hint="Dead time")
        keep, drop, judge = "Keep beside", "Drop", "Verdict"
        pressed = gui.add_button_group("this run", (keep, drop, judge))
        self.status = gui.add_html("")
        self.caption = gui.add_html("")
        self.chart = play.add_error_chart(gui, self.motions())
        for control in (self.alpha, self.Ts, self.method, self.delay):
            control.on_update(lambda _: self.ask())
        does = {keep: lambda: self._keep(self.motion()), drop: lambda: self._keep(None), judge: self._judge}
        pressed.on_click(as_here(lambda _: does[pressed.value]()))
        threading.Thread(target=as_here(self._serve), daemon=True).start()
        self.show()

    def ask(self) -> None:
        """Run with the present slider values; of several pending changes only the last counts."""
        with self.wake:
            self.waiting = Sliders(self.alpha.value, 1e-3 * self.Ts.value, self.method.value, float(self.delay.value))
            self.wake.notify()

    def _serve(self):
        while True:
            with self.wake:
                self.wake.wait_for(lambda: self.waiting is not None or self.ended)
                loop, self.waiting = self.waiting, None
            if self.ended:
                return
            try:
                self.seen = self._look(loop._replace(alpha=max(loop.alpha, 1e-9)))
                self.show()
            except Exception as error:  # of any kind: the sliders keep working
                self._tell(str(error))

    def show(self) -> None:
        """The run as it is now."""
        motions = self.motions()
        self.player.put(motions)
        data, names = play.curves(motions)
        self.chart.data, self.chart.series = data, play.series(names)
        self.caption.content = factors_page(self.seen)

    def _keep(self, motion):
        self.kept = motion
        self.show()

    def _judge(self):
        seen = self.seen
        made, run = with_loop(self.problem, seen.loop), seen.run
        self._tell("Judging …")
        loop = dict(Ts=made.Ts, method=made.method, stage=made.stage, drive=made.drive or Drive())
        self._tell(str(verdict(made.law, made.reference, run, **loop, noise=made.noise)))

    def end(self) -> None:
        """No run from here on."""
        with self.wake:
            self.ended = True
            self.wake.notify()


def words(loop) -> str:
    """A program, such as "CN, 2 samples of dead time"."""
    return loop.method + (f", {loop.delay:g} samples of dead time" if loop.delay else "")


def factors_page(seen) -> str:
    """The loop's factors in the unit circle, as a picture, and what they say."""
    level = BAD if not seen.radius <= UNSTABLE else WARNING if seen.radius >= 1 - 1e-9 else GOOD
    color, word = LEVELS[level], ("stable", "at the edge: neither stable nor unstable", "not stable")[level]
    size = f"{seen.radius:.4g}" if np.isfinite(seen.radius) else "not finite"
    said = f"error × {size} per step: {word}"
    loop = seen.loop
    parts = [
        "<svg viewBox='-1.6 -1.6 3.2 3.2' width='110' height='110' style='flex:none'>"
        "<circle r='1' fill='none' stroke='#888' stroke-width='0.03'/>"
        "<path d='M-1.5 0H1.5M0 -1.5V1.5' stroke='#bbb' stroke-width='0.02'/>"
    ]
    for value in () if seen.factors is None else seen.factors:
        size = abs(value)
        at = value if size <= 1.5 else 1.5 * value / size
        parts.append(f"<circle cx='{at.real:.3f}' cy='{-at.imag:.3f}' r='0.08' fill='{color}' fill-opacity='0.75'/>")
    parts.append("</svg>")
    text = f"<b style='color:{color}'>{said}</b><br>z = α·Ts = {loop.alpha * loop.Ts:.4g}"
    return (
        "<div style='display:flex;align-items:center;gap:0.8em;padding:0.3em 1em;font-size:0.85em'>"
        f"{''.join(parts)}<div>{text}</div></div>"
    )
