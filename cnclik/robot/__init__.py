"""The robot: chains and the ways to build one, where the tip is and how it moves."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "chain": ["Chain", "Joint", "Offset", "assemble", "from_dh", "from_screws", "planar_arm"],
        "mounted": ["join", "with_base", "with_tool"],
        "kinematics": ["Pose", "forward", "jacobian", "manipulability"],
        "exchange": ["from_mujoco_q", "from_pinocchio_q", "to_mujoco_q", "to_pinocchio_q"],
        "urdf": ["load_urdf"],
        "mjcf": ["load_mjcf"],
        "builtin": ["panda", "ur5"],
    },
)
