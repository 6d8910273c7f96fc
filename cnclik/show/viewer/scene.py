"""Scene: one or two motions in a viser scene, moved from instant to instant."""

import numpy as np

from cnclik import markup
from cnclik.robot import poses
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


# Side by side as the camera sees it: it looks along −z at planar arms, and else along a corner.
_ASIDE = {True: np.array([1.0, 0, 0]), False: np.array([-0.5, 1.0, 0]) / np.hypot(1, 0.5)}


class Scene:
    """Motions beside each other on a floor; `show` moves them."""

    def __init__(self, server, *, panel=False):
        """Args: panel: whether a panel covers the right of the page, beside which the camera then looks."""
        self.panel = panel
        self.server, self.motions, self._drawn, self._chains, self._apart = server, (), [], [], 0.0
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)

    def put(self, motions) -> None:
        """Draw these motions, and no others; a robot that is there already only moves."""
        motions = tuple(motions)
        chains, before = [m.chain for m in motions], self._chains
        flat, apart = _laid_out(motions)
        new = len(chains) != len(before) or any(a is not b for a, b in zip(chains, before, strict=True))
        new |= len(motions) > 1 and not 0.5 * self._apart < apart < 1.5 * self._apart
        if new:
            self._lay(motions, flat, apart)
        self._chains, self.motions = chains, motions
        with self.server.atomic():
            for drawn, motion in zip(self._drawn, motions, strict=True):
                drawn.put(motion)
        if new:
            self.show(0.0)

    def _lay(self, motions, flat, apart):
        for drawn in self._drawn:
            drawn.root.remove()
        size, self._apart = max(arm_length(m.chain) for m in motions), apart
        shifts = [_ASIDE[flat] * apart * (k - (len(motions) - 1) / 2) for k in range(len(motions))]
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
        span = max(wide / 1.15, deep) if flat else max(np.hypot(wide, deep) / 1.1, 1.1 * tall)
        span = 1.35 * max(span, 0.6 * size)
        step = 10.0 ** np.floor(np.log10(span / 2))
        look = dict(cell_size=step / 2, section_size=5 * step / 2, cell_thickness=0.7)
        below = min(drawn.lowest for drawn in self._drawn)  # a humanoid's feet are below its base
        floor = -2.0 * radius_of(motions[0].chain) if flat else below if below < -0.2 * size else 0.0
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
    """The objects of one motion in a scene."""

    def __init__(self, server, name, motion, shift, look):
        scene, self.name, self.thick = server.scene, name, radius_of(motion.chain)
        self.server, self.level = server, None
        self.root = scene.add_frame(name, show_axes=False, position=shift)
        parts = mesh_parts(*motion.links, **{k: v for k, v in look.items() if k == "color"}) if motion.links else []
        self.parts = parts or parts_of(motion.chain, **look)
        count = motion.poses.shape[1]
        self.first = count - len(motion.chain.tips)  # frame of the first tip
        self.frames = [scene.add_frame(f"{name}/frame{i}", show_axes=False) for i in range(count)]
        self.lowest = min((np.min(part.vertices @ at[2, :3] + at[2, 3]) for part in self.parts
                           for at in [motion.poses[0, part.frame]]), default=0.0)  # fmt: skip
        for k, part in enumerate(self.parts):
            at = f"{name}/frame{part.frame}/part{k}"
            scene.add_mesh_simple(at, part.vertices, part.faces, color=rgb(part.color))
        size = (0.6 if parts else 1.1) * self.thick
        self.tips = [
            scene.add_icosphere(f"{name}/frame{i}/tip", size, rgb(LEVELS[GOOD])) for i in range(self.first, count)
        ]
        self.goals, self.marks = {}, []

    def put(self, motion):
        self.motion, scene = motion, self.server.scene
        self.where, self.turned = motion.poses[:, :, :3, 3], poses.quaternions(motion.poses[:, :, :3, :3])
        for old in self.marks:
            old.remove()
        self.marks, self.lines = self._targets(motion) if motion.unit == "target" else self._ways(motion), {}
        for i, target in enumerate(motion.targets):
            if target is None:
                continue
            if i not in self.goals:
                self.goals[i] = scene.add_icosphere(f"{self.name}/goal{i}", 0.8 * self.thick, rgb(style.BLACK))
            look = dict(thickness=0.3 * self.thick)
            line = scene.add_line_segments(f"{self.name}/error{i}", np.zeros((1, 2, 3)), rgb(markup.LOST), **look)
            self.marks.append(line)
            self.lines[i] = line

    def _targets(self, motion):
        """A dot for each target, in the colour of its result."""
        look = dict(point_size=0.8 * self.thick, point_shape="circle", precision="float32", point_shading="flat")
        points = np.stack([target for target in motion.targets if target is not None])
        cloud, at = self.server.scene.add_point_cloud, f"{self.name}/targets"
        some = [(i, points[:, motion.level == i].reshape(-1, 3)) for i in np.unique(motion.level)]
        return [cloud(f"{at}{i}", places, rgb(LEVELS[i]), **look) for i, places in some]

    def _ways(self, motion):
        """The tips' ways, a line for each colour: lines of several colours would be lighter than these; and paths."""
        segments, (level, found) = self.server.scene.add_line_segments, _few(motion.level)
        made, lines = [], _joined(motion.ways[:, found])
        for i in np.unique(level[:-1]):
            some = lines[:, level[:-1] == i].reshape(-1, 2, 3)
            made.append(segments(f"{self.name}/way{i}", some, rgb(LEVELS[i]), thickness=0.3 * self.thick))
        wanted = [target[found] for target in motion.targets if target is not None and np.ptp(target, axis=0).max() > 0]
        if wanted:
            some = _joined(np.stack(wanted)).reshape(-1, 2, 3)
            made.append(segments(f"{self.name}/wanted", some, rgb(GREY), thickness=0.12 * self.thick))
        return made

    def show(self, k):
        for i, frame in enumerate(self.frames):
            frame.position, frame.wxyz = self.where[k, i], self.turned[k, i]
        if self.motion.level[k] != self.level:
            self.level = self.motion.level[k]
            for tip in self.tips:
                tip.color = rgb(LEVELS[self.level])
        for i, line in self.lines.items():
            at, to = self.where[k, self.first + i], self.motion.targets[i][k]
            self.goals[i].position = to
            line.points = np.stack([at, to])[None].astype(np.float32)


def _laid_out(motions):
    """Whether all robots are planar, and how far from each other they stand [m]."""
    flat, size = all(is_planar(m.chain) for m in motions), max(arm_length(m.chain) for m in motions)
    return flat, 0.35 * size + max(np.ptp(_places(m) @ _ASIDE[flat]) for m in motions)


def _places(motion):
    """Places that a motion takes up (k, 3) [m]: of its joints and tips at some instants."""
    return motion.poses[:: max(len(motion.t) // 50, 1), :, :3, 3].reshape(-1, 3)


def _joined(ways):
    """Lines (tips, k − 1, 2, 3) from each place of some ways (tips, k, 3) to the next."""
    return np.stack([ways[:, :-1], ways[:, 1:]], 2)


def _few(level):
    """Levels at few of many instants, each the worst up to the next one, and which instants these are."""
    some = np.unique(np.linspace(0, len(level) - 1, min(len(level), MOST_POINTS)).round().astype(int))
    return np.maximum.reduceat(level, some), some
