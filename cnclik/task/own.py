"""Parts in the frame of the tip itself: where the target is, as the tip sees it."""

from cnclik import errors
from cnclik.record import record
from cnclik.robot.rotations import library, log_so3, turn_from
from cnclik.task.parts import At, Orientation, Position, Vector, log_of_step, places, spin


@record
class OwnPosition(Position):
    """Coordinates of the target's position in the frame of the tip itself [m].

    e = Rᵀ (p_d − p), x = Rᵀ p. Its rows are those of the tip's Jacobian in its own frame, of the point of the tip that
    is where the target is: so the error of each axis decays by itself, whatever the others miss.
    """

    tied, shape = True, (3,)
    aim = Vector.aim
    moved = Vector.moved

    def check(self, position, rotation):
        if position is None or len(position) != 3:
            size = "none" if position is None else f"{len(position)}"
            raise errors.fail("reference", "give positions of 3 coordinates in the tip's own frame", f"gives {size}")

    def of_target(self):
        return Position(axes="xyz")

    def own(self, robot: At, v):
        return (v @ robot.rotation(self.tip, self.to))[places(self.axes)]

    def here(self, robot: At):
        return robot.position(self.tip, self.to)

    def x(self, robot: At):
        return self.own(robot, self.here(robot))

    def error(self, robot: At, aim):
        return self.own(robot, aim - self.here(robot))

    def velocity(self, robot: At, aim, motion):
        return self.own(robot, motion)

    def rows(self, robot: At, aim=None):
        every = (0, 1, 2)
        both = robot.rows(self.tip, self.to, every, () if aim is None else every)
        v = both[..., :3, :]
        if aim is not None:
            away = (aim - self.here(robot))[..., None]
            v = v - library(both).cross(away, both[..., 3:, :], axis=-2)
        return (robot.rotation(self.tip, self.to).mT @ v)[..., places(self.axes), :]

    def between(self, robot: At, aim, measured, model):
        return robot.rotation(self.tip, self.to)[:, places(self.axes)] @ (measured - model)


@record
class OwnOrientation(Orientation):
    """Components of a tip's rotation vector in the frame of the tip itself [rad].

    e = log(Rᵀ R_d), x = log R. Where all three are controlled it decays along a fixed axis of the tip, so that no turn
    of the target takes it along.
    """

    tied, whole, width = True, False, 3

    def of_target(self):
        return Orientation(axes="xyz")

    def error(self, robot: At, aim):
        return log_so3(self.here(robot).T @ aim)[places(self.axes)]

    def rows(self, robot: At, aim=None):
        angular = robot.rows(self.tip, self.to, (), (0, 1, 2))
        return (self.here(robot).mT @ angular)[..., places(self.axes), :]

    def spread(self, w):
        return w

    def motion(self, aim, rate):
        return spin(aim, rate)

    def velocity(self, robot: At, aim, motion):
        return (motion @ self.here(robot))[places(self.axes)]

    def mean(self, aim, before):
        return log_of_step(aim @ before.T), None

    def went(self, aim, before):
        return (aim - before).ravel() * 0.5**0.5

    def between(self, robot: At, aim, measured, model):
        own = turn_from(-measured, -model) if self.m == 3 else Orientation.spread(self, measured - model)
        return self.here(robot) @ own
