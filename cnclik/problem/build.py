"""Problem: records made from the plain names and values of command line, sweep files and Python."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import Method, named
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import Stage
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.inverse import Pseudoinverse
from cnclik.law.law import Law
from cnclik.law.paths import causal
from cnclik.law.reference import Reference, References, of_each
from cnclik.problem import names
from cnclik.problem import stack as stacks
from cnclik.problem.magnitudes import check_units
from cnclik.problem.options import DEFAULTS, DRIVE, PATH, SWEPT, in_own_units
from cnclik.problem.reference import as_written, on_path, reference_from
from cnclik.problem.words import BEGINS, FUTURES
from cnclik.record import AnyArray, Float, Number
from cnclik.robot.chain import Chain

LONGEST = 1e12  # [s], longest run; products of far longer times exceed the range of floats
_OF_LAW = ("error_clamp", "feedforward", "near_singular")  # passed to the law unchanged


@dataclasses.dataclass(frozen=True, kw_only=True)
class Problem:
    """A loop, `solve(*p.loop)`, with the robot's name, drives and noise; `run()` uses all of it.

    `drive` is None if no such option was given. `noise`, a number or (m,), is the standard deviation of the
    measured error, or None; `seed` is the seed of random numbers. `tip` is the name of the robot's tip. `tables` are
    the given tables of a stack's tasks, and `walls` those of its walls.
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
    tip: str = ""
    tables: Mapping[str, Mapping[str, Any]] | None = None
    walls: Mapping[str, Mapping[str, Any]] | None = None

    def __repr__(self) -> str:
        return f"Problem({self.name!r}, Ts={self.Ts:g}, N={self.N}, method={str(self.method)!r})\n  {self.law!r}"

    @property
    def loop(self) -> tuple:
        """(law, reference, q0, Ts, N, method, stage), as `solve` takes them."""
        return self.law, self.reference, self.q0, self.Ts, self.N, self.method, self.stage

    def run(self, draws: Float[AnyArray, "N m"] | None = None) -> Trajectory:
        """Run the loop on its robot: with its drives and noise.

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
    tasks: Mapping[str, Mapping[str, Any]] | None = None,
    walls: Mapping[str, Mapping[str, Any]] | None = None,
    **options: Any,
) -> Problem:
    """A whole problem from a flat table of names and numbers, such as the `[fixed]` table of a sweep file.

    Args:
      robot: a file or a name, as for `cnclik.load`, or a `Chain`.
      tasks: for a stack {name of a task: {option: value}}, with options of `cnclik.problem.OF_TASK`, like the tables in
        the file that `stack` names.
      walls: for a stack {name of a wall: {option: value}}, with options of `cnclik.problem.OF_WALL`.
      options: names and values of `cnclik.problem.OPTIONS` and `cnclik.problem.MEASURED`, which
        have their meaning and default; None is the default. In Python `start` and `end` stand for `from` and `to`. A
        method or a stage may be the record itself. Numbers may be traced.

    Raises: ArgumentError naming the entry that does not fit.
    """
    given = as_written({name: value for name, value in options.items() if value is not None})
    for key in given:
        errors.one_of("option", key, SWEPT)
    asked = None if tasks is None else stacks.Written(tasks, walls or {})
    if "stack" in given:
        if tasks is not None:
            raise errors.fail("tasks", "be left out where `stack` is given", "is given")
        asked = stacks.read_stack(given["stack"])
    if walls and (asked is None or "stack" in given):
        raise errors.fail("walls", "come with `tasks`, or stand in the file of `stack`", "is given")
    given, written = in_own_units(given)
    v = dict.fromkeys(SWEPT) | DEFAULTS | given
    if "M" in given and hasattr(v["stage"], "tolerance"):
        raise errors.fail("M", "be left out where `stage` has it", f"is {given['M']!r}")
    Ts = errors.number("Ts", v["Ts"], positive=True)
    N = errors.integer("N", v["N"], at_least=1, at_most=errors.MOST)
    if errors.concrete(Ts) and float(Ts) > LONGEST / N:
        raise errors.fail("Ts", f"make a run of at most {LONGEST:g} s", f"is {float(Ts):g}, with N = {N}")
    stack, tips = (None, None) if asked is None else (stacks.tables_from(asked, given), stacks.tips_of(asked))
    chain, tip = names.robot_and_tip(robot, v["tip"], v["base"], v["lengths"], tips)
    task = names.task_from(v["task"], chain) if stack is None else stacks.stack_from(stack.tasks, chain)
    check_units(chain, task, written)
    law = _law(chain, task, v, Ts, stack)
    q0 = names.start_from(chain, task, v["q0"])
    begin = errors.one_of("begin", v["begin"], BEGINS)
    unknown = errors.one_of("future", v["future"], FUTURES) == "unknown"
    if stack is None:
        path = {name: v[name] for name in PATH}
        reference = reference_from(v["reference"], chain, task, q0, horizon=N * Ts, **path)
    else:
        reference = stacks.references_of(stack.tasks, chain, task, q0, N * Ts)
    q0 = on_path(chain, task, reference, q0) if begin == "on-path" else q0
    return Problem(
        name=names.robot_name(robot, v["tip"]),
        tip=tip,
        law=law,
        reference=of_each(lambda one, _: causal(one), reference, task) if unknown else reference,
        q0=q0,
        Ts=Ts,
        N=N,
        method=named(v["method"]),
        stage=names.stage_from(v["stage"], v["M"]),
        drive=drive_from(given, chain),
        noise=_noise(v["noise"], task.m),
        seed=errors.seed(given.get("seed", 0)),
        **{} if stack is None else {"tables": _as_given(stack.tasks), "walls": _as_given(stack.walls) or None},
    )


def _as_given(tables) -> dict:
    return {name: one.given for name, one in tables.items()}


def _law(chain, task, v, Ts, stack) -> Law:
    walls: tuple = ()
    damping = {name: v[name] for name in ("inverse", "damping", "threshold")}
    if stack is None:
        alpha, inverse = names.gain_from(v["alpha"]), names.inverse_from(*damping.values())
        if task.m > chain.n and isinstance(inverse, Pseudoinverse):
            names.require_free(chain, task)
    else:
        alpha = stacks.gains_from(stack.tasks, task, v["alpha"])
        inverse = stacks.inverse_of(stack.tasks, task, chain, **damping)
        walls = stacks.walls_from(stack.walls, chain)
    return Law(
        chain,
        task,
        alpha=alpha,
        inverse=inverse,
        limits=names.limits_from(v["limits"], Ts, v["limit_rate"], walls),
        null_velocity=names.null_from(chain, v["posture"], v["posture_rate"]),
        **{name: v[name] for name in _OF_LAW if v[name] is not None},
    )


def drive_from(given, chain=None) -> Drive | None:
    """Return the drive of a table of options; None if it has none of them."""
    made = _per_joint(chain, given, DRIVE)
    if "damping_ratio" in made and "natural_frequency" not in made:
        raise errors.fail("damping_ratio", "come with `natural_frequency`", "comes without")
    return Drive(**made) if made else None


def _noise(sigma, m):
    """The standard deviation of the measured error, checked; an array."""
    if sigma is None:
        return None
    sigma = errors.array("noise", sigma, (), (1,), (m,))
    if errors.concrete(sigma) and (sigma < 0).any():
        raise errors.fail("noise", "be at least 0", f"is {sigma.min():g}")
    return sigma


def _per_joint(chain, given, names) -> dict:
    """The given ones of these options. Several numbers are one per joint; a list of one is a number."""
    made = {name: given[name] for name in names if name in given}
    for name, value in made.items():
        if isinstance(value, (tuple, list)):
            shape = (None if chain is None else chain.n,)
            made[name] = value[0] if len(value) == 1 else errors.array(name, value, shape)
    return made
