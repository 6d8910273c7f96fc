"""Scene: one or two motions in a viser scene, moved from instant to instant."""

import numpy as np

from cnclik.robot.posture import arm_length, is_planar
from cnclik.show import style
from cnclik.show.viewer.body import GREY, parts_of, radius_of
from cnclik.show.viewer.meshes import mesh_parts
from cnclik.show.viewer.motion import GOOD, LEVELS

MOST_POINTS = 600  # of a path
BESIDE = (GREY, "#5A6066")  # links and joints of the second motion


def rgb(color: str) -> tuple:
    """A colour of `style`, such as "#0072B2", as three bytes."""
    return tuple(bytes.fromhex(color.lstrip("#")))


def quaternions(rotations) -> np.ndarray:
    """(…, 4) w x y z of rotations (…, 3, 3), in NumPy: of the four products qᵢqⱼ the row of the largest."""
    r = np.asarray(rotations, float)
    (a, b, c), (d, e, f), (g, h, i) = (tuple(r[..., k, j] for j in range(3)) for k in range(3))
    rows = np.stack(
        [
            np.stack([1 + a + e + i, h - f, c - g, d - b], -1),
            np.stack([h - f, 1 + a - e - i, b + d, c + g], -1),
            np.stack([c - g, b + d, 1 - a + e - i, f + h], -1),
            np.stack([d - b, c + g, f + h, 1 - a - e + i], -1),
        ],
        -2,
    )
    largest = np.argmax(np.stack([1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i], -1), -1)
    found = np.take_along_axis(rows, largest[..., None, None], -2)[..., 0, :]
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


class Scene:
    """Motions beside each other on a floor; `show` moves them."""

    def __init__(self, server, *, panel=False):
        """Args: panel: whether a panel covers the right of the page, beside which the camera then looks."""
        self.panel = panel
        self.server, self.motions, self._drawn, self._laid = server, (), [], None
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)

    def put(self, motions) -> None:
        """Draw these motions, and no others; a robot that is there already only moves."""
        motions = tuple(motions)
        kinds = [(m.chain, m.links) for m in motions]
        if (
            self._laid is None
            or len(kinds) != len(self._laid)
            or any(a[0] is not b[0] for a, b in zip(kinds, self._laid, strict=True))
        ):
            self._lay(motions)
        self._laid, self.motions = kinds, motions
        with self.server.atomic():
            for drawn, motion in zip(self._drawn, motions, strict=True):
                drawn.put(motion)
        self.show(0.0)

    def _lay(self, motions):
        for drawn in self._drawn:
            drawn.root.remove()
        size = max(arm_length(m.chain) for m in motions)
        flat = all(is_planar(m.chain) for m in motions)
        # Side by side as the camera sees it: it looks along −z at planar arms, and else along a corner.
        aside = np.array([1.0, 0, 0]) if flat else np.array([-0.5, 1.0, 0]) / np.hypot(1, 0.5)
        apart = 0.35 * size + max(np.ptp(_places(m) @ aside) for m in motions)
        shifts = [aside * apart * (k - (len(motions) - 1) / 2) for k in range(len(motions))]
        looks = [{}, dict(color=BESIDE[0], dark=BESIDE[1])]
        self._drawn = [
            _Drawn(self.server, f"/run{k}", m, shift, looks[min(k, 1)])
            for k, (m, shift) in enumerate(zip(motions, shifts, strict=True))
        ]
        self._look(motions, shifts, size, flat)

    def _look(self, motions, shifts, size, flat):
        """From above a planar arm, from a corner else; as near as all that moves allows."""
        points = np.concatenate([_places(m) + s for m, s in zip(motions, shifts, strict=True)])
        low, high = points.min(0), points.max(0)
        middle, (wide, deep, tall) = (low + high) / 2, high - low
        span = max(wide / 1.4, deep) if flat else max(np.hypot(wide, deep) / 1.2, 1.1 * tall)
        span = 1.35 * max(span, 0.6 * size)
        step = 10.0 ** np.floor(np.log10(span / 2))
        look = dict(cell_size=step / 2, section_size=5 * step / 2, cell_thickness=0.7)
        floor = -2.0 * radius_of(motions[0].chain) if flat else 0.0
        area = 2 * (np.array([wide, deep]) + span)
        self.server.scene.add_grid("/floor", *area, position=(*middle[:2], floor), **look)
        camera = self.server.initial_camera
        away = np.array([0, -1e-3, 1.0]) if flat else np.array([0.95, 0.55, 0.42])
        away = away / np.linalg.norm(away)
        if self.panel:
            right = np.array([1.0, 0, 0]) if flat else np.cross([0, 0, 1.0], away)
            middle, span = middle + 0.2 * span * right / np.linalg.norm(right), 1.1 * span
        camera.position = tuple(middle + span * away)
        camera.look_at = tuple(middle)
        camera.up = (0, 1, 0) if flat else (0, 0, 1)
        camera.fov = np.radians(50)

    def show(self, share) -> None:
        """Every motion at the instant that is this share of its length, 0 to 1."""
        with self.server.atomic():
            for drawn, motion in zip(self._drawn, self.motions, strict=True):
                drawn.show(round(share * (len(motion.t) - 1)))


class _Drawn:
    """What stands for one motion in a scene."""

    def __init__(self, server, name, motion, shift, look):
        scene, self.name, self.thick = server.scene, name, radius_of(motion.chain)
        self.server, self.level = server, None
        self.root = scene.add_frame(name, show_axes=False, position=shift)
        parts = mesh_parts(*motion.links, **{k: v for k, v in look.items() if k == "color"}) if motion.links else []
        self.parts = parts or parts_of(motion.chain, **look)
        count = motion.poses.shape[1]
        self.frames = [scene.add_frame(f"{name}/frame{i}", show_axes=False) for i in range(count)]
        for k, part in enumerate(self.parts):
            at = f"{name}/frame{part.frame}/part{k}"
            scene.add_mesh_simple(at, part.vertices, part.faces, color=rgb(part.color))
        self.tip = scene.add_icosphere(
            f"{name}/frame{count - 1}/tip", (0.6 if parts else 1.1) * self.thick, rgb(LEVELS[GOOD])
        )
        self.goal = self.line = None

    def put(self, motion):
        self.motion, scene = motion, self.server.scene
        self.where, self.turned = motion.poses[:, :, :3, 3], quaternions(motion.poses[:, :, :3, :3])
        colors = [rgb(LEVELS[i]) for i in motion.level]
        if motion.unit == "target":
            look = dict(point_size=1.2 * self.thick, point_shape="circle", precision="float32", point_shading="flat")
            scene.add_point_cloud(f"{self.name}/targets", motion.target, np.array(colors, np.uint8), **look)
        else:
            _polyline(scene, f"{self.name}/way", motion.way, colors, 0.3 * self.thick)
        if motion.target is None:
            return
        if np.ptp(motion.target, axis=0).max() > 0 and motion.unit == "s":
            _polyline(scene, f"{self.name}/wanted", motion.target, None, 0.12 * self.thick)
        if self.goal is None:
            self.goal = scene.add_icosphere(f"{self.name}/goal", 0.8 * self.thick, rgb(style.BLACK))
        line = np.zeros((1, 2, 3))
        self.line = scene.add_line_segments(
            f"{self.name}/error", line, rgb(style.VERMILION), thickness=0.3 * self.thick
        )

    def show(self, k):
        for i, frame in enumerate(self.frames):
            frame.position, frame.wxyz = self.where[k, i], self.turned[k, i]
        if self.motion.level[k] != self.level:
            self.level = self.motion.level[k]
            self.tip.color = rgb(LEVELS[self.level])
        if self.line is not None and self.motion.target is not None:
            self.goal.position = self.motion.target[k]
            self.line.points = np.stack([self.where[k, -1], self.motion.target[k]])[None].astype(np.float32)


def _places(motion):
    """Places that a motion takes up (k, 3) [m]: of its joints and tip at some instants."""
    return motion.poses[:: max(len(motion.t) // 50, 1), :, :3, 3].reshape(-1, 3)


def _polyline(scene, name, points, colors, thickness):
    """A line through points (K, 3), in one colour or in one for each; every few of many are drawn."""
    some = np.unique(np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int))
    if len(some) < 2:
        return
    points = points[some]
    color = rgb(GREY) if colors is None else np.repeat(np.array(colors, np.uint8)[some][1:, None], 2, axis=1)
    scene.add_line_segments(name, np.stack([points[:-1], points[1:]], 1), color, thickness=thickness)
