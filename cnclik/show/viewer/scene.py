"""Scene: what viser draws of a motion: the robot, the paths of its tips, their targets, and walls."""

import numpy as np

from cnclik.integrate.status import level
from cnclik.robot import poses
from cnclik.robot.posture import arm_length, is_planar
from cnclik.show import style
from cnclik.show.viewer.shapes import GREY, meshes_of, shapes_of, shapes_of_walls, thickness

MOST_POINTS = 600  # of a path


def rgb(color: str) -> tuple:
    """Return a colour such as "#0072B2" as three bytes."""
    return tuple(bytes.fromhex(color.lstrip("#")))


class Scene:
    """A motion on a floor; `show` moves it to an instant."""

    def __init__(self, server, motion, *, walls=(), robot=None):
        """Args: walls: of the run's law. robot: URDF file with the robot's meshes."""
        self.server, self.motion, scene, chain = server, motion, server.scene, motion.chain
        thick, count = thickness(chain), len(motion.poses)
        status = motion.data.status.values
        self.levels = level(np.append(status, status[-1:]))[:count]
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        meshes, every = ([], motion.poses) if robot is None else meshes_of(robot, motion)
        self.places, self.turns = every[:, :, :3, 3], poses.quaternions(every[:, :, :3, :3])
        self.frames = [scene.add_frame(f"/{i}", show_axes=False) for i in range(every.shape[1])]
        solid = [(*shape, {}) for shape in meshes or shapes_of(chain)]
        solid += [(*shape, {"opacity": 0.2, "side": "double"}) for shape in shapes_of_walls(walls, chain)]
        for k, (frame, mesh, color, look) in enumerate(solid):
            scene.add_mesh_simple(f"/{frame}/{k}", mesh.vertices, mesh.faces, color=rgb(color), **look)
        size = (0.6 if meshes else 1.1) * thick
        tips = range(motion.poses.shape[1] - len(chain.tips), motion.poses.shape[1])
        self.tips = [scene.add_icosphere(f"/{i}/tip", size, rgb(style.FINE)) for i in tips]
        self.goals = {i: target for i, target in enumerate(motion.targets) if target is not None}
        self.balls = {i: scene.add_icosphere(f"/goal{i}", 0.8 * thick, rgb(style.BLACK)) for i in self.goals}
        self._draw_paths(np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).round().astype(int)), thick)
        self._look(self.places.reshape(-1, 3), thick)
        self.show(0)

    def _draw_paths(self, some, thick):
        """Draw paths of tips in green, amber or red, and those of targets in grey."""
        add, paths = self.server.scene.add_line_segments, _segments(self.motion.paths[:, some])
        worst = np.maximum.reduceat(self.levels, some)[:-1]
        for kind in np.unique(worst):  # a line for each colour: with several it would be lighter
            lines = paths[:, worst == kind].reshape(-1, 2, 3)
            add(f"/path{kind}", lines, rgb(style.LEVELS[kind]), thickness=0.3 * thick)
        for i, target in self.goals.items():
            if np.ptp(target, axis=0).max() > 0:
                add(f"/wanted{i}", _segments(target[None, some])[0], rgb(GREY), thickness=0.12 * thick)

    def _look(self, points, thick):
        """Look from above at a planar arm, from a corner otherwise, at all that moves; draw a floor below it."""
        low, high, flat = points.min(0), points.max(0), is_planar(self.motion.chain)
        span = 1.3 * max(np.linalg.norm(high - low), float(arm_length(self.motion.chain)))
        away = np.array([0, -1e-3, 1.0]) if flat else np.array([0.83, 0.48, 0.37])
        right = np.array([1.0, 0, 0]) if flat else np.array([-0.5, 0.87, 0.0])
        middle = (low + high) / 2 + 0.2 * span * right  # the panel covers the right of the page
        cell = 10.0 ** np.floor(np.log10(span / 2)) / 2
        floor = (*middle[:2], min(low[2], 0.0) - 2 * thick)
        look = {"cell_size": cell, "section_size": 5 * cell, "cell_thickness": 0.7}
        self.server.scene.add_grid("/floor", 4 * span, 4 * span, position=floor, **look)
        camera = self.server.initial_camera
        camera.position, camera.look_at = tuple(middle + span * away), tuple(middle)
        camera.up, camera.fov = (0, 1, 0) if flat else (0, 0, 1), np.radians(50)

    def show(self, k) -> None:
        """Show the instant of index k."""
        with self.server.atomic():
            for i, frame in enumerate(self.frames):
                frame.position, frame.wxyz = self.places[k, i], self.turns[k, i]
            for ball in self.tips:
                ball.color = rgb(style.LEVELS[self.levels[k]])
            for i, ball in self.balls.items():
                ball.position = self.goals[i][k]


def _segments(paths):
    """Return lines (paths, k − 1, 2, 3) from each point of some paths (paths, k, 3) to the next."""
    return np.stack([paths[:, :-1], paths[:, 1:]], 2)
