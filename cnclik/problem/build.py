"""Problem: a loop from names and numbers, as command line, sweep files and Python have them."""

from __future__ import annotations

import dataclasses
import os
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive, drive_in_words
from cnclik.integrate.method import Method, MethodLike, named
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import Stage
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.bounded import bounded
from cnclik.law.inverse import damped, pseudoinverse, singular_damped
from cnclik.law.law import Law, posture
from cnclik.law.limits import velocity_scaling
from cnclik.law.paths import causal
from cnclik.law.reference import Reference, References, aims_of
from cnclik.problem import names
from cnclik.problem import reference as paths
from cnclik.problem.options import DEFAULTS, OPTIONS, check_units, in_own_units
from cnclik.record import AnyArray, ArrayLike, Float, Number, in_words
from cnclik.robot.chain import Chain
from cnclik.robot.poses import quaternions

Point = Float[ArrayLike, " d"]  # position in the task's coordinates or x y z [m], perhaps with a quaternion


@dataclasses.dataclass(frozen=True, kw_only=True)
class Problem:
    """A loop, `solve(*p.loop)`, with its drive and noise; `run()` uses all of it.

    `drive` is None if no such option was given. `noise`, a number or (m,), is the standard deviation of the measured
    error, or None; `seed` is the seed of random numbers. `robot` is the robot's file, with the meshes that the viewer
    shows.
    """

    name: str
    law: Law
    reference: Reference | References
    q0: Float[AnyArray, " n"]
    Ts: Number
    N: int
    method: Method
    stage: Stage
    drive: Drive | None = None
    noise: AnyArray | None = None
    seed: int = 0
    robot: str | None = None

    def __str__(self) -> str:
        """Robot and task, law and loop, start and target."""
        law, task, drive = self.law, self.law.task, drive_in_words(self.drive or Drive(), float(self.Ts))
        stage = f" by {self.stage}" * self.method.implicit
        gains = (
            [f"{name} {law.alpha[part][0]:.5g}" for name, part in task.each]
            if np.ndim(law.alpha) and task.tasks
            else []
        )
        alpha = ", ".join(gains) or in_words(law.alpha)
        lines = [
            f"{self.name}, {str(task)[6:]}; N = {self.N} steps of Ts = {1e3 * self.Ts:g} ms",
            f"{self.method}{stage}, {type(law.inverse).__name__.lower()}, alpha = {alpha} 1/s, {drive}",
            f"Start: q0 = {in_words(self.q0)} {', '.join(dict.fromkeys(law.chain.units))}",
        ]
        if isinstance(self.reference, Reference):
            aims = zip(task.parts, aims_of(self.reference, task, 0.0), strict=True)
            each = [(part, quaternions(np.array(v)) if getattr(part, "turns", False) else v) for part, v in aims]
            points = (f"{in_words(v)} {'as w x y z' if np.size(v) == 4 else part.units[0]}" for part, v in each)
            path = "Target" if self.reference.still else f"Path {type(self.reference.curve).__name__.lower()}, from"
            lines.append(f"{path} {', '.join(points)}")
        return "\n".join(lines)

    @property
    def loop(self) -> tuple:
        """(law, reference, q0, Ts, N, method, stage), as `solve` takes them."""
        return self.law, self.reference, self.q0, self.Ts, self.N, self.method, self.stage

    def run(self, draws: Float[AnyArray, "N m"] | None = None) -> Trajectory:
        """Run the loop on its robot: with its drive and noise.

        Args: draws: standard normal numbers, of which noise is made; by default those of the seed.
        """
        return solve(*self.loop, drive=self.drive, noise=self.drawn(draws))

    def drawn(self, draws=None) -> Float[AnyArray, "N m"] | None:
        """Return the noise of the measured error; None without noise. Args: draws: as for `run`."""
        if self.noise is None:
            return None
        if draws is None:
            draws = np.random.default_rng(self.seed).standard_normal((self.N, self.law.task.m))
        return self.noise * draws


def problem_from(
    robot: str | os.PathLike | Chain,
    *,
    tip: str | None = None,
    task: str | None = None,
    q0: Float[ArrayLike, " n"] | None = None,
    reference: str = "hold",
    target: Point | None = None,
    start: Point | None = None,
    radius: Number | None = None,
    amplitude: Float[ArrayLike, " d"] | None = None,
    frequency: Float[ArrayLike, " d"] | None = None,
    phase: Float[ArrayLike, " d"] | None = None,
    period: Number | None = None,
    speed: Number | None = None,
    begin: Literal["q0", "on-path"] = "q0",
    future: Literal["known", "unknown"] = "known",
    alpha: ArrayLike = 5.0,
    damping: Number | None = None,
    threshold: Number | None = None,
    limits: Literal["velocity_scaling", "bounded"] | None = None,
    posture: Float[ArrayLike, " n"] | None = None,
    feedforward: Number = 1.0,
    error_clamp: ArrayLike | None = None,
    method: MethodLike = "EXP-MIDPOINT",
    stage: str = "picard",
    M: int = 5,
    Ts: Number = 0.01,
    N: int = 1000,
    noise: ArrayLike | None = None,
    seed: int = 0,
    **drive: Any,
) -> Problem:
    """Build a whole problem from names and numbers. None is the default; a text such as "34ms" has a unit.

    The command line and sweep files have the same names. In Python a method or a stage may be the record itself, and
    numbers may be traced.

    Args:
      robot: a URDF or MJCF file; panda; ur5; planar:1,1,1 (link lengths in m); or a name of robot_descriptions. For
        commands also FILE.py, whose function problem() returns law, reference and q0.
      tip: last link of the chain. Required where the file has several (`cnclik robots FILE` lists them).
      task: what to control: pose, position, orientation, or coordinates such as xy or xyrz. Default: pose where the
        robot has enough joints for it.
      q0: joint values at the start [rad, m]; default: a posture within the limits and away from singularities.
      reference: the target's path: hold, line, circle, lissajous, or FILE.csv with waypoints: time, x, y, z and perhaps
        qw, qx, qy, qz, in this order or by these names.
      target: hold and line: the target, or the end of the line [m]; for a pose, optionally a quaternion w x y z after
        it. Default: where the tip is after every joint has moved a little.
      start: line: where it begins [m], as the target; default: where the tip is at q0.
      radius: circle: radius [m], positive; default: a tenth of the arm's length.
      amplitude: lissajous: amplitude [m], one number or one per axis; default: a twentieth of the arm's length.
      frequency: lissajous: cycles per period, one per axis; default: 1, 2, 3.
      phase: circle and lissajous: angle at t = 0 [rad]; lissajous takes one per axis.
      period: duration of one turn (negative: opposite direction) or of the line [s], other than 0; default: that of the
        run.
      speed: tip speed [m/s], positive: along the waypoints of a file, in place of their times.
      begin: where the loop starts: at q0, or on-path, at the path's first point with the joint values nearest to q0.
      future: whether the controller knows the path ahead (known) or only the target's position and velocity at each
        step's start (unknown).
      alpha: gain [1/s], at least 0: one number or one per task coordinate. alpha·Ts is the dimensionless gain per step.
      damping: damping λ (not λ²) of the inverse of the Jacobian [m, 1], positive; default: none, the pseudoinverse.
      threshold: least singular value of the Jacobian [m, 1], positive, below which alone the inverse is damped.
      limits: how joint limits are respected: velocity_scaling or bounded (also their positions). Default: not at all.
      posture: preferred joint values, approached in the null space [rad, m].
      feedforward: factor of the target's velocity: 1 is full feed-forward, 0 pure feedback.
      error_clamp: limits of the position and orientation error that the gain multiplies [m, rad], positive. They keep
        joint velocities small when the target is far away.
      method: how a step is integrated: EE, IE, CN (the paper's), TRAPEZOID, HEUN, MIDPOINT, RK4, EXP-EE, EXP-HEUN,
        EXP-MIDPOINT, EXP-RK4.
      stage: iteration that solves an implicit step: picard, chord, newton.
      M: number of iterations per implicit step, at least 0.
      Ts: sampling time [s], positive; with a unit as in 4ms.
      N: number of steps.
      noise: standard deviation of white noise in the measured error [m, rad], at least 0: one number or one per task
        coordinate.
      seed: seed of the random numbers, at least 0.
      drive: fields of `Drive`.

    Raises: ArgumentError naming the entry that does not fit.
    """
    given = locals() | drive
    del given["robot"], given["drive"]
    for name in drive:
        errors.one_of("option", name, OPTIONS)
    v, written = in_own_units({name: DEFAULTS.get(name) if value is None else value for name, value in given.items()})
    for name in ("begin", "future", "limits"):
        if v[name] is not None:
            errors.one_of(name, v[name], OPTIONS[name].choices)
    Ts, N = errors.number("Ts", v["Ts"], positive=True), errors.integer("N", v["N"], at_least=1, at_most=errors.MOST)
    chain, own_tip = (robot, tip) if isinstance(robot, Chain) else (names.load(robot, tip), None)
    parts = names.task_from(v["task"], chain, own_tip)
    check_units(chain, written)
    law = _law(chain, parts, v, Ts)
    with jax.ensure_compile_time_eval():  # in a sweep, the start of a path that all loops share is searched for once
        q0 = names.start_from(chain, parts, v["q0"])
        options = {k: v[k] for k in paths.OPTIONS}
        path = paths.reference_from(v["reference"], chain, parts, q0, horizon=N * Ts, **options)
        if v["begin"] == "on-path":
            q0 = paths.on_path(chain, parts, path, q0)
    return Problem(
        name=names.robot_name(robot, tip),
        robot=None if isinstance(robot, Chain) else str(robot),
        law=law,
        reference=causal(path) if v["future"] == "unknown" else path,
        q0=q0,
        Ts=Ts,
        N=N,
        method=named(v["method"]),
        stage=names.stage_from(v["stage"], v["M"]),
        drive=drive_from({name: v[name] for name in drive}, chain),
        noise=None if v["noise"] is None else errors.array("noise", v["noise"], (), (parts.m,)),
        seed=errors.seed(v["seed"]),
    )


def _law(chain, task, v, Ts) -> Law:
    damping, threshold, rest = v["damping"], v["threshold"], v["posture"]
    for name, value in (("threshold", threshold), ("limits", v["limits"] == "bounded" or None)):
        if value is not None and damping is None:
            raise errors.fail(name, "come with `damping`, such as 0.05", "comes without")
    limits = velocity_scaling() if v["limits"] == "velocity_scaling" else None
    if v["limits"] == "bounded":  # at most the rate at which one step can stop a joint at its limit
        limits = bounded(min(10.0, 1.0 / float(Ts)) if errors.concrete(Ts) else jnp.minimum(10.0, 1.0 / Ts))
    regular = pseudoinverse() if damping is None else damped(damping)
    return Law(
        chain,
        task,
        alpha=v["alpha"],
        inverse=regular if threshold is None else singular_damped(damping, threshold),
        limits=limits,
        null_velocity=None if rest is None else posture(errors.array("posture", rest, (chain.n,), of="joint values")),
        feedforward=v["feedforward"],
        error_clamp=v["error_clamp"],
    )


def drive_from(given, chain=None) -> Drive | None:
    """Return the drive of a table of options, of which lists are one number per joint; None if it has none."""
    given = {name: v for name, v in given.items() if v is not None}
    lists = {name: errors.array(name, v, (None,)) for name, v in given.items() if isinstance(v, (tuple, list))}
    if not given:
        return None
    return Drive(**given | lists) if chain is None else check_drive(Drive(**given | lists), chain)
