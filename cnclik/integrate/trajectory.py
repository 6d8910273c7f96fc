"""Trajectory: the motion of a loop, instant by instant."""

from __future__ import annotations

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.status import counted
from cnclik.record import Array, Float, Int, record, replace


@record
class Trajectory:
    """A loop in time: N steps between N + 1 instants t[k] = t0 + k·Ts.

    Attributes:
      t: (N + 1,) [s].
      q: (N + 1, n) joint values [rad, m].
      x: (N + 1, m) task coordinates [m, rad].
      e: (N + 1, m) error, x_d − x (rotations: remaining rotation vector) [m, rad].
      qdot: (N, n) constant joint velocity during step k, (q[k+1] − q[k])/Ts [rad/s, m/s]; for a free base the twist
        that leads from one to the other.
      residual: (N,) last change of the implicit stage, as a joint displacement; 0 for explicit methods.
      contraction: (N,) ratio of the last two changes; at 1 or more the iteration diverges.
      status: (N,) bits of `Status`.
      evaluations: number of evaluations of f(q, t) in the whole run, each with a Jacobian and an inverse.
      tasks: for a stack: (name, first, last + 1) of the coordinates of its tasks; `run["hands"]` is the run of one
        task.
      walls: (N, k) margin of the approach velocity at each wall of `bounded`, ∇h·q̇ + rate·h [m/s, rad/s]: 0 where the
        wall is active, negative where it is not kept because walls contradict each other or the bounds; None without
        walls.
    """

    t: Float[Array, "*lanes N+1"]
    q: Float[Array, "*lanes N+1 n"]
    x: Float[Array, "*lanes N+1 m"]
    e: Float[Array, "*lanes N+1 m"]
    qdot: Float[Array, "*lanes N n"]
    residual: Float[Array, "*lanes N"]
    contraction: Float[Array, "*lanes N"]
    status: Int[Array, "*lanes N"]
    evaluations: Int[Array, "*lanes"]
    tasks: tuple[tuple[str, int, int], ...] = ()
    walls: Float[Array, "*lanes N k"] | None = None

    def __getitem__(self, name: str) -> Trajectory:
        """The run of one task of a stack: its x and e; all else is of the whole run."""
        columns = {task: slice(first, last) for task, first, last in self.tasks}
        if not columns:
            raise errors.fail("name", "be left out: the run is of no stack, see ck.stack", f"is {name!r}")
        own = columns[errors.one_of("name", name, columns)]
        return replace(self, x=self.x[..., own], e=self.e[..., own], tasks=())

    def __repr__(self):
        *lanes, N = np.shape(self.status)
        of = f"{' × '.join(map(str, lanes))} lanes, each of " if lanes else ""
        lines = [f"Trajectory: {of}{N} steps, {np.shape(self.q)[-1]} joints, {np.shape(self.e)[-1]} task coordinates"]
        if not all(errors.concrete(v) and isinstance(v, (np.ndarray, jax.Array)) for v in jax.tree.leaves(self)):
            return lines[0]
        lines[0] += f", {self.e.dtype}"
        for name, a, b in (("", 0, np.shape(self.e)[-1]), *self.tasks):
            if (size := np.linalg.norm(self.e[..., a:b], axis=-1)).size:
                first, last, most = (f"{part.max():.4g}" for part in (size[..., 0], size[..., -1], size))
                lines.append(f"  {name}{': ' * bool(name)}‖e‖ {first} at first, {last} at last, at most {most}")
        lines.append(f"  status: {counted(self.status)}")
        return "\n".join(lines)


def check_run(run, law=None, *, lanes=True) -> None:
    """Raise ArgumentError unless it is a run of this law's robot and task; or several, if it may have lanes."""
    axes = np.ndim(errors.kind("run", run, Trajectory).residual) - 1
    if axes and not lanes:
        raise errors.fail("run", "be one lane", f"has {axes} leading axes")
    found = *np.shape(run.q)[-1:], *np.shape(run.e)[-1:]
    if law is not None and found != (wanted := (law.chain.n, law.task.m)):
        must = f"be a Trajectory of this law, of {wanted[0]} joints and {wanted[1]} task coordinates"
        raise errors.fail("run", must, f"is of {' and '.join(map(str, found))}")
