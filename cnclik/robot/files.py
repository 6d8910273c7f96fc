"""Robot files: URDF or MJCF, recognized by their content; and the names of robot_descriptions."""

import importlib
import importlib.util
import os
import re

from cnclik import errors
from cnclik.reading import read_bytes
from cnclik.robot.tree import Tree, read_urdf, text_of


@errors.called("path", "robot")
@errors.called("model", "robot")
def read_robot(robot) -> Tree:
    """Return the kinematic tree of a URDF or MJCF file, of its text, or of a MuJoCo model.

    Raises: ArgumentError as `load_urdf` and `load_mjcf`.
    """
    if is_mjcf(robot):
        from cnclik.robot.mjcf import read_mjcf  # not at the top: a URDF file is shown without JAX

        return read_mjcf(robot)
    return read_urdf(robot)


def is_mjcf(robot) -> bool:
    """Return whether it is a MuJoCo model, or a file or text whose first element is <mujoco>."""
    if type(robot).__module__.partition(".")[0] == "mujoco":
        return True
    if (text := text_of(robot)) is not None:
        data = text.encode(errors="replace")
    elif isinstance(robot, (str, os.PathLike)) and os.path.isfile(robot):
        data = read_bytes("robot", robot, "a file of a robot")
    else:
        return False
    first = re.search(rb"<([\w:.-]+)", re.sub(rb"<!--.*?-->", b"", data, flags=re.S))
    return first is not None and first[1] == b"mujoco"


def file_of(name: str) -> str | None:
    """Return the file for a name: itself, or that of robot_descriptions, which downloads it; None for any other name.

    Raises: ArgumentError if robot_descriptions knows the name but cannot load it.
    """
    if os.path.exists(name) or name.lower().endswith((".urdf", ".xml", ".xacro", ".mjcf")):
        return name
    module = f"robot_descriptions.{name}"
    known = re.fullmatch(r"[a-z]\w*", name) and importlib.util.find_spec("robot_descriptions")
    if not (known and importlib.util.find_spec(module)):
        return None
    try:
        loaded = importlib.import_module(module)
        return str(getattr(loaded, "URDF_PATH", None) or loaded.MJCF_PATH)
    except Exception as error:  # noqa: BLE001 - network, git and disk raise different errors
        must = "be one that robot_descriptions can load, in URDF or MJCF"
        raise errors.fail("robot", must, f"{name!r} ends with {errors.in_a_line(error)}") from None
