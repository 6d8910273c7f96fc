"""What must hold for every loop: numbers are finite or flagged, and every way to run it gives the same ones."""

import jax
import numpy as np

import cnclik as ck
from cnclik.integrate.status import Status, far
from tests.stress.numerics import cases

LOOPS = 32  # of a kind: they share their program
LANES = 5
TAME = Status.AT_LIMIT | Status.OVER_VELOCITY | Status.TASK_TOO_LARGE | Status.NOT_CONVERGED
# Of numbers that one and the same loop gives in two ways, relative to the loop's own: rounding, amplified by J#.
TOLERANCE = {"float64": 1e-7, "float32": 3e-2}
NUDGE, AMPLIFIED = 1e-3, 100.0  # [rad, m] at the start; and so many times as much later on: such a loop is chaotic
WAYS = ("vmap", "lanes", "as C", "plain", "gradient")


def way_of(seed) -> str:
    """How a kind is run once more."""
    return WAYS[seed % len(WAYS)]


def check(seed) -> tuple:
    """(what is wrong or None, the kind, loops run, those whose numbers were compared) of a seed."""
    kind = cases.kind(seed)
    made = [m for m in (cases.loop(kind, [seed, k]) for k in range(LOOPS)) if m is not None]
    wrong, compared = None, 0
    with jax.enable_x64(kind.dtype == "float64"):
        runs = [m.solve(kind) for m in made]
        for m, run in zip(made, runs, strict=True):
            wrong = wrong or _told(kind, m, run)
        way = way_of(seed)
        if made and wrong is None:
            wrong, compared = {"gradient": _gradient}.get(way, _same)(kind, made[0], runs[0], way)
    return wrong, kind, len(made), compared


def _told(kind, m, run):
    """What is not finite, or beyond meaning, has a status."""
    q, e, status = (np.asarray(v) for v in (run.q, run.e, run.status))
    if q.dtype != kind.dtype or q.shape != (kind.N + 1, kind.n) or status.shape != (kind.N,):
        return f"{m.about}: q is {q.dtype} {q.shape}"
    finite = np.isfinite(q[1:]).all(1) & np.isfinite(e[:-1]).all(1)
    flagged = (status & Status.NON_FINITE) != 0
    if (flagged & finite).any() and np.isfinite(q[1:].astype("float64").sum(1) + e[:-1].astype("float64").sum(1)).any():
        huge = np.abs(q[1:]).max(1) + np.abs(e[:-1]).max(1) > 1e30  # whose sum is not finite in float32
        if (flagged & finite & ~huge).any():
            return f"{m.about}: NON_FINITE where all is finite"
    if (~flagged & ~finite).any():
        return f"{m.about}: not finite and status {status[~flagged & ~finite][0]}"
    size = np.abs(q[1:].astype("float64")).sum(1)
    lost = finite & ~flagged & (size > 1.001 * far(q.dtype)) & ((status & Status.DIVERGED) == 0)
    if lost.any():
        return f"{m.about}: |q| = {size[lost][0]:.3g} without a word"
    explicit = kind.method in ("EE", "EXP-EE") and 10.0 * m.Ts <= 1  # of which these promise it
    if kind.limits == "bounded" and explicit and finite.all():
        speed, inside = (
            np.abs(np.asarray(run.qdot, float)),
            np.abs(q).max(0) <= np.maximum(2, np.abs(q[0])) * (1 + 1e-5),
        )
        if (speed > 3 * (1 + 1e-5)).any() or not inside.all():
            return f"{m.about}: beyond its limits: {speed.max():.6g} 1/s, {np.abs(q).max():.6g}"
    return None


def tame(run, nudged):
    """Whether a run is one whose numbers can be compared: neither near a singularity nor far off nor growing.

    Nor one that amplifies rounding: `nudged` is the same loop from a start `NUDGE` away.
    """
    status, q, other = np.asarray(run.status), np.asarray(run.q, float), np.asarray(nudged.q, float)
    well = np.isfinite(q).all() and not np.any(status & ~int(TAME)) and np.abs(q).max(initial=0) < 1e3
    return well and np.abs(other - q).max() <= AMPLIFIED * np.abs(other[0] - q[0]).max()


def _same(kind, m, run, way):
    """The same loop over several starts, one by one and in another way."""
    starts = m.q0 + (0.01 * np.arange(LANES)[:, None]).astype(kind.dtype) * (np.abs(m.q0) < 1e3)
    alone = [run, *(m.solve(kind, q0=q) for q in starts[1:])]
    regular = [
        tame(one, m.solve(kind, q0=(q + NUDGE).astype(kind.dtype))) for q, one in zip(starts, alone, strict=True)
    ]

    def end(q0):
        found = m.solve(kind, q0=q0)
        return found.q, found.e

    if way == "vmap":
        found = jax.vmap(end)(starts)
    elif way == "lanes":
        found = ck.lanes(end, tile=4, cores=1)(starts)
    elif way == "as C":
        with ck.use_engine("native"):
            found = jax.tree.map(lambda *v: np.stack(v), *map(jax.jit(end), starts))
    else:
        with ck.use_engine("plain"):
            found = jax.jit(jax.vmap(end))(starts)
    for k, one in enumerate(alone):
        if not regular[k]:
            continue
        for name, value in (("q", found[0][k]), ("e", found[1][k])):
            wanted, value = np.asarray(getattr(one, name), float), np.asarray(value, float)
            size = max(np.abs(wanted).max(initial=0), np.abs(np.asarray(one.q, float)).max(initial=0) * _length(m))
            size = size if name == "e" else max(1.0, np.abs(wanted).max(initial=0))
            rounding = 100 * np.finfo(kind.dtype).eps * (_length(m) if name == "e" else 1.0)
            if not np.abs(value - wanted).max(initial=0) <= TOLERANCE[kind.dtype] * size + rounding:
                return f"{m.about}: {way} differs in {name} by {np.abs(value - wanted).max():.3g} of {size:.3g}", k + 1
    return None, sum(regular)


def _length(m):
    """The arm's length [m], at least 1: what an error in a joint angle comes to at the tip."""
    origins = [np.linalg.norm(np.asarray(j.origin.position, float)) for j in m.law.chain.joints]
    return max(1.0, sum(origins) + np.linalg.norm(np.asarray(m.law.chain.tip.position, float)))


def _gradient(kind, m, run, way):
    """Derivatives are finite wherever values are."""
    if not (np.isfinite(np.asarray(run.q)).all() and np.isfinite(np.asarray(run.e)).all()):
        return None, 0
    size = float(np.abs(np.asarray(run.e, float)).max(initial=1e-300))
    growing = np.any(np.asarray(run.status) & int(Status.DIVERGED | Status.GROWING))
    if growing or (kind.dtype == "float32" and size > 1e3):
        return None, 0  # these grow beyond any bound

    def loss(q0, alpha):
        return (m.solve(kind, q0=q0, alpha=alpha).e[-1] ** 2).sum()

    found = jax.grad(loss, (0, 1))(jax.numpy.asarray(m.q0), jax.numpy.asarray(float(m.law.alpha), kind.dtype))
    well = all(np.isfinite(np.asarray(g)).all() for g in found)
    return None if well else f"{m.about}: gradients {found}", 1


def one(seed) -> tuple:
    """(seed, how it is checked, what is wrong or None, loops, compared): what a process of many is asked."""
    jax.config.update("jax_enable_x64", True)
    try:
        wrong, kind, loops, compared = check(seed)
    except Exception as error:  # the others go on
        wrong, kind, loops, compared = f"{type(error).__name__}: {str(error)[:300]}", cases.kind(seed), 0, 0
    return seed, way_of(seed), wrong and f"{kind}: {wrong}", loops, compared
