"""step and solve: the loop in time, checked and compiled; jit, vmap, jvp and grad go through all its numbers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.numbers import Numbers
from cnclik.integrate.drive import Drive, check_drive, sampled
from cnclik.integrate.loop import Step, advance, loop_of, run
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.law import Law
from cnclik.law.paths import A_REFERENCE, Reference
from cnclik.law.reference import REFERENCE, References, check
from cnclik.record import ArrayLike, Float, Number, cast
from cnclik.robot.model import modelled


def solve(
    law: Law,
    reference: Reference | References,
    q0: Float[ArrayLike, " n"],
    Ts: Number,
    N: int,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    *,
    t0: Number = 0.0,
    drive: Drive | None = None,
    noise: Float[ArrayLike, "N m"] | None = None,
) -> Trajectory:
    """Run the loop for N steps: closed-loop inverse kinematics as time stepping (Drexler 2016, Section IV).

    It runs in the dtype of q0 and returns arrays of q0's kind: read-only NumPy arrays, or JAX arrays. The first call of
    a kind compiles its program, which takes about a second; calls with other numbers, of any Python or NumPy type,
    reuse it; another N is a program of its own.

    Args:
      law: the right-hand side f(q, t), see `Law`.
      reference: the desired path, such as hold(...), line(...), circle(...).
      q0: (n,) joint values at t0 [rad, m].
      Ts: sampling time [s], positive.
      N: number of steps, a Python integer.
      method: default: EXP-MIDPOINT; one of `METHODS`, by name, or your own `Method`.
      stage: how implicit stages are solved, picard(M), chord(M) or newton(M); explicit methods ignore it.
      t0: time at q0 [s], counted from the start of the motion: in float32 the time of day has no resolution of 1 ms.
      drive: model of the drives between command and motion, at rest at t0, see `Drive`; None: ideal.
      noise: (N, m) added to the measured error at each step [m, rad], such as rng.normal(0, 1e-3, (N, m)); None: none.
        `q`, `e` and `qdot` are the robot's own. No step is then marked GROWING, nor through a drive: errors grow and
        shrink by themselves.

    Returns: `Trajectory`. Nothing is raised during the run: check `status`, or pass the run to `require_ok`.
    Raises: ArgumentError for shapes, types and concrete values that do not fit.
    """
    q0, method = check_arguments(law, reference, q0, Ts, method, stage)
    N = errors.integer("N", N, at_least=0, at_most=errors.MOST)
    errors.number("t0", t0)
    check_time("t0", t0, Ts, q0.dtype, N)
    if noise is not None:
        noise = errors.array("noise", noise, (N, law.task.m))
    if drive is not None:
        drive = None if check_drive(drive, law.chain).prompt else drive
    model = None if drive is None else sampled(drive, Ts)  # in NumPy if Ts is known
    known, given = (law, reference, stage, drive, method), (q0, _number(Ts, q0), _number(t0, q0), model, noise)
    return a_run(known, given, N=N)  # by the engine that `cnclik.engine.plan.chosen` has chosen


def step(
    law: Law,
    reference: Reference | References,
    q: Float[ArrayLike, " n"],
    t: Number,
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
) -> Step:
    """Make one step, for use in your own control loop: from q(t) to q(t + Ts).

    Call it once before the loop starts: the first call compiles, for about a second.

    Args and raises: as `solve`, with q (n,) and t [s] in place of q0 and t0.
    Returns: `Step` with q (n,) after the step, qdot (n,) to send to the robot, e (m,) before the step.
    """
    q, method = check_arguments(law, reference, q, Ts, method, stage, name="q")
    errors.number("t", t)
    check_time("t", t, Ts, q.dtype)
    known, given = (law, reference, stage, method), (q, _number(t, q), _number(Ts, q))
    return a_step(known, given)  # by the engine that `cnclik.engine.plan.chosen` has chosen


def _number(value, q):
    """Return a known number in the dtype of the joint values, so that one program serves all number types."""
    return q.dtype.type(value) if errors.concrete(value) else value


def check_arguments(law, reference, q, Ts, method, stage, name="q0"):
    """Return q as an array (n,), and the `Method`. Raises: ArgumentError if a loop's arguments do not fit."""
    errors.kind("law", law, Law)
    method = named(method)
    errors.kind("reference", reference, REFERENCE, A_REFERENCE)
    if isinstance(stage, type) or not hasattr(stage, "tolerance"):
        raise errors.fail("stage", "be a stage such as picard(5)", f"is {stage!r}")
    errors.number("Ts", Ts, positive=True)
    q = errors.array(name, q, (law.chain.n,), of="joint values")
    if isinstance(q, np.ndarray):
        wide = q.dtype.itemsize >= 8 and jax.config.jax_enable_x64
        q = q.astype(np.float64 if wide else np.float32, copy=False)  # from any precision and byte order
    return q, method


def check_time(name, t, Ts, dtype, N: int = 1) -> None:
    """Raise ArgumentError if the dtype of a run cannot resolve a step at its times t … t + N·Ts.

    With t from time.time() in float32, whose spacing is 128 s there, every step would see the same target.
    """
    if not (errors.concrete(t) and errors.concrete(Ts)):
        return
    t, Ts = float(t), float(Ts)
    last = abs(t) + N * Ts
    if last < 4e6 * Ts:  # float32 has as many numbers up to there
        return
    with np.errstate(over="ignore", invalid="ignore"):  # times beyond the dtype's range become inf
        gap = float(np.nan_to_num(np.spacing(dtype.type(last)), nan=np.inf))
    if gap > Ts:
        must, value = "be counted from the start of the motion", f"{t:.12g} s"
        name, must, value = (name, must, value) if abs(t) > N * Ts else ("N", "be smaller", N)
        must += ", or the loop run in float64 (x64 enabled, q in float64)"
        raise errors.fail(name, must, f"is {value}: {dtype} times are {gap:.3g} s apart there, and Ts is {Ts:g} s")


def whole_run(law, reference, stage, drive, method, q0, Ts, t0, model, noise, *, N):
    """Compute `solve`. Pure."""
    return run(loop_of(law, reference, q0, Ts, N, method, stage, t0=t0, drive=drive, model=model, noise=noise), q0)


a_run = Numbers(whole_run)


def one_step(law, reference, stage, method, q, t, Ts) -> Step:
    """Make the step of `step`. Pure."""
    check(reference, law.task)
    law, reference = cast((modelled(law), reference), q.dtype)
    return advance(law, reference, q, jnp.asarray(t, q.dtype), jnp.asarray(Ts, q.dtype), method, stage)


a_step = Numbers(one_step)
