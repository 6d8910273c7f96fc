"""The viewer: `view` plays a run in viser: the robot, paths of its tips, their targets, walls, and a time slider."""

import contextlib
import html
import importlib.util
import io
import threading
import time

import numpy as np

from cnclik import errors
from cnclik.integrate.status import level, names
from cnclik.integrate.trajectory import check_run
from cnclik.law.law import Law
from cnclik.measure.dataset import to_dataset
from cnclik.robot import poses
from cnclik.robot.files import file_of
from cnclik.robot.posture import arm_length, is_planar
from cnclik.show import style
from cnclik.show.motion import error_parts, motion_of

MOST_POINTS = 600  # of a path
RATE = 30.0  # frames a second


def has_viser() -> bool:
    """Return whether viser can be imported."""
    return importlib.util.find_spec("viser") is not None


def view(run, law, *, robot=None, host="localhost", port=8080):
    """Play a run in a browser: `ck.show.view(run, law)`.

    Args:
      run: a `Trajectory` of solve(law, ...), one lane.
      robot: URDF file with the robot's meshes; without it, cylinders stand for links and joints.
      host, port: where to listen; on the next free port.

    Returns: a `Viewer` with `url` and `stop()`.
    Raises: ArgumentError where viser is missing, or for what can't be shown.
    """
    if not has_viser():
        install = "pip install 'cnclik[viewer]'"
        raise errors.ArgumentError(f"The viewer needs the package viser, which is not installed: {install}")
    import viser

    check_run(run, lanes=False)
    errors.kind("law", law, Law)
    errors.integer("port", port, at_least=1, at_most=65_000)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, label="cnclik", verbose=False)
    except (OSError, RuntimeError) as error:
        raise errors.fail("host", "be one that this machine can listen on", f"is {host!r}: {error}") from None
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    file = None if robot is None else file_of(str(robot))
    return Viewer(server, motion_of(to_dataset(run, law), law.chain), getattr(law.limits, "walls", ()), file)


class Viewer:
    """A run that a browser shows at `url` until `stop()`."""

    def __init__(self, server, motion, walls, robot):
        from cnclik.show import shapes  # needs trimesh, which comes with viser

        self.server, self.motion, chain, scene = server, motion, motion.chain, server.scene
        self.url = f"http://{server.get_host()}:{server.get_port()}"
        thick, count = shapes.thickness(chain), len(motion.poses)
        status = motion.data.status.values
        self.levels = level(np.append(status, status[-1:] if status.size else 0))[:count]
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        meshes, every = ([], motion.poses) if robot is None else shapes.meshes_of(robot, motion)
        self.places, self.turns = every[:, :, :3, 3], poses.quaternions(every[:, :, :3, :3])
        self.frames = [scene.add_frame(f"/{i}", show_axes=False) for i in range(every.shape[1])]
        solid = [(*shape, {}) for shape in meshes or shapes.shapes_of(chain)]
        solid += [(*shape, {"opacity": 0.2, "side": "double"}) for shape in shapes.shapes_of_walls(walls, chain)]
        for k, (frame, mesh, color, look) in enumerate(solid):
            scene.add_mesh_simple(f"/{frame}/{k}", mesh.vertices, mesh.faces, color=rgb(color), **look)
        tips = range(motion.poses.shape[1] - len(chain.tips), motion.poses.shape[1])
        size = (0.6 if meshes else 1.1) * thick
        self.tips = [scene.add_icosphere(f"/{i}/tip", size, rgb(style.FINE)) for i in tips]
        self.goals = {i: target for i, target in enumerate(motion.targets) if target is not None}
        self.balls = {i: scene.add_icosphere(f"/goal{i}", 0.8 * thick, rgb(style.BLACK)) for i in self.goals}
        self._draw_paths(np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).round().astype(int)), thick)
        self._look(thick)
        self.t, gui = motion.data.time.values.astype(float), server.gui
        begin, end = float(self.t[0]), max(float(self.t[-1]), float(self.t[0]) + 1e-9)
        self.caption = gui.add_html("")
        self.slider = gui.add_slider("time [s]", begin, end, (end - begin) / 1000, begin)
        self.playing = gui.add_checkbox("play", True)
        self.slider.on_update(lambda event: self.show(self.slider.value) if event.client is not None else None)
        self._busy, self._ended = threading.Lock(), threading.Event()
        self.show(begin)
        threading.Thread(target=self._play, daemon=True).start()

    def _draw_paths(self, some, thick):
        """Draw paths of tips in green, and those of targets in grey."""
        ways = [(f"/path{i}", path, style.FINE, 0.3) for i, path in enumerate(self.motion.paths)]
        ways += [(f"/wanted{i}", target, style.GREY, 0.12) for i, target in self.goals.items()]
        for name, way, color, size in ways:
            lines = np.stack([way[some][:-1], way[some][1:]], 1)
            self.server.scene.add_line_segments(name, lines, rgb(color), thickness=size * thick)

    def _look(self, thick):
        """Look from above at a planar arm, from a corner otherwise, at all that moves; draw a floor below it."""
        low, high, flat = self.places.min((0, 1)), self.places.max((0, 1)), is_planar(self.motion.chain)
        span = 1.3 * max(np.linalg.norm(high - low), float(arm_length(self.motion.chain)))
        away, right = ((0, -1e-3, 1.0), (1.0, 0, 0)) if flat else ((0.83, 0.48, 0.37), (-0.5, 0.87, 0.0))
        middle = (low + high) / 2 + 0.2 * span * np.array(right)  # the panel covers the right of the page
        cell = 10.0 ** np.floor(np.log10(span / 2)) / 2
        look = {"position": (*middle[:2], min(low[2], 0.0) - 2 * thick), "cell_thickness": 0.7}
        self.server.scene.add_grid("/floor", 4 * span, 4 * span, cell_size=cell, section_size=5 * cell, **look)
        camera = self.server.initial_camera
        camera.position, camera.look_at = tuple(middle + span * np.array(away)), tuple(middle)
        camera.up, camera.fov = (0, 1, 0) if flat else (0, 0, 1), np.radians(50)

    def show(self, t) -> None:
        """Show the instant nearest to a time [s]."""
        k = int(np.abs(self.t - min(max(t, self.t[0]), self.t[-1])).argmin())  # a browser accepts any number
        with self._busy, self.server.atomic():
            for i, frame in enumerate(self.frames):
                frame.position, frame.wxyz = self.places[k, i], self.turns[k, i]
            for ball in self.tips:
                ball.color = rgb(style.LEVELS[self.levels[k]])
            for i, ball in self.balls.items():
                ball.position = self.goals[i][k]
            self.caption.content = caption(self.motion.data, k)

    def _play(self):
        last = time.perf_counter()
        while not self._ended.wait(1 / RATE):
            now = time.perf_counter()
            if self.playing.value and self.server.get_clients():
                ended = self.slider.value >= self.slider.max
                self.slider.value = min(self.slider.min if ended else self.slider.value + now - last, self.slider.max)
                self.show(self.slider.value)
            last = now

    def stop(self) -> None:
        """End the server."""
        self._ended.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def rgb(color: str) -> tuple:
    """Return a colour such as "#0072B2" as three bytes."""
    return tuple(bytes.fromhex(color.lstrip("#")))


def caption(data, k) -> str:
    """Return what is shown now, as HTML: time, errors, status."""
    status = data.status.values[min(k, data.sizes["step"] - 1)] if data.sizes["step"] else 0
    parts = [(task, np.linalg.norm(data.e.values[k, some]), unit) for task, unit, some in error_parts(data)]
    sizes = ", ".join(f"{task} {size:.3g} {unit}".strip() for task, size, unit in parts)
    lines = f"t = {data.time.values[k]:.3f} s", f"error {sizes}", names(status).replace("|", ", ")
    return f"<div style='padding:0.1em 1em;font-size:0.85em'>{'<br>'.join(map(html.escape, lines))}</div>"
