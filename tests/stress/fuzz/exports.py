"""Exports: names of every kind, joints of every kind and name."""

import shutil
import subprocess

import cnclik as ck
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from tests.stress.fuzz.nasty import TEXTS, any_of, chance, slipped

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


def draw(rng):
    """What to export, and how it is called."""
    name = any_of(rng, NAMES)
    name = any_of(rng, TEXTS) if chance(rng, 0.2) else slipped(rng, name) if chance(rng, 0.3) else name
    kinds = [any_of(rng, ("revolute", "prismatic", "continuous")) for _ in range(int(rng.integers(1, 4)))]
    axes = [any_of(rng, ("1 0 0", "0 1 0", "0 0 1", "0 0.6 0.8")) for _ in kinds]
    joints = [any_of(rng, ("j", "a/*b", "*/", "??/", "\\", *TEXTS)) for _ in kinds]
    dtype = any_of(rng, ("float64", "float32", "float16"))
    return name, list(zip(kinds, axes, joints, strict=True)), chance(rng, 0.2), dtype


def _robot(joints, file):
    """A chain of such joints, from a file; their names, which XML can't hold, are given afterwards."""
    text = "".join(
        f'<link name="l{i}"/><joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/><origin '
        f'xyz="0.1 0 0.2"/><axis xyz="{axis}"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for i, (kind, axis, _) in enumerate(joints)
    )
    file.write_text(f'<robot name="r">{text}<link name="l{len(joints)}"/></robot>')
    return ck.replace(chain(read_urdf(file)), joint_names=tuple(name for *_, name in joints))


def attempt(made, folder) -> None:
    """C that no compiler warns of, or a refusal."""
    name, joints, step, dtype = made
    arm = _robot(joints, folder / "arm.urdf")
    law = ck.Law(arm, ck.position("x"), alpha=5.0, inverse=ck.damped(0.1)) if step else arm
    out = ck.export.c(law, out=folder / "out", name=name, dtype=dtype)
    if shutil.which("cc"):
        sources = [path.name for path in out.glob("*.c")]
        done = subprocess.run(["cc", *FLAGS, *sources], cwd=out, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[:2000]
