"""Meshes of a page: those of the robot's own package, and no others, whatever a URDF file names."""

import pytest

trimesh = pytest.importorskip("trimesh")

from xml.etree import ElementTree  # noqa: E402

from cnclik.show import shapes  # noqa: E402


def robot(folder, *names):
    """A URDF file whose only link names meshes."""
    folder.mkdir(parents=True, exist_ok=True)
    seen = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in names)
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>'
    (folder / "arm.urdf").write_text(f'<robot name="r"><link name="a">{seen}</link><link name="b"/>{joint}</robot>')
    return folder / "arm.urdf"


def meshes(file):
    return shapes.link_meshes(file.resolve(), ElementTree.parse(file).find("link"))


def mesh(folder):
    folder.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((1, 1, 1)).export(folder / "part.stl")
    return folder / "part.stl"


@pytest.mark.parametrize(
    ("where", "names", "package"),  # where the file is, how it names meshes/part.stl of its package, whether marked
    [
        ("urdf/v1", ["package://arm/meshes/part.stl", "package://named/meshes/part.stl"], True),
        ("urdf", ["package://arm/meshes/part.stl", "../meshes/part.stl"], False),
        (".", ["meshes/part.stl", "package://arm/meshes/part.stl", "package://meshes/part.stl"], False),
    ],
)
def test_meshes_of_its_own_package_are_drawn(where, names, package, tmp_path):
    part = mesh(tmp_path / "arm" / "meshes")
    if package:
        (tmp_path / "arm/package.xml").write_text("<package><name>named</name></package>")
    for name in (*names, f"file://{part}"):
        (drawn,) = meshes(robot(tmp_path / "arm" / where, name))
        assert len(drawn.faces) == 12


@pytest.mark.parametrize("package", [False, True])
def test_no_other_mesh_of_the_disk_is_reached(package, tmp_path):
    theirs = mesh(tmp_path / "home" / "secret")
    inside = tmp_path / "home" / "downloads" / "arm"
    mesh(inside / "meshes")
    (inside / "link.stl").symlink_to(theirs)
    if package:
        (inside / "package.xml").write_text("<package/>")
    names = [f"{scheme}{theirs}" for scheme in ("", "file://", "package://", "package://.", "package://..")]
    names += ["package://downloads/../secret/part.stl", "model://home/secret/part.stl", "../../secret/part.stl"]
    names += [f"package://{folder.name}/../{theirs.relative_to(folder.parent)}" for folder in list(theirs.parents)[:3]]
    names += ["package://arm/../../secret/part.stl", "link.stl", "package://arm/link.stl", "package://", "://", ""]
    for name in names:
        for folder in (inside / "urdf", inside):
            assert meshes(robot(folder, name)) == [], name
