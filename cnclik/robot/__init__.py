"""The robot: chains and the ways to build one, where the tip is and how it moves."""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__,
    {
        "chain": "Chain Joint Offset assemble from_dh from_screws planar_arm with_tool",
        "kinematics": "Pose jacobian manipulability pose",
        "urdf": "load_urdf",
        "builtin": "panda ur5",
    },
)
