"""Front: `view`, which plays a run in a browser."""

import importlib.util

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.trajectory import Trajectory, one_lane
from cnclik.law.law import Law
from cnclik.measure.dataset import to_dataset
from cnclik.problem.build import Problem
from cnclik.robot.files import file_of
from cnclik.show.motion import motion_of


def has_viser() -> bool:
    """Return whether viser can be imported."""
    return importlib.util.find_spec("viser") is not None


def view(what, law=None, *, robot=None, host="localhost", port=8080):
    """Play a run in a browser: `ck.show.view(run, law)`.

    Args:
      what: a `Trajectory` with its law, one lane; or a `Problem`, which is run.
      law: of a `Trajectory`.
      robot: URDF file with the robot's meshes; without it, cylinders stand for links and joints.
      host, port: where to listen; on the next free port.

    Returns: a `Viewer` with `url` and `stop()`.
    Raises: ArgumentError where viser is missing, or for what can't be shown.
    """
    if not has_viser():
        install = "pip install 'cnclik[viewer]'"
        raise errors.ArgumentError(f"The viewer needs the package viser, which is not installed: {install}")
    from cnclik.show.viewer.scene import Viewer  # needs viser, and trimesh, which comes with it

    if isinstance(what, Problem):
        run, law, name, robot = jax.tree.map(np.asarray, what.run()), what.law, what.name, robot or what.robot
    else:
        run, law = errors.kind("run", what, Trajectory), errors.kind("law", law, Law)
        one_lane(run)
        name = f"{law.chain.n} joints"
    file = None if robot is None or hasattr(robot, "joints") else file_of(str(robot))
    motion, walls = motion_of(to_dataset(run, law), law.chain), getattr(law.limits, "walls", ())
    return Viewer(motion, name=name, walls=walls, robot=file, host=host, port=port)
