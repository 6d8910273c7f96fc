"""The experiments of Drexler (2016), Section V, under every reading its text allows.

Three places of the text do not fix the algorithm; a `Reading` settles each. `reproduce` runs all eight on both arms and
both cases, and beside the paper's methods the textbook ones.
"""

import functools
import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.integrate.method import CN, METHODS, Method, evaluations_per_step, named
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import picard
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.law import Law, evaluate
from cnclik.law.paths import Reference, line
from cnclik.record import ArrayLike, Float, record, stack
from cnclik.robot.chain import planar_arm
from cnclik.robot.model import modelled
from cnclik.robot.rotations import safe_norm
from cnclik.task.build import position

# Settings of Section V.
TS, N, M, ALPHA = 0.1, 30, 5, 5.0  # [s], steps, Picard passes, gain [1/s]

PAPER = ("EE", "IE", "CN")
BESIDE = ("TRAPEZOID", "HEUN", "MIDPOINT", "RK4", "EXP-MIDPOINT")


class Reading(NamedTuple):
    """One way to read the paper where its text leaves a choice."""

    rotation: str  # on-path: positive angles turn clockwise, Case II starts on its path; printed: right-handed about +z
    Ts: str  # once: as eqs. 2-5 have it; twice: eq. 7 as printed multiplies by Ts what eq. 6 already did
    feedforward: str  # consistent: the path's own velocity −1/(N·Ts); printed: −1, as eqs. 16 and 19

    def __str__(self):
        return "/".join(self)


_CHOICES = itertools.product(("on-path", "printed"), ("once", "twice"), ("consistent", "printed"))
READINGS = {str(r): r for r in itertools.starmap(Reading, _CHOICES)}
DEFAULT = READINGS["on-path/once/consistent"]


class Arm(NamedTuple):
    """One of the paper's planar arms, links of 1 m; it starts from q = (0, π/2, 0, …)."""

    n: int
    target: tuple  # Case I: the point to reach [m]
    start: tuple  # Case II: where the path begins; it runs 1 m in −x [m]

    def __str__(self):
        return f"{self.n}-dof"


ARMS = {"2dof": Arm(2, (1.0, 0.0), (1.0, 1.0)), "5dof": Arm(5, (3.0, 1.0), (4.0, 1.0))}
CASES = ("reach", "track")  # Case I, Case II


# --- one experiment -----------------------------------------------------------------------------------


def law(arm: str, rotation: str = "on-path", joints: int = 0) -> Law:
    """Return the law of Section V: planar position with gain 5 1/s and the pseudoinverse.

    `joints`: how many the arm has at least. Those beyond its own turn links of no length, and stand still.
    """
    lengths = [1.0] * ARMS[arm].n + [0.0] * (joints - ARMS[arm].n)
    return Law(planar_arm(lengths, clockwise=rotation == "on-path"), position("xy"), alpha=ALPHA)


def start(arm: str, nudge: int = 0):
    """Return q at t = 0, (n,): (0, π/2, 0, …) [rad]. Args: nudge: number of the displaced start, 0 for this one."""
    q = np.zeros(ARMS[arm].n)
    q[1] = np.pi / 2
    return q + NUDGE * np.random.default_rng(0).standard_normal((NUDGES, len(q)))[nudge - 1] if nudge else q


@record
class WithVelocity:
    """A path with another feed-forward than its own velocity: its place has no derivative, the addend of 0 has."""

    path: Callable
    velocity: Float[ArrayLike, " m"]

    def __call__(self, t):
        position, rotation = lax.stop_gradient(self.path(t))
        return position + (t - lax.stop_gradient(t)) * self.velocity, rotation


def path(arm: str, case: str, feedforward: str = "consistent") -> Reference:
    """Return the path of a case: reach stays at the target (eqs. 14, 17), track runs 1 m in −x (15-16, 18-19)."""
    begin, length = (ARMS[arm].target, 0.0) if case == "reach" else (ARMS[arm].start, 1.0)
    speed = length / (N * TS) if feedforward == "consistent" else length
    straight = line(begin, (begin[0] - length, begin[1]), duration=N * TS)
    return Reference(curve=WithVelocity(path=straight.curve, velocity=np.array([-speed, 0.0])))


def tableau(method: Method, Ts: str = "once") -> Method:
    """Return the method, with the diagonal of an implicit tableau multiplied by the sampling time if Ts is "twice".

    Eq. 7 moves by Ts times an increment that holds a factor Ts already: θ̃ = θ + Ts·(Ts·slope). The slope is
    then taken at a·Ts = Ts² instead of Ts.
    """
    if Ts == "once" or not method.implicit:
        return method
    A = tuple((*row[:-1], row[-1] * TS) for row in method.A)
    return Method(name=method.name, A=A, b=method.b, c=method.c, order=1, source="Drexler (2016), eqs. 6-8 as printed")


def experiment(arm: str, case: str, method: Method | str = CN, reading=DEFAULT) -> Trajectory:
    """Run one experiment of Section V: `experiment("5dof", "track", "CN").e`.

    Args:
      arm: "2dof" or "5dof".
      case: "reach" (Case I) or "track" (Case II).
      method: any of `METHODS`, or its name.
      reading: how to read the text: one of `READINGS`, or its name.
    """
    arm, case = errors.one_of("arm", arm, ARMS), errors.one_of("case", case, CASES)
    method, reading = named(method), READINGS[errors.one_of("reading", str(reading), READINGS)]
    loop = law(arm, reading.rotation), path(arm, case, reading.feedforward), start(arm)
    return solve(*loop, TS, N, tableau(method, reading.Ts), picard(M))


# --- all of them --------------------------------------------------------------------------------------

HALVINGS = 4  # the sampling time goes down to TS/2^HALVINGS
CONVERGED = 25  # passes that solve an implicit stage of a tracking run far beyond the method's own error
PASSES = 40  # passes followed one by one for claim (c)
NUDGES, NUDGE = 6, 1e-12  # runs from starts displaced by so much [rad]: numbers that move with them are not determined
JOINTS = max(arm.n for arm in ARMS.values())  # one program for both arms takes as long to compile as one for the larger
UNDETERMINED = 1e-6  # mean errors that differ by more, relatively, between such runs are decided by rounding


class Lane(NamedTuple):
    """One run of an arm among those that a compiled program does side by side."""

    rotation: str
    case: str
    feedforward: str
    nudge: int = 0  # number of the displaced start, 0 for the paper's own
    halving: int = 0  # Ts = TS/2^halving
    M: int = M

    @property
    def N(self):
        return N * 2**self.halving


_PATHS = (("reach", "consistent"), ("track", "consistent"), ("track", "printed"))
_PAPER_LANES = [Lane(rotation, *p) for rotation in ("on-path", "printed") for p in _PATHS]
_NUDGED_LANES = [lane._replace(nudge=i) for lane in _PAPER_LANES for i in range(1, NUDGES + 1)]
_WORK_LANES = [Lane("on-path", case, "consistent", halving=h) for case in CASES for h in range(1, HALVINGS + 1)]
_ORDER_LANES = [Lane("on-path", "track", "consistent", halving=h, M=CONVERGED) for h in range(HALVINGS + 1)]
LANES = (*_PAPER_LANES, *_NUDGED_LANES, *_WORK_LANES, *_ORDER_LANES)

# What is run in each lane: (Ts once or twice, method).
METHOD_RUNS = (*(("once", name) for name in (*PAPER, *BESIDE)), ("twice", "IE"), ("twice", "CN"))
# Where the Picard iteration is followed: IE's stage is CN's second, the same iteration from the states of either.
FOLLOWED = ("IE", "CN")


@functools.partial(jax.jit, static_argnames=("method", "h", "N_max"))
def _program(laws, references, q0, Ts, M, *, method, h, N_max):
    """One method over all lanes, and the passes of the Picard iteration from the states of the first ones.

    `h` is where the next slope is taken, θ + h·slope; None where there are no passes to follow.
    """

    def lane(law, reference, q0, Ts, M):
        return solve(law, reference, q0, Ts, N_max, method, picard(M, maximum=CONVERGED))

    run = jax.vmap(lane)(laws, references, q0, Ts, M)
    if h is None:
        return run, None

    def passes(law, reference, q, t):
        law = modelled(law)

        def one(slope, _):
            new = evaluate(law, reference, t + TS, q + h * slope).qdot
            return new, TS * safe_norm(new - slope)

        first = evaluate(law, reference, t, q).qdot
        _, changes = jax.lax.scan(one, first, length=PASSES)
        return jnp.append(TS * safe_norm(first), changes)

    # Step by step over all lanes, not all at once: lanes of one shape share their compiled stages.
    states = jnp.swapaxes(run.q[:, :N], 0, 1), jnp.swapaxes(run.t[:, :N], 0, 1)
    found = jax.lax.map(lambda at: jax.vmap(passes)(laws, references, *at), states)
    return run, jnp.moveaxis(found, 0, -1)


def run_method(Ts: str, name: str) -> tuple[dict, dict]:
    """Run one method in all lanes on both arms, by one compiled program; `Ts` is "once" or "twice".

    Returns: {(arm, Ts, method, lane): value} of two values, the `Trajectory`, and where the iteration is followed
      (PASSES + 1, N): from the state before each step of a run, the change ‖Δθ⁽ⁱ⁾ − Δθ⁽ⁱ⁻¹⁾‖ of the joint increment
      (eq. 9) in the last of 0, 1, … passes [rad].
    """
    todo = [(arm, lane) for arm in ARMS for lane in LANES]
    laws = stack([law(arm, lane.rotation, JOINTS) for arm, lane in todo])
    paths = stack([path(arm, lane.case, lane.feedforward) for arm, lane in todo])
    q0 = np.stack([np.pad(start(arm, lane.nudge), (0, JOINTS - ARMS[arm].n)) for arm, lane in todo])
    Ts_of, passes = np.array([TS / 2**lane.halving for _, lane in todo]), np.array([lane.M for _, lane in todo])
    how = {"method": tableau(METHODS[name], Ts), "N_max": max(lane.N for lane in LANES)}
    how["h"] = (TS if Ts == "once" else TS * TS) if name in FOLLOWED else None
    run, residuals = jax.device_get(_program(laws, paths, q0, Ts_of, passes, **how))
    runs, changes = {}, {}
    for i, (arm, lane) in enumerate(todo):
        n, cost = ARMS[arm].n, lane.N * evaluations_per_step(METHODS[name], picard(lane.M), ARMS[arm].n)
        own: dict = {f: getattr(run, f)[i, : lane.N + 1] for f in ("t", "q", "x", "e")}  # its own steps and joints
        own |= {f: getattr(run, f)[i, : lane.N] for f in ("qdot", "residual", "contraction", "status")}
        own |= {"q": own["q"][:, :n], "qdot": own["qdot"][:, :n], "evaluations": np.asarray(cost)}
        runs[arm, Ts, name, lane] = Trajectory(**own)
        if residuals is not None and lane in _PAPER_LANES:
            changes[arm, Ts, name, lane] = residuals[i]
    return runs, changes
