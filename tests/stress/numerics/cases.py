"""Random loops of every kind: a chain of 1 to 12 joints, a law, a method, a start and a target, from one number."""

import dataclasses

import numpy as np

import cnclik as ck
from cnclik.integrate.method import METHODS
from cnclik.problem.names import task_from
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Joint, assemble
from cnclik.robot.fixed import Offset

INVERSES = {
    "pseudoinverse": ck.pseudoinverse,
    "damped": lambda: ck.damped(0.05),
    "singular_damped": lambda: ck.singular_damped(0.05, 0.1),
}
LIMITS = {"none": None, "scaling": ck.velocity_scaling, "bounded": ck.bounded}
STAGES = {"picard": lambda: ck.picard(3), "chord": lambda: ck.chord(2), "newton": lambda: ck.newton(2)}
TASKS = ("xy", "xyz", "pose", "z", "rz", "xyrz", "orientation")
STARTS = ("random", "zero", "singular", "far")
TARGETS = ("near", "here", "out of reach", "far", "moving")
STEPS = (0, 1, 6)


@dataclasses.dataclass(frozen=True)
class Kind:
    """What is compiled in; loops of one kind differ in numbers only."""

    kinds: tuple  # of joints
    coordinates: tuple  # of joints: two that share one are a joint and its mimic
    task: str
    inverse: str
    limits: str
    method: str
    stage: str
    dtype: str
    N: int

    def __str__(self):
        joints = "".join(k[0] for k in self.kinds)
        words = (joints, self.task, self.inverse, self.limits, self.method, self.stage, self.dtype, f"N={self.N}")
        return " ".join(words)

    @property
    def n(self):
        return max(self.coordinates) + 1


def kind(seed) -> Kind:
    """The kind of a seed."""
    rng = np.random.default_rng([seed, 0])
    joints = int(rng.integers(1, 13))
    kinds = tuple(PRISMATIC if rng.random() < 0.2 else REVOLUTE for _ in range(joints))
    coordinates, count = [], 0
    for _ in range(joints):
        if count and rng.random() < 0.1:
            coordinates.append(int(rng.integers(count)))
        else:
            coordinates.append(count)
            count += 1
    one = lambda names: str(list(names)[rng.integers(len(names))])  # noqa: E731
    limits = one(LIMITS)
    return Kind(
        kinds=kinds,
        coordinates=tuple(coordinates),
        task=one(TASKS),
        inverse=one(INVERSES),
        limits=limits,
        method=one(METHODS),
        stage=one(STAGES),
        dtype=one(("float32", "float64", "float64")),
        N=int(rng.choice(STEPS, p=(0.1, 0.2, 0.7))),
    )


@dataclasses.dataclass(frozen=True)
class Loop:
    """One loop: arguments of `solve`."""

    law: ck.Law
    reference: ck.Reference
    q0: np.ndarray
    Ts: float
    about: str

    def solve(self, kind, q0=None, alpha=None):
        law = self.law if alpha is None else ck.replace(self.law, alpha=alpha)
        q0 = self.q0 if q0 is None else q0
        return ck.solve(law, self.reference, q0, self.Ts, kind.N, kind.method, STAGES[kind.stage]())


def loop(kind: Kind, seed) -> Loop | None:
    """A loop of a kind, from two numbers; None where a law refuses its chain, as a pseudoinverse does short ones."""
    rng = np.random.default_rng([*seed, 1])
    scale = 10.0 ** (rng.uniform(-6, 6) if rng.random() < 0.4 else rng.uniform(-1, 0.5))
    start = STARTS[rng.integers(len(STARTS))]
    target = TARGETS[rng.integers(len(TARGETS))]
    chain = _chain(kind, rng, scale)
    q = {
        "random": rng.uniform(-1.5, 1.5, chain.n),
        "zero": np.zeros(chain.n),
        "singular": np.where(np.arange(chain.n) == 0, 0.3, 0.0),
        "far": rng.uniform(-1, 1, chain.n) * 10.0 ** rng.uniform(2, 6),
    }[start]
    slides = [k == PRISMATIC for k in kind.kinds]
    first = {c: s for c, s in reversed(list(zip(kind.coordinates, slides, strict=True)))}
    q = np.array([v * (scale if first[i] else 1.0) for i, v in enumerate(q)])
    task = task_from(kind.task)
    tip = ck.forward(chain, np.clip(q, -1e3, 1e3) if start != "far" else q)
    away = {"near": 0.05, "here": 0.0, "out of reach": 30.0, "far": 1e6, "moving": 0.02}[target] * scale
    position = np.asarray(tip.position) + away * rng.uniform(-1, 1, 3)
    turn = _turn(rng, 0.3) @ np.asarray(tip.rotation) if task.orientation else None
    velocity = scale * 0.1 * rng.uniform(-1, 1, 3)
    try:
        if target == "moving":
            reference = ck.line(position, position + velocity, duration=1.0, rotation=turn)
        else:
            reference = ck.hold(position, turn)
        z = 10.0 ** rng.uniform(-3, 0.6)
        Ts = 10.0 ** rng.uniform(-4, 0)
        law = ck.Law(
            chain,
            task,
            alpha=z / Ts,
            inverse=INVERSES[kind.inverse](),
            limits=None if kind.limits == "none" else LIMITS[kind.limits](),
        )
    except ck.ArgumentError:
        return None
    about = f"lengths about {scale:.0e} m, start {start}, target {target}, z = {z:.2g}, Ts = {Ts:.1e} s"
    return Loop(law, reference, q.astype(kind.dtype), Ts, about)


def _chain(kind, rng, scale):
    """Of arrays: literals would make a program of their own for each arm."""
    joints = []
    for k, coordinate in zip(kind.kinds, kind.coordinates, strict=True):
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.7 else rng.normal(size=3)
        origin = Offset(position=tuple(scale * rng.uniform(-1, 1, 3)), rotation=tuple(map(tuple, _turn(rng, 2.0))))
        mimic = kind.coordinates.index(coordinate) < len(joints)
        joints.append(
            Joint(
                kind=k,
                axis=tuple(axis / np.linalg.norm(axis)),
                origin=origin,
                coordinate=coordinate,
                multiplier=np.float64(rng.uniform(-2, 2)) if mimic else 1.0,
                offset=np.float64(rng.uniform(-0.5, 0.5)) if mimic else 0.0,
            )
        )
    bounds = {}
    if kind.limits != "none":
        bounds = dict(lower=[-2.0] * kind.n, upper=[2.0] * kind.n, velocity_limit=[3.0] * kind.n)
    return assemble(joints, Offset(position=(0.0, 0.0, np.float64(scale))), **bounds)


def _turn(rng, most):
    """A rotation by up to `most` [rad]."""
    w = rng.normal(size=3)
    w *= rng.uniform(0, most) / np.linalg.norm(w)
    hat = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    u, _, v = np.linalg.svd(np.eye(3) + hat)
    return u @ v
