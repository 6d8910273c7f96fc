"""Shapes: the meshes that a robot's URDF file names, or cylinders made of a chain alone; and those of walls."""

import contextlib
import os
import pathlib
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import trimesh
from trimesh.creation import box, capsule, cylinder, icosphere

from cnclik.reading import read_bytes
from cnclik.robot.chain import PRISMATIC
from cnclik.robot.files import is_mjcf
from cnclik.robot.posture import arm_length
from cnclik.robot.tree import BALL, read_urdf
from cnclik.robot.urdf import chain as chain_of
from cnclik.show import style
from cnclik.show.motion import link_poses
from cnclik.task.parts import AXES

ENDINGS = (".stl", ".dae", ".obj", ".ply", ".glb")


class Shape(NamedTuple):
    """A mesh that moves with a frame."""

    frame: int
    mesh: trimesh.Trimesh
    color: str


def thickness(chain) -> float:
    """Return the radius of a drawn link [m]."""
    return 0.028 * float(arm_length(chain))


def shapes_of(chain) -> list:
    """Return shapes of a chain, or of a tree: links in one colour, joints in another. Frames are those of a Motion."""
    thick, shapes = thickness(chain), []
    ends = [(parent + 1, joint.origin) for joint, parent in zip(chain.joints, chain.parents, strict=True)]
    for frame, offset in [*ends, *((tip.joint + 1, tip.offset) for tip in chain.tips)]:
        end = np.array(offset.position, float)
        if np.linalg.norm(end) > 0.2 * thick:
            color = style.SKY if frame else style.GREY
            shapes.append(Shape(frame, cylinder(thick, segment=[0 * end, end]), color))
    for i, joint in enumerate(chain.joints, 1):
        of_base = joint.kind == PRISMATIC and np.isinf(chain.lower[joint.coordinate])
        if joint.kind != BALL and not of_base:  # joints of a base have no shape
            along = 1.2 * thick * np.array(joint.axis, float)
            shapes.append(Shape(i, cylinder(1.3 * thick, segment=[-along, along]), style.BLUE))
    return shapes


def meshes_of(file, motion) -> tuple:
    """Return (meshes of a URDF file's links, poses of the motion's frames and of those links).

    Links that the run does not move, such as fingers, are drawn with their joints at 0.
    """
    file, chain = pathlib.Path(file).resolve(), motion.chain
    if is_mjcf(file):
        return [], motion.poses
    root, tree = ElementTree.fromstring(read_bytes("robot", file, "a URDF file")), read_urdf(file)
    drawn = {link.get("name"): meshes for link in root.findall("link") if (meshes := link_meshes(file, link))}
    tip = next((k for k, tip in enumerate(chain.tips) if tip.name in tree.links), None)
    if not drawn or tip is None:
        return [], motion.poses
    links = list(dict.fromkeys([*drawn, chain.tips[tip].name]))
    moving = any(edge.type in ("floating", "planar") for edge in tree.edges)
    whole = chain_of(tree, base=None if moving else "free", tips=links)
    q = np.zeros((len(motion.poses), whole.n))
    for name, values in zip(chain.joint_names, motion.data.q.values.T, strict=True):
        if name in whole.joint_names:
            q[:, whole.joint_names.index(name)] = values
    poses = link_poses(whole, q)[:, -len(links) :]
    own, of_whole = motion.poses[:, tip - len(chain.tips)], poses[:, links.index(chain.tips[tip].name)]
    poses = (own @ np.linalg.inv(of_whole))[:, None] @ poses  # in the chain's own base frame
    first = motion.poses.shape[1]
    shapes = [Shape(first + links.index(link), mesh, style.SKY) for link, some in drawn.items() for mesh in some]
    return shapes, np.concatenate([motion.poses, poses], 1)


def link_meshes(file, link) -> list:
    """Return the meshes of a <link>; none where one can't be read."""
    with contextlib.suppress(Exception):  # damaged files raise all kinds of errors in a dozen readers
        return [_mesh(file, element) for element in link.findall("visual")]
    return []


def _mesh(file, element):
    """Return the mesh of a <visual> or <collision> in its link's frame."""
    (shape,), origin = element.find("geometry"), element.find("origin")
    size = {key: np.array(text.split(), float) for key, text in shape.items() if key != "filename"}
    if shape.tag == "box":
        mesh = box(size["size"])
    elif shape.tag == "cylinder":
        mesh = cylinder(size["radius"][0], size["length"][0])
    elif shape.tag == "sphere":
        mesh = icosphere(2, size["radius"][0])
    else:
        mesh = trimesh.load(_file_of(file, shape.get("filename")), force="mesh").apply_scale(size.get("scale", 1.0))
    if origin is not None:
        turn, place = (np.array(origin.get(name, "0 0 0").split(), float) for name in ("rpy", "xyz"))
        mesh.apply_transform(trimesh.transformations.euler_matrix(*turn)).apply_translation(place)
    if not len(mesh.faces):
        raise ValueError("no faces")
    return mesh


def _file_of(file, name):
    """Return the mesh that a URDF file means by package://PACKAGE/…, model://…, file://… or a path, or None.

    A URDF file may come from others, and others may look at the page: only meshes of its own package are drawn. That is
    the next folder up with a package.xml; else the one above the file's own, if that has meshes/; else the file's own.
    """
    above = file.parents[1] if os.path.isdir(file.parents[1] / "meshes") else file.parent
    root = next((folder for folder in file.parents if os.path.isfile(folder / "package.xml")), above)
    scheme, mark, rest = name.partition("://")
    package = mark and scheme != "file"
    places = [root / rest, root / rest.partition("/")[2]] if package else [file.parent / (rest or name)]
    inside = (place for place in map(pathlib.Path.resolve, places) if place.is_relative_to(root))
    return next((place for place in inside if place.suffix.lower() in ENDINGS and os.path.isfile(place)), None)


def shapes_of_walls(walls, chain) -> list:
    """Return shapes of walls that are of positions or of distances: planes, and what is kept off each other."""
    shapes = []
    for part, wall in ((wall.task.parts[0], wall) for wall in walls):
        if hasattr(part, "one"):
            for solid in (part.one, part.other):
                start, *_, end = np.broadcast_to(solid.ends, (2, 3)).astype(float)
                mesh = capsule(np.linalg.norm(end - start), float(solid.radius))
                mesh = _placed(mesh, end - start, (start + end) / 2)
                shapes.append(Shape(_frame(solid.tip, chain), mesh, style.LOST))
        elif hasattr(part, "axes"):
            normal, wide = np.zeros(3), float(arm_length(chain))
            normal[[AXES.index(axis) for axis in part.axes]] = wall.normal
            mesh = _placed(box((wide, wide, 0.002 * wide)), normal, normal * float(wall.offset) / (normal @ normal))
            shapes.append(Shape(_frame(part.to, chain), mesh, style.LOST))
    return shapes


def _placed(mesh, direction, place):
    """Return a mesh at a place, with its axis z in a direction; not for one of no length."""
    turn = trimesh.geometry.align_vectors([0, 0, 1], direction) if direction.any() else np.eye(4)
    return mesh.apply_transform(turn).apply_translation(place)


def _frame(tip, chain) -> int:
    return 0 if tip is None else 1 + len(chain.joints) + chain.tip_number(tip)
