"""The robot: chains and the ways to build one, where the tip is and how it moves."""

import importlib

# On use: a URDF file is read and shown without loading JAX.
_ROOM = {
    "Chain": "chain",
    "Joint": "chain",
    "Offset": "chain",
    "Pose": "kinematics",
    "assemble": "chain",
    "from_dh": "chain",
    "from_screws": "chain",
    "jacobian": "kinematics",
    "load_urdf": "urdf",
    "manipulability": "kinematics",
    "panda": "builtin",
    "planar_arm": "chain",
    "pose": "kinematics",
    "ur5": "builtin",
    "with_tool": "chain",
}
__all__ = list(_ROOM)


def __getattr__(name):
    if name not in _ROOM:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_ROOM[name]}"), name)
