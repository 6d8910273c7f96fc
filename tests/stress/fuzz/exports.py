"""Exports: names of every kind, joints of every kind and name; and folders that a disk has damaged, loaded again."""

import functools
import pathlib
import shutil
import subprocess
import tempfile

import numpy as np

import cnclik as ck
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from tests.stress.fuzz.nasty import TEXTS, any_of, chance, damaged, slipped

NAMES = (
    "clik_step",
    "example",
    "NULL",
    "stdout",
    "isnan",
    "REAL",
    "input",
    "i",
    "int32_t",
    "main",
    "unix",
    "V",
    "a" * 60,
)
FLAGS = ("-std=c99", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-pedantic")
DAMAGES = ("flip", "flip", "noise", "gone", "empty", "device", "folder")
DAMAGED = ("export.json", "clik_step.c", "clik_step.h", "clik_step*.so")


def draw(rng):
    """What to export and how it is called; or what happens to a file of a folder that was exported before."""
    if chance(rng, 0.5):
        return any_of(rng, DAMAGED), any_of(rng, DAMAGES), int(rng.integers(1 << 30))
    name = any_of(rng, NAMES)
    name = any_of(rng, TEXTS) if chance(rng, 0.2) else slipped(rng, name) if chance(rng, 0.3) else name
    kinds = [any_of(rng, ("revolute", "prismatic", "continuous")) for _ in range(int(rng.integers(1, 4)))]
    axes = [any_of(rng, ("1 0 0", "0 1 0", "0 0 1", "0 0.6 0.8")) for _ in kinds]
    joints = [any_of(rng, ("j", "a/*b", "*/", "??/", "\\", *TEXTS)) for _ in kinds]
    what, dtype = (
        any_of(rng, ("fk", "jacobian", "fk", "jacobian", "step")),
        any_of(rng, ("float64", "float32", "float16")),
    )
    return name, list(zip(kinds, axes, joints, strict=True)), what, dtype


def _robot(joints, file):
    """A chain of such joints, from a file; their names, which XML can't hold, are given afterwards."""
    text = "".join(
        f'<link name="l{i}"/><joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/><origin '
        f'xyz="0.1 0 0.2"/><axis xyz="{axis}"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for i, (kind, axis, _) in enumerate(joints)
    )
    file.write_text(f'<robot name="r">{text}<link name="l{len(joints)}"/></robot>')
    return ck.replace(chain(read_urdf(file)), joint_names=tuple(name for *_, name in joints))


@functools.cache
def _place():
    """A folder with an export that is there until the process ends."""
    place = tempfile.TemporaryDirectory(prefix="cnclik-fuzz-", ignore_cleanup_errors=True)
    ck.export.load(ck.export.c(ck.planar_arm([1.0, 0.8]), out=pathlib.Path(place.name, "whole"), what="fk"))
    return place


def attempt(made, folder) -> None:
    """C that no compiler warns of; or the very function, or a refusal."""
    if len(made) == 3:
        _damaged(*made, folder)
        return
    name, joints, what, dtype = made
    arm = _robot(joints, folder / "arm.urdf")
    law = ck.Law(arm, ck.position("x"), alpha=5.0, inverse=ck.damped(0.1)) if what == "step" else arm
    out = ck.export.c(law, out=folder / "out", what=what, name=name, dtype=dtype)
    if shutil.which("cc"):
        sources = [path.name for path in out.glob("*.c")]
        done = subprocess.run(["cc", *FLAGS, *sources], cwd=out, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[:2000]


def _damaged(file, kind, seed, folder):
    rng = np.random.default_rng(seed)
    if not shutil.which("cc"):
        return
    shutil.copytree(pathlib.Path(_place().name, "whole"), folder / "whole")
    (one,) = (folder / "whole").glob(file)
    data = one.read_bytes()
    one.unlink()
    match kind:
        case "flip":
            k = int(rng.integers(len(data)))
            one.write_bytes(data[:k] + bytes([data[k] ^ (1 << int(rng.integers(8)))]) + data[k + 1 :])
        case "noise":
            one.write_bytes(damaged(rng, data))
        case "empty":
            one.write_bytes(b"")
        case "device":
            one.symlink_to("/dev/zero")
        case "folder":
            one.mkdir()
    if file.endswith(".so") and kind == "folder":
        return  # the library is built beside
    found = ck.export.load(folder / "whole")([0.3, 0.4]).position
    wanted = np.asarray(ck.forward(ck.planar_arm([1.0, 0.8]), [0.3, 0.4]).position)
    assert np.allclose(found, wanted, atol=1e-15), found
