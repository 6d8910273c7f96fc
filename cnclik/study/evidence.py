"""Evidence: studies that hold linear theory and implicit stages against whole nonlinear loops.

Each takes what its spec says (see results/stability/*.toml) and returns one labelled dataset.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.integrate import stage as stages
from cnclik.integrate.method import METHODS
from cnclik.integrate.solve import advance, cast, evaluations_per_step
from cnclik.record import replace
from cnclik.robot import spatial as sp
from cnclik.study import maps
from cnclik.study.linear import stability_limit
from cnclik.study.outcome import Kind
from cnclik.study.problem import length, problem_from, reference_from
from cnclik.study.spectrum import at_rest

_LIMITED = 1e3  # limits beyond this are shown as none


def _robots(names, tasks):
    """The loops by robot name: law with alpha 1, its resting place, the arm's length [m]."""
    for name, task in zip(names, tasks, strict=True):
        found = problem_from(name, task=task, alpha=1.0)
        yield name, found.law, found.q0, length(found.law.chain)


def _moves(law, size, count, seed):
    drawn = np.random.default_rng(seed).normal(size=(count, len(law.task.position)))
    return size * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def _cases(methods, picard, chord):
    """(label, method, stage kind or None, M or None) for each way to step."""
    for name in methods:
        method = METHODS[errors.one_of("methods", name, METHODS)]
        if not method.implicit:
            yield name, method, None, None
            continue
        for kind, some in (("picard", picard), ("chord", chord)):
            for M in some:
                yield f"{name} {kind}({M})", method, kind, M


def _stage(kind, M, maximum):
    """A stage whose passes are an array, so that every M shares one program."""
    return stages.picard(0) if kind is None else getattr(stages, kind)(jnp.asarray(M), maximum=maximum)


# --- agreement ----------------------------------------------------------------------------------------


def agreement_study(
    *, robots, tasks, methods, picard, chord, sizes, z, directions, N, band, tolerance=1e-3, seed=0, progress=None
):
    """Measured outcomes against the linear boundary, for growing initial errors.

    Args:
      robots, tasks: names as on the command line.
      methods: names; picard, chord: numbers of passes.
      sizes: initial errors in arm lengths.
      z: [low, high, count] in units of the linear limit; of 10 where there is none.
      directions: initial errors in this many random directions, the same for every method.
      N, tolerance: horizon and what counts as arrived. band: half width of the band left out, 0.03.
    Returns: Dataset over (robot, case, size): `agreement`, `diverged_inside` (share of loops inside the boundary,
      band left out, that are not stable), `stable_outside`; and `limit` (case).
    """
    import xarray as xr

    cases = list(_cases(methods, picard, chord))
    limits = [stability_limit(m, _stage(kind, M, max((*picard, *chord)))) for _, m, kind, M in cases]
    grid = np.linspace(z[0], z[1], int(z[2]))
    lanes = len(sizes) * directions * len(grid)
    total, done = len(robots) * len(cases) * lanes, 0
    found = np.full((3, len(robots), len(cases), len(sizes)), np.nan)
    for r, (_, law, rest, arm) in enumerate(_robots(robots, tasks)):
        target = at_rest(law, None, rest)
        moves = np.concatenate([_moves(law, s * arm, directions, seed) for s in sizes])
        q0 = maps.starts(law, rest, moves).reshape(len(sizes), directions, 1, -1)
        for c, (_, method, kind, M) in enumerate(cases):
            limit = limits[c]
            values = grid * (limit if np.isfinite(limit) else 10.0)
            made = maps.measure(
                law,
                target,
                q0,
                alpha=values,
                Ts=1.0,
                M=M,
                N=N,
                method=method,
                stage=_shared(kind, picard, chord),
                tolerance=tolerance,
            )
            for s in range(len(sizes)):
                inside, outside = values < limit * (1 - band), values > limit * (1 + band)
                good = maps.stable(made.kind[s])
                found[0, r, c, s] = maps.agreement(made.kind[s], values, limit, band=band)
                found[1, r, c, s] = 1 - good[:, inside].mean()
                found[2, r, c, s] = good[:, outside].mean() if outside.any() else 0.0
            done += lanes
            if progress is not None:
                progress(done, total)
    dims = ("robot", "case", "size")
    return xr.Dataset(
        {
            "agreement": (dims, found[0], {"units": "1", "long_name": "share of loops that theory foretells"}),
            "unstable_inside": (dims, found[1], {"units": "1"}),
            "stable_outside": (dims, found[2], {"units": "1"}),
            "limit": ("case", limits, {"units": "1", "long_name": "largest stable z by linear theory"}),
        },
        coords={
            "robot": list(robots),
            "case": [case[0] for case in cases],
            "size": ("size", np.asarray(sizes, float), {"units": "1", "long_name": "initial error / arm length"}),
        },
    )


def _shared(kind, picard, chord):
    """The stage that `measure` gives its passes to; the largest M of its kind fixes the program."""
    if kind is None:
        return stages.picard(0)
    return getattr(stages, kind)(max(picard if kind == "picard" else chord))


def _agreement_table(data):
    lines = [
        "# Measured loops against the linear boundary",
        "",
        "Share of loops [%] whose outcome is what z against the linear limit says, a band around the limit left out,",
        "by initial error in arm lengths. The worst robot of each row.",
        "",
        "| method | limit of z | " + " | ".join(f"{s:g}" for s in data["size"].values) + " |",
        "| --- | --- | " + " | ".join("---" for _ in data["size"].values) + " |",
    ]
    for case in data.case.values:
        worst = data.agreement.sel(case=case).min("robot").values
        limit = float(data.limit.sel(case=case))
        shown = f"{limit:.4f}" if limit < _LIMITED else "none"
        lines.append(f"| {case} | {shown} | " + " | ".join(f"{100 * w:.1f}" for w in worst) + " |")
    small = data.agreement.isel(size=0)
    lines += ["", f"At the smallest initial error: least agreement {100 * float(small.min()):.2f} %."]
    return "\n".join(lines) + "\n"


# --- implicit steps that pay ---------------------------------------------------------------------------


def implicit_study(
    *, robots, tasks, methods, picard, chord, sizes, z, directions, N, tolerance, track, seed=0, progress=None
):
    """Steps and evaluations to a tolerance against z, for every way to step; and tracking at equal cost.

    Args:
      robots, tasks, methods, picard, chord, directions, N: as for `agreement_study`.
      sizes: initial errors in arm lengths.
      z: [low, high, count], spaced geometrically.
      tolerance: error to be reached [m, rad].
      track: {"turns": [s per turn], "evaluations": evaluations of f per turn, "z": [...]}, a circle.
    Returns: Dataset over (robot, case, z): `steps` (median over starts, NaN unless all arrive), `arrived`,
      `evaluations`; and over (robot, case): `rms`, the tracking error at equal cost and the best z, `rms_z`.
    """
    import xarray as xr

    cases = list(_cases(methods, picard, chord))
    grid = np.geomspace(z[0], z[1], int(z[2]))
    lanes = len(sizes) * directions * len(grid)
    total, done = len(robots) * len(cases) * lanes, 0
    shape = (len(robots), len(cases))
    arrived, steps, cost = np.zeros((*shape, len(grid))), np.full((*shape, len(grid)), np.nan), np.zeros(shape)
    rms, rms_z, rms_N = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, int)
    for r, (_, law, rest, arm) in enumerate(_robots(robots, tasks)):
        target = at_rest(law, None, rest)
        moves = np.concatenate([_moves(law, s * arm, directions, seed) for s in sizes])
        q0 = maps.starts(law, rest, moves)[:, None]
        for c, (_, method, kind, M) in enumerate(cases):
            stage = _shared(kind, picard, chord)
            made = maps.measure(
                law,
                target,
                q0,
                alpha=grid,
                Ts=1.0,
                M=M,
                N=N,
                method=method,
                stage=stage,
                tolerance=tolerance,
                scale=1.0,
            )
            ended = made.kind == Kind.CONVERGED
            arrived[r, c] = ended.mean(0)
            steps[r, c] = np.where(ended.all(0), np.median(made.steps, 0), np.nan)
            fixed = stages.picard(0) if kind is None else getattr(stages, kind)(M)
            cost[r, c] = int(evaluations_per_step(method, fixed, law.chain.n))
            rms[r, c], rms_z[r, c], rms_N[r, c] = _track(law, rest, arm, method, stage, M, int(cost[r, c]), track)
            done += lanes
            if progress is not None:
                progress(done, total)
    dims = ("robot", "case", "z")
    return xr.Dataset(
        {
            "steps": (dims, steps, {"units": "1", "long_name": "steps to the tolerance, median over starts"}),
            "arrived": (dims, arrived, {"units": "1", "long_name": "share of starts that arrive"}),
            "evaluations": (dims, steps * cost[..., None], {"units": "1", "long_name": "evaluations of f"}),
            "rms": (dims[:2], rms, {"units": "m", "long_name": "RMS tracking error at equal cost, at its best z"}),
            "rms_z": (dims[:2], rms_z, {"units": "1", "long_name": "that z"}),
            "rms_N": (dims[:2], rms_N, {"units": "1", "long_name": "steps per turn"}),
        },
        coords={
            "robot": list(robots),
            "case": [case[0] for case in cases],
            "z": ("z", grid, {"units": "1", "long_name": "z = α·Ts"}),
        },
    )


def _track(law, rest, arm, method, stage, M, cost, track):
    """RMS error over the second of two turns of a circle, at its best z: (error, z, steps per turn)."""
    N = max(track["evaluations"] // cost, 4)
    z = np.asarray(track["z"], float)
    path = reference_from("circle", law.chain, law.task, rest, radius=track["radius"] * arm, period=1.0)
    size = np.asarray(_circle(law, path, jnp.asarray(rest), jnp.asarray(z), N, M, stage, method=method))
    best = int(np.argmin(np.where(np.isfinite(size), size, np.inf)))
    return size[best], z[best], N


@functools.partial(jax.jit, static_argnames=("method",))
def _circle(law, path, rest, z, N, M, stage, *, method):
    own = stage if M is None else replace(stage, M=M)

    def one(z):
        law_, path_, Ts = cast((replace(law, alpha=law.alpha * z * N), path, 1.0 / N), rest.dtype)

        def go(k, carry):
            q, total = carry
            made = advance(law_, path_, q, k * Ts, Ts, method, own)
            return made.q, total + jnp.where(k >= N, sp.dot(made.e, made.e), 0.0)

        _, total = lax.fori_loop(0, 2 * N, go, (tuple(rest), jnp.zeros_like(rest[0])))
        return jnp.sqrt(total / N)

    return jax.vmap(one)(z)


def _implicit_table(data):
    lines = [
        "# Implicit steps: what they cost and what they bring",
        "",
        "Reaching: every method at its own best z; median steps and evaluations of f over the same starts.",
        "`largest z` is the largest at which every start arrives. Tracking: a circle at equal evaluations of f per",
        "turn, every method at its own best z.",
    ]
    for robot in data.robot.values:
        part = data.sel(robot=robot)
        lines += [
            "",
            f"## {robot}",
            "",
            "| method | fewest steps | at z | evaluations | at z | largest z | tracking RMS | at z | steps/turn |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        for case in data.case.values:
            one = part.sel(case=case)
            cells = []
            for name in ("steps", "evaluations"):
                values = one[name].values
                if np.isfinite(values).any():
                    i = int(np.nanargmin(values))
                    cells += [f"{values[i]:.0f}", f"{float(data.z[i]):.2f}"]
                else:
                    cells += ["–", "–"]
            reached = data.z.values[np.isfinite(one.steps.values)]
            cells.append(f"{reached.max():.2f}" if reached.size else "–")
            cells += [f"{float(one.rms):.2e}", f"{float(one.rms_z):.2f}", f"{int(one.rms_N)}"]
            lines.append(f"| {case} | " + " | ".join(cells) + " |")
        fewest = part.evaluations.min("z")
        quick = part.steps.min("z")
        track = part.rms
        winner = lambda v: str(data.case.values[int(np.nanargmin(v.values))])  # noqa: E731
        lines += [
            "",
            f"Fewest evaluations to reach: {winner(fewest)}; fewest steps: {winner(quick)}; "
            f"best tracking at equal cost: {winner(track)}.",
        ]
    return "\n".join(lines) + "\n"


STUDIES = {"agreement": agreement_study, "implicit": implicit_study}
TABLES = {"agreement": _agreement_table, "implicit": _implicit_table}
