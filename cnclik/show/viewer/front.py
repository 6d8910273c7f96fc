"""Front: `view`, which plays a run in a browser, with a slider over its time."""

import contextlib
import html
import importlib.util
import io
import threading
import time

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.status import names
from cnclik.integrate.trajectory import Trajectory, one_lane
from cnclik.law.law import Law
from cnclik.measure.dataset import to_dataset
from cnclik.problem.build import Problem
from cnclik.robot.files import file_of
from cnclik.show.motion import error_parts, motion_of

RATE = 30.0  # frames a second


def has_viser() -> bool:
    """Return whether viser can be imported."""
    return importlib.util.find_spec("viser") is not None


class Viewer:
    """A run that a browser shows at `url` until `stop()`."""

    def __init__(self, motion, *, name="", walls=(), robot=None, host="localhost", port=8080):
        self.server = _server(host, port)
        from cnclik.show.viewer.scene import Scene  # needs trimesh, which comes with viser

        self.url, self.name, self.motion = f"http://{host}:{self.server.get_port()}", name, motion
        self.scene = Scene(self.server, motion, walls=walls, robot=robot)
        self.t, gui = motion.data.time.values.astype(float), self.server.gui
        begin, end = float(self.t[0]), max(float(self.t[-1]), float(self.t[0]) + 1e-9)
        self.caption = gui.add_html("")
        self.slider = gui.add_slider("time [s]", begin, end, (end - begin) / 1000, begin)
        self.playing = gui.add_checkbox("play", True)
        self.slider.on_update(lambda event: self.show(self.slider.value) if event.client is not None else None)
        self._busy, self._ended = threading.Lock(), threading.Event()
        self.show(begin)
        threading.Thread(target=self._play, daemon=True).start()

    def show(self, t) -> None:
        """Show the instant nearest to a time [s]."""
        k = int(np.abs(self.t - min(max(t, self.t[0]), self.t[-1])).argmin())  # a browser accepts any number
        with self._busy:
            self.scene.show(k)
            self.caption.content = caption(self.name, self.motion.data, k)

    def _play(self):
        last = time.perf_counter()
        while not self._ended.wait(1 / RATE):
            now = time.perf_counter()
            if self.playing.value and self.server.get_clients():
                ended = self.slider.value >= self.slider.max
                t = self.slider.min if ended else self.slider.value + now - last
                self.slider.value = min(t, self.slider.max)
                self.show(self.slider.value)
            last = now

    def stop(self) -> None:
        """End the server."""
        self._ended.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def __repr__(self):
        return f"Viewer({self.url})"


def view(what, law=None, *, robot=None, host="localhost", port=8080) -> Viewer:
    """Play a run in a browser: `ck.show.view(run, law)`.

    Args:
      what: a `Trajectory` with its law, one lane; or a `Problem`, which is run.
      law: of a `Trajectory`.
      robot: URDF file with the robot's meshes; without it, cylinders stand for links and joints.
      host, port: where to listen; on the next free port.

    Returns: a `Viewer` with `url` and `stop()`.
    Raises: ArgumentError where viser is missing, or for what can't be shown.
    """
    if not has_viser():
        install = "pip install 'cnclik[viewer]'"
        raise errors.ArgumentError(f"The viewer needs the package viser, which is not installed: {install}")
    if isinstance(what, Problem):
        run, law, name, robot = jax.tree.map(np.asarray, what.run()), what.law, what.name, robot or what.robot
    else:
        run = errors.kind("run", what, Trajectory)
        law = errors.kind("law", law, Law)
        one_lane(run)
        name = f"{law.chain.n} joints"
    file = None if robot is None or hasattr(robot, "joints") else file_of(str(robot))
    motion, walls = motion_of(to_dataset(run, law), law.chain), getattr(law.limits, "walls", ())
    return Viewer(motion, name=name, walls=walls, robot=file, host=host, port=port)


def caption(name, data, k) -> str:
    """Return what is shown now, as HTML: name, time, errors, status."""
    status = data.status.values[min(k, data.sizes["step"] - 1)] if data.sizes["step"] else 0
    parts = [(task, np.linalg.norm(data.e.values[k, some]), unit) for task, unit, some in error_parts(data)]
    sizes = ", ".join(f"{task} {size:.3g} {unit}".strip() for task, size, unit in parts)
    lines = name, f"t = {data.time.values[k]:.3f} s", f"error {sizes}", names(status).replace("|", ", ")
    return f"<div style='padding:0.1em 1em;font-size:0.85em'>{'<br>'.join(map(html.escape, lines))}</div>"


def _server(host, port):
    """Return a viser server without its words on the terminal, on the next port that is free."""
    import viser

    errors.integer("port", port, at_least=1, at_most=65_000)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, label="cnclik", verbose=False)
    except (OSError, RuntimeError) as error:
        raise errors.fail("host", "be one that this machine can listen on", f"is {host!r}: {error}") from None
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    return server
