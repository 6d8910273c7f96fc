"""Parts that are no tip's pose: joint values, and functions of them."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import record, replace
from cnclik.robot import chart
from cnclik.robot.rotations import library
from cnclik.task.parts import At, Vector


@record
class Joints(Vector):
    """Joint values themselves [rad, m]: a posture as a task."""

    wanted: tuple[str, ...] | None  # names of joints; None: all
    which: tuple[int, ...] | None = None  # set by `on`, for the robot
    units: tuple[str, ...] = ()
    tip, to = "joints", None
    called = "joint values"

    @property
    def names(self):
        if self.wanted is None:
            raise errors.fail("task", "name its joints where no robot is known", "is joints() of all of them")
        return self.wanted

    def on(self, chain):
        if self.which is not None:
            return self
        turned = {i + k for _, i in chain.balls for k in range(3)}
        wanted = self.wanted
        if wanted is None:  # all joints but floating ones
            bodies = {name[:-2] + name[-1] for name in (chain.joint_names[i] for i in turned)}
            wanted = tuple(name for i, name in enumerate(chain.joint_names) if i not in turned and name not in bodies)
        names, what = chain.joint_names, ", the joints that move a tip"
        which = tuple(names.index(errors.one_of("joints", name, names, what)) for name in wanted)
        if turned.intersection(which):
            name = wanted[[i in turned for i in which].index(True)]
            must = "leave out rotations, which ck.orientation(tip=...) of the link that turns is for"
            raise errors.fail("joints", must, f"name {name}")
        return replace(self, wanted=tuple(wanted), which=which, units=tuple(chain.units[i] for i in which))

    def x(self, robot: At):
        return robot.q[np.array(self.which)]

    def rows(self, robot: At, aim=None):
        q = robot.q
        rows = np.eye(robot.chain.n)[np.array(self.which)].astype(q.dtype)
        return library(q).broadcast_to(rows, (*q.shape[:-1], *rows.shape))


@record
class Function(Vector):
    """Any differentiable function of the joint values, or of them and a target, see `function`."""

    value: Callable
    names: tuple[str, ...]
    units: tuple[str, ...]
    of_target: Callable | None = None  # (robot, q, target) to e; None: target − value
    size: int | None = None  # of the target; None: m
    tip, to = "function", None

    @property
    def tied(self):
        return self.of_target is not None

    @property
    def shape(self):
        return (self.size or self.m,)

    def _checked(self, name, values, q):
        values = jnp.asarray(values)
        if values.shape != (self.m,):
            raise errors.fail(name, f"return shape ({self.m},), one of each name", f"returns shape {values.shape}")
        return values.astype(q.dtype)

    def here(self, robot: At):
        return None if self.size not in (None, self.m) else self.x(robot)

    def x(self, robot: At):
        return self._checked("value", self.value(robot.chain, robot.q), robot.q)

    def error(self, robot: At, aim):
        if self.of_target is None:
            return aim - self.x(robot)
        return self._checked("error", self.of_target(robot.chain, robot.q, aim), robot.q)

    def rows(self, robot: At, aim=None):
        chain = robot.chain

        def moved(start, y):
            at = At(chain, chart.out(chain, start, y))
            return self.x(at) if aim is None or self.of_target is None else -self.error(at, aim)

        def derivative(q):
            return jax.jacfwd(functools.partial(moved, q))(chart.centre(chain, q))

        return derivative(robot.q) if robot.q.ndim == 1 else np.asarray(jax.vmap(derivative)(robot.q))

    def velocity(self, robot: At, aim, motion):
        if self.of_target is None:
            return motion
        return jax.jvp(lambda aim: self.error(robot, aim), (aim,), (motion,))[1]
