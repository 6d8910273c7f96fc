"""Meshes that a URDF file names, fixed to the frames of a chain; what isn't found, or can't be read, is left out."""

import contextlib
import os
import pathlib
from xml.etree import ElementTree

import numpy as np

from cnclik import errors
from cnclik.reading import read_bytes
from cnclik.robot.bases import BALL, grounded, unfolded
from cnclik.robot.tree import MOVING, read_urdf
from cnclik.show import style
from cnclik.show.viewer.body import GREY, Part

ENDINGS = (".stl", ".dae", ".obj", ".ply", ".glb")
MOST_BYTES = 40 << 20  # largest size of a mesh file
MOST_FACES = 4000  # faces of a link, so that a page stays near 1 MB


def mesh_parts(file, tips=None, base=None, *, color=style.SKY, faces=MOST_FACES) -> list:
    """The robot's meshes and simple shapes as parts; [] where there are none.

    Of a link its visual shapes, or where one of them can't be read (Collada needs pycollada) those for collisions.
    Links beside the ways from base to tips, such as fingers, are drawn with their joints at 0.

    Args:
      file, base: as for `load_urdf`. tips: names of links, None: the only one that the joints move. faces: of a link,
        at most; larger meshes are made coarser.
    """
    file = pathlib.Path(file).resolve()
    try:
        root = ElementTree.fromstring(read_bytes("path", file, "a URDF file"))
    except ElementTree.ParseError:  # such as undeclared prefixes
        return []
    if root.tag != "robot":  # MJCF
        return []
    links = {one.get("name"): one for one in root.findall("link")}
    found = []
    for name, (frame, at) in placed(read_urdf(file), tips, base).items():
        for kind in ("visual", "collision"):
            shapes = [_shape(file, one) for one in links[name].findall(kind)] if name in links else []
            if shapes and all(shape is not None for shape in shapes):
                look = GREY if frame == 0 else color
                found += [Part(frame, *_thinned(_moved(shape, at), faces), look) for shape in shapes]
                break
    return found


def placed(tree, tips, base) -> dict:
    """{link: (frame, 4×4 in that frame)} of all links that hang together with the base."""
    tree, base = grounded(tree, base)
    tips = tips or tree.tips(base)[:1]
    tree = unfolded(tree, base, tips)
    ways = [edge for tip in tips for way in tree.way(tip, base) for edge in way]
    order = dict.fromkeys(id(edge) for edge in ways if edge.type in (*MOVING, BALL))  # as `load_urdf` has the joints
    frame_of = {edge: i for i, edge in enumerate(order, 1)}
    found, waiting = {base: (0, np.eye(4))}, [base]
    while waiting:
        link = waiting.pop()
        frame, at = found[link]
        above = tree.above.get(link)
        for edge, other, turned in (
            *((e, e.child, False) for e in tree.below[link]),
            *(((above, above.parent, True),) if above is not None else ()),
        ):
            if other in found:
                continue
            own = _matrix(edge.origin)
            after = at @ (np.linalg.inv(own) if turned else own)
            if id(edge) in frame_of:  # the chain's frame stands where the joint is
                found[other] = frame_of[id(edge)], np.linalg.inv(own) if turned else np.eye(4)
            else:
                found[other] = frame, after
            waiting.append(other)
    return found


def _matrix(origin):
    made = np.eye(4)
    made[:3, 3], made[:3, :3] = origin
    return made


def _shape(file, element):
    """(vertices, faces) of a <visual> or <collision> in its link's frame, or None."""
    import trimesh

    try:
        geometry, origin = element.find("geometry"), element.find("origin")
        at = np.eye(4)
        if origin is not None:
            at = trimesh.transformations.euler_matrix(*_three(origin, "rpy", "0 0 0"))
            at[:3, 3] = _three(origin, "xyz", "0 0 0")
        (kind,) = geometry
        if kind.tag == "box":
            made = trimesh.creation.box(_three(kind, "size"))
        elif kind.tag == "cylinder":
            made = trimesh.creation.cylinder(float(kind.get("radius")), float(kind.get("length")), sections=24)
        elif kind.tag == "sphere":
            made = trimesh.creation.icosphere(2, float(kind.get("radius")))
        else:
            path = _found(file, kind.get("filename"))
            if path is None or path.stat().st_size > MOST_BYTES:
                return None
            made = trimesh.load(path, force="mesh")
            made.apply_scale(_three(kind, "scale", "1 1 1"))
        return _moved((np.asarray(made.vertices, float), np.asarray(made.faces)), at) if len(made.faces) else None
    except Exception:  # damaged files raise all kinds of errors in a dozen readers
        return None


def _three(element, name, default=None):
    return np.array([float(v) for v in element.get(name, default).split()])


def _moved(shape, at):
    vertices, faces = shape
    return vertices @ at[:3, :3].T + at[:3, 3], faces


def _found(file, name):
    """The mesh that a URDF file means by package://PACKAGE/…, model://…, file://… or a path; None where it isn't.

    A page is sent to others, and a URDF file may come from others: only meshes of its own package are drawn.
    """
    scheme, mark, rest = name.partition("://")
    root, places = _package(file), [file.parent / (rest if mark else name)]
    if mark and scheme != "file":
        package, _, inner = rest.partition("/")
        places = [root / package / inner, *[root / inner] * (package in _names(root))]
    inside = (place for place in map(pathlib.Path.resolve, places) if place.is_relative_to(root))
    return next((place for place in inside if place.suffix.lower() in ENDINGS and os.path.isfile(place)), None)


def _package(file):
    """The folder of the package that a URDF file is in: the next one up with a package.xml; else that above the file's
    own, where it is laid out as one (urdf/ beside meshes/); else the file's own."""
    laid_out = os.path.isdir(file.parent.parent / "meshes") and file.parent.name in ("urdf", "robot", "robots")
    marked = (folder for folder in file.parents if os.path.isfile(folder / "package.xml"))
    return next(marked, file.parent.parent if laid_out else file.parent)


def _names(root):
    """What a package is called: by its folder, and by its package.xml."""
    yield root.name
    with contextlib.suppress(errors.ArgumentError, ElementTree.ParseError):
        about = read_bytes("package.xml", root / "package.xml", "a file")
        yield (ElementTree.fromstring(about).findtext("name") or "").strip()


def _thinned(shape, most) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with vertices in one cell of a grid made one, in cells that grow until it is small."""
    vertices, faces = shape
    span = np.ptp(vertices, axis=0).max()
    for cells in (128, 96, 64, 48, 32, 24, 16):
        if len(faces) <= most or span == 0:
            break
        _, first, to = np.unique(np.round(vertices * (cells / span)), axis=0, return_index=True, return_inverse=True)
        faces = to.reshape(-1)[faces]
        vertices = vertices[first]
        alike = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 0] == faces[:, 2])
        faces = np.unique(faces[~alike], axis=0)
    return vertices, faces
