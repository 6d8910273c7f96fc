"""Problem: a loop from names and numbers, as command line, sweep files and Python have them."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive, drive_in_words
from cnclik.integrate.method import MethodLike, named
from cnclik.integrate.solve import solve
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.bounded import bounded
from cnclik.law.inverse import damped, pseudoinverse, singular_damped
from cnclik.law.law import Law, check_loop
from cnclik.law.limits import velocity_scaling
from cnclik.law.paths import Reference, causal
from cnclik.law.reference import References, aims_of, hold_at
from cnclik.problem import names
from cnclik.problem import reference as paths
from cnclik.problem.options import DEFAULTS, OPTIONS, check_units, drive_from, in_own_units
from cnclik.record import AnyArray, ArrayLike, Float, Number, in_words, xp_for
from cnclik.robot.chain import Chain
from cnclik.robot.poses import quaternions

Point = Float[ArrayLike, " d"]  # position in the task's coordinates or x y z [m], perhaps with a quaternion


@dataclasses.dataclass(frozen=True, kw_only=True)
class Problem:
    """A loop, `solve(*p.loop)`, with its drive and noise; `run()` uses all of it.

    Attributes:
      law, reference, q0: the loop. A reference of None stays where q0 is, and q0 of None is a posture away from
        singularities.
      Ts, N, method, stage: as for `solve`; method and stage also by name.
      drive: `Drive`, or None: ideal.
      noise: standard deviation of the measured error, a number or (m,), or None. seed: of its random numbers.
      name: in titles. robot: its file, with the meshes that the viewer shows.

    Raises: ArgumentError naming the attribute that does not fit.
    """

    law: Law
    reference: Reference | References = None  # type: ignore[assignment]  # given after the constructor, as all below
    q0: Float[AnyArray, " n"] = None  # type: ignore[assignment]
    Ts: Number = 0.01
    N: int = 1000
    method: Any = "EXP-MIDPOINT"
    stage: Any = "picard"
    drive: Drive | None = None
    noise: Any = None
    seed: int = 0
    name: str = "problem"
    robot: str | None = None

    def __post_init__(self):
        law = errors.kind("law", self.law, Law)
        q0 = names.start_from(law.chain, law.task, self.q0)
        reference = hold_at(law.chain, law.task, q0) if self.reference is None else self.reference
        check_loop(law, reference)
        noise = None if self.noise is None else errors.array("noise", self.noise, (), (law.task.m,))
        if noise is not None and errors.concrete(noise) and not np.all(noise >= 0):
            raise errors.fail("noise", "be at least 0", f"is {np.asarray(noise).tolist()}")
        whole = errors.integer if errors.concrete(self.seed) else errors.number
        checked = {
            **{"q0": q0, "reference": reference, "noise": noise, "seed": whole("seed", self.seed, at_least=0)},
            "Ts": errors.number("Ts", self.Ts, positive=True),
            "N": errors.integer("N", self.N, at_least=1, at_most=errors.MOST),
            **{"method": named(self.method), "stage": names.stage_from(self.stage)},
            "drive": None if self.drive is None else check_drive(self.drive, law.chain),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __str__(self) -> str:
        """Robot and task, law and loop, start and target."""
        law, task, chain = self.law, self.law.task, self.law.chain
        stage, drive = f" by {self.stage}" * self.method.implicit, drive_in_words(self.drive or Drive(), float(self.Ts))
        distinct = list(dict.fromkeys(np.ravel(law.alpha).tolist()))
        alpha = in_words(distinct if len(distinct) > 1 else distinct[0])
        beyond = np.array(chain.joint_names)[(self.q0 < np.array(chain.lower)) | (self.q0 > np.array(chain.upper))]
        outside = f", beyond the limits of {', '.join(beyond)} (degrees are written with deg)" * (len(beyond) > 0)
        lines = [
            f"{self.name}, {str(task)[6:]}; N = {self.N} steps of Ts = {1e3 * self.Ts:g} ms",
            f"{self.method}{stage}, {type(law.inverse).__name__.lower()}, alpha = {alpha} 1/s, {drive}",
            f"Start: q0 = {in_words(self.q0)} {', '.join(dict.fromkeys(chain.units))}{outside}",
        ]
        if isinstance(self.reference, Reference):
            points = []
            for part, aim in zip(task.parts, jax.jit(aims_of)(self.reference, task, 0.0), strict=True):
                turns = getattr(part, "turns", False)
                unit = "as w x y z" if turns else ", ".join(dict.fromkeys(part.units))
                points.append(f"{in_words(quaternions(np.array(aim)) if turns else aim)} {unit}")
            lines.append(f"{'Target' if self.reference.still else 'Path from'} {', '.join(points)}")
        return "\n".join(lines)

    @property
    def loop(self) -> tuple:
        """(law, reference, q0, Ts, N, method, stage), as `solve` takes them."""
        return self.law, self.reference, self.q0, self.Ts, self.N, self.method, self.stage

    def run(self, draws: Float[AnyArray, "N m"] | None = None) -> Trajectory:
        """Run the loop on its robot: with its drive and noise.

        Args: draws: standard normal numbers, of which noise is made; by default those of the seed.
        """
        noise = self.noise
        if noise is not None:
            size = self.N, self.law.task.m
            noise = noise * (np.random.default_rng(int(self.seed)).standard_normal(size) if draws is None else draws)
        return solve(*self.loop, drive=self.drive, noise=noise)


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
      task: pose, position, orientation, or coordinates such as xy or xyrz; default: pose where there are the joints.
      q0: joint values at the start [rad, m]; default: within the limits and away from singularities.
      reference: the target's path: hold, line, circle, lissajous, or FILE.csv with waypoints: time, x, y, z and perhaps
        qw, qx, qy, qz, in this order or by these names.
      target: hold and line: the target, or the end of the line [m]; for a pose perhaps a quaternion w x y z after it.
      start: line: where it begins [m], as the target; default: where the tip is at q0.
      radius: circle: radius [m], positive; default: a tenth of the arm's length.
      amplitude: lissajous: amplitude [m], one number or one per axis; default: a twentieth of the arm's length.
      frequency: lissajous: cycles per period, one per axis; default: 1, 2, 3.
      phase: circle and lissajous: angle at t = 0 [rad]; lissajous takes one per axis.
      period: duration of a turn (negative: the other sense) or of the line [s], other than 0; default: that of the run.
      speed: tip speed [m/s], positive: along the waypoints of a file, in place of their times.
      begin: where the loop starts: at q0, or on-path, with the joint values nearest to q0.
      future: whether the controller knows the path ahead, or at each step the target's position and velocity alone.
      alpha: gain [1/s], at least 0: one number or one per task coordinate.
      damping: damping λ (not λ²) of the inverse of the Jacobian [m, 1], positive; default: none, the pseudoinverse.
      threshold: least singular value of the Jacobian [m, 1], positive, below which alone the inverse is damped.
      limits: how joint limits are respected: velocity_scaling or bounded (also positions); default: not at all.
      feedforward: factor of the target's velocity: 1 is full feed-forward, 0 pure feedback.
      error_clamp: largest position and orientation error that the gain multiplies [m, rad], positive.
      method: how a step is integrated: EE, IE, CN (the paper's), TRAPEZOID, HEUN, MIDPOINT, RK4, EXP-EE, EXP-HEUN,
        EXP-MIDPOINT, EXP-RK4.
      stage: iteration that solves an implicit step: picard, chord, newton.
      M: number of iterations per implicit step, at least 0.
      Ts: sampling time [s], positive; with a unit as in 4ms.
      N: number of steps.
      noise: standard deviation of white noise in the measured error [m, rad], at least 0: one or one per coordinate.
      seed: seed of the random numbers, at least 0.
      drive: fields of `Drive`.

    Raises: ArgumentError naming the entry that does not fit.
    """
    given = {name: value for name, value in locals().items() if name not in ("robot", "drive")} | drive
    for name in drive:
        errors.one_of("option", name, OPTIONS)
    v = in_own_units({name: DEFAULTS.get(name) if value is None else value for name, value in given.items()})
    for name in ("begin", "future", "limits"):
        if v[name] is not None:
            errors.one_of(name, v[name], OPTIONS[name].choices)
    Ts, N = errors.number("Ts", v["Ts"], positive=True), errors.integer("N", v["N"], at_least=1, at_most=errors.MOST)
    chain, own_tip = (robot, tip) if isinstance(robot, Chain) else (names.load(robot, tip), None)
    parts = names.task_from(v["task"], chain, own_tip)
    check_units("q0", v["q0"], chain)
    law = _law(chain, parts, v, Ts)
    with contextlib.nullcontext() if xp_for(v) is np else jax.ensure_compile_time_eval():
        q0 = names.start_from(chain, parts, v["q0"])  # once for all loops of a sweep that share it
        options = {k: v[k] for k in paths.OPTIONS}
        path = paths.reference_from(v["reference"], chain, parts, q0, horizon=N * Ts, **options)
        if v["begin"] == "on-path":
            q0 = paths.on_path(chain, parts, path, q0)
    return Problem(
        law=law,
        reference=causal(path) if v["future"] == "unknown" else path,
        q0=q0,
        stage=names.stage_from(v["stage"], v["M"]),
        drive=drive_from({name: v[name] for name in drive}),
        name=names.robot_name(robot, tip),
        robot=None if isinstance(robot, Chain) or names.is_built_in(robot) else str(robot),
        **{name: v[name] for name in ("Ts", "N", "method", "noise", "seed")},
    )


def _law(chain, task, v, Ts) -> Law:
    damping, threshold, limits = (v[name] for name in ("damping", "threshold", "limits"))
    if damping is None and (threshold is not None or limits == "bounded"):
        name = "limits" if threshold is None else "threshold"
        raise errors.fail(name, "come with `damping`, such as 0.05", "comes without")
    inverse = pseudoinverse() if damping is None else damped(damping)
    # At most the rate at which one step can stop a joint at its limit.
    rate = min(10.0, 1.0 / float(Ts)) if errors.concrete(Ts) else jnp.minimum(10.0, 1.0 / Ts)
    return Law(
        chain,
        task,
        alpha=v["alpha"],
        inverse=inverse if threshold is None else singular_damped(damping, threshold),
        limits=None if limits is None else bounded(rate) if limits == "bounded" else velocity_scaling(),
        feedforward=v["feedforward"],
        error_clamp=v["error_clamp"],
    )
