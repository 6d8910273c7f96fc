"""Front: `view`, which plays a run in a browser, with a slider over its time."""

import contextlib
import html
import importlib.util
import io
import json
import os
import pathlib
import threading
import time

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.status import names
from cnclik.integrate.trajectory import Trajectory, one_lane
from cnclik.measure.dataset import to_dataset
from cnclik.problem.build import Problem, problem_from
from cnclik.reading import read_bytes
from cnclik.robot.files import file_of
from cnclik.show.motion import error_parts, motion_of

RUN = "trajectory.nc"
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
        self.speed = gui.add_slider("speed", 0.1, 5.0, 0.1, 1.0)
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
                t = self.slider.value + self.speed.value * (now - last)
                if self.slider.value >= self.slider.max:
                    t = self.slider.min
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
      what: a `Trajectory` with its law, one lane; a `Problem`, which is run; or a folder or trajectory.nc of
        `cnclik solve`.
      law: of a `Trajectory`.
      robot: URDF file with the robot's meshes; without it, cylinders stand for links and joints.
      host, port: where to listen; on the next free port.

    Returns: a `Viewer` with `url` and `stop()`.
    Raises: ArgumentError where viser is missing, or for what can't be shown.
    """
    if not has_viser():
        install = "pip install 'cnclik[viewer]'"
        raise errors.ArgumentError(f"The viewer needs the package viser, which is not installed: {install}")
    if isinstance(what, (str, os.PathLike)):
        data, law, name, robot = read_run(what)
    elif isinstance(what, Problem):
        data, law, name = to_dataset(jax.tree.map(np.asarray, what.run()), what.law), what.law, what.name
    else:
        errors.kind("run", what, Trajectory)
        if law is None:
            raise errors.fail("law", "be given with a Trajectory", "is not")
        one_lane(what)
        data, name = to_dataset(what, law), f"{law.chain.n} joints"
    file = None if robot is None or hasattr(robot, "joints") else file_of(str(robot))
    walls = getattr(law.limits, "walls", ())
    return Viewer(motion_of(data, law.chain), name=name, walls=walls, robot=file, host=host, port=port)


def is_run(text) -> bool:
    """Return whether a text names a run of `cnclik solve`, and no robot."""
    return str(text).lower().endswith(".nc") or os.path.exists(os.path.join(str(text), RUN))


def read_run(path) -> tuple:
    """Return (dataset, law, name, robot) of a folder or trajectory.nc of `cnclik solve`."""
    import xarray as xr

    path = pathlib.Path(path) / RUN if os.path.isdir(path) else pathlib.Path(path)
    content = io.BytesIO(read_bytes("FILE", path, "a run of `cnclik solve`"))
    try:
        with xr.open_dataset(content, engine="h5netcdf") as data:
            data.load()
        config = json.loads(data.attrs["config"])
        del config["verb"]
    except Exception as error:  # damaged files raise all kinds of errors in HDF5 and xarray
        raise errors.fail("FILE", "be a run of `cnclik solve`", f"{path.name} is not: {error}") from None
    if str(config["robot"]).endswith(".py"):
        again = f"view {config['robot']}"
        raise errors.fail("FILE", f"be played by `cnclik {again}`, whose robot is defined there", f"is {path.name!r}")
    made = problem_from(**config)
    if data.sizes.get("joint") != made.law.chain.n:
        raise errors.fail("FILE", f"hold joint values of {made.name}'s joints", f"holds {data.sizes.get('joint')}")
    return data, made.law, made.name, config["robot"]


def caption(name, data, k) -> str:
    """Return what is shown now, as HTML: name, time, errors, status."""
    status = data.status.values[min(k, data.sizes["step"] - 1)] if data.sizes["step"] else 0
    sizes = []
    for task, unit, some in error_parts(data):
        sizes.append(f"{task} {np.linalg.norm(data.e.values[k, some]):.3g} {unit}".strip())
    lines = f"t = {data.time.values[k]:.3f} s", f"error {', '.join(sizes)}", names(status).replace("|", ", ")
    text = "<br>".join(map(html.escape, lines))
    return f"<div style='padding:0.1em 1em;font-size:0.85em'><b>{html.escape(name)}</b><br>{text}</div>"


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
