"""Evidence: studies that hold linear theory and implicit stages against whole nonlinear loops.

Each takes what its spec says (see results/stability/*.toml) and returns one labelled dataset.
"""

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate import stage as stages
from cnclik.integrate.method import METHODS
from cnclik.integrate.solve import evaluations_per_step, solve
from cnclik.problem.build import problem_from, reference_from
from cnclik.record import replace
from cnclik.robot.posture import arm_length as length
from cnclik.stability import maps
from cnclik.stability.linear import stability_limit
from cnclik.stability.spectrum import at_rest

_LIMITED = 1e3  # limits beyond this are shown as none


def _robots(names, tasks):
    """The loops by robot name: law with alpha 1, its resting place, the arm's length [m]."""
    for name, task in zip(names, tasks, strict=True):
        found = problem_from(name, task=task, alpha=1.0)
        yield name, found.law, found.q0, length(found.law.chain)


def _moves(law, size, count, seed):
    drawn = np.random.default_rng(seed).normal(size=(count, len(law.task.position)))
    return size * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def _groups(methods, picard, chord):
    """(method, stage kind or None, passes) for each way to step: what shares one compiled program."""
    for name in methods:
        method = METHODS[errors.one_of("methods", name, METHODS)]
        if not method.implicit:
            yield method, None, (0,)
            continue
        for kind, some in (("picard", picard), ("chord", chord)):
            if some:
                yield method, kind, tuple(some)


def _labels(method, kind, passes):
    return [f"{method} {kind}({M})" if kind else str(method) for M in passes]


def _stage(kind, passes):
    """A stage whose number of passes is a lane's own; the largest fixes the program."""
    return stages.picard(0) if kind is None else getattr(stages, kind)(max(passes))


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

    groups = list(_groups(methods, picard, chord))
    cases = [label for group in groups for label in _labels(*group)]
    limits = np.array([stability_limit(m, _masked(kind, M, passes)) for m, kind, passes in groups for M in passes])
    values = np.linspace(z[0], z[1], int(z[2])) * np.where(np.isfinite(limits), limits, 10.0)[:, None]
    lanes = len(sizes) * directions * int(z[2])
    total, done = len(robots) * len(cases) * lanes, 0
    found = np.full((3, len(robots), len(cases), len(sizes)), np.nan)
    for r, (_, law, rest, arm) in enumerate(_robots(robots, tasks)):
        target = at_rest(law, None, rest)
        moves = np.concatenate([_moves(law, s * arm, directions, seed) for s in sizes])
        q0 = maps.starts(law, rest, moves).reshape(len(sizes), directions, 1, -1)
        first = 0
        for method, kind, passes in groups:
            own = slice(first, first + len(passes))
            first = own.stop
            made = maps.outcomes(
                law,
                target,
                q0,
                alpha=values[own, None, None],
                Ts=1.0,
                M=np.array(passes)[:, None, None, None] if kind else None,
                N=N,
                method=method,
                stage=_stage(kind, passes),
                tolerance=tolerance,
                progress=None if progress is None else lambda ran, _, done=done: progress(done + ran, total),
            )
            done += len(passes) * lanes
            for c in range(own.start, own.stop):
                inside, outside = values[c] < limits[c] * (1 - band), values[c] > limits[c] * (1 + band)
                for s in range(len(sizes)):
                    kinds = made.ending[c - own.start, s]
                    good = maps.stable(kinds)
                    found[0, r, c, s] = maps.agreement(kinds, values[c], limits[c], band=band)
                    found[1, r, c, s] = 1 - good[:, inside].mean()
                    found[2, r, c, s] = good[:, outside].mean() if outside.any() else 0.0
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
            "case": cases,
            "size": ("size", np.asarray(sizes, float), {"units": "1", "long_name": "initial error / arm length"}),
        },
    )


def _masked(kind, M, passes):
    """One M of a group, as an array: linear theory too compiles once for all of them."""
    return None if kind is None else getattr(stages, kind)(jnp.asarray(M), maximum=max(passes))


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

    groups = list(_groups(methods, picard, chord))
    cases = [label for group in groups for label in _labels(*group)]
    grid, track_z = np.geomspace(z[0], z[1], int(z[2])), np.asarray(track["z"], float)
    starts = len(sizes) * directions
    total, done = len(robots) * len(cases) * (starts * len(grid) + len(track_z)), 0
    shape = (len(robots), len(cases))
    arrived, steps, cost = np.zeros((*shape, len(grid))), np.full((*shape, len(grid)), np.nan), np.zeros(shape, int)
    rms, rms_z, rms_N = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, int)
    for r, (_, law, rest, arm) in enumerate(_robots(robots, tasks)):
        moves = np.concatenate([_moves(law, s * arm, directions, seed) for s in sizes])
        q0 = maps.starts(law, rest, moves)
        first = 0
        for method, kind, passes in groups:
            own = slice(first, first + len(passes))
            first = own.stop
            stage = _stage(kind, passes)
            cost[r, own] = [int(evaluations_per_step(method, _stage(kind, (M,)), law.chain.n)) for M in passes]
            rms_N[r, own] = np.maximum(track["evaluations"] // cost[r, own], 4)
            # Reaching and tracking are lanes of one program: a point is a circle of radius 0.
            reach = _lanes(q0[:, None], grid, np.array(passes)[:, None, None], 0.0, 1.0)
            turns = rms_N[r, own]
            circle = _lanes(
                rest, track_z * turns[:, None], np.array(passes)[:, None], track["radius"] * arm, 1 / turns[:, None]
            )
            report = None if progress is None else lambda ran, done=done: progress(done + ran, total)
            size = _errors(law, rest, reach, circle, stage, max(N, 2 * turns.max()), method, report)
            done += len(reach[0]) + len(circle[0])
            split = len(reach[0])
            ended, needed = _arrival(size[:split, : N + 1].reshape(len(passes), starts, len(grid), -1), tolerance)
            arrived[r, own] = ended.mean(1)
            steps[r, own] = np.where(ended.all(1), np.median(needed, 1), np.nan)
            tracked = size[split:].reshape(len(passes), len(track_z), -1)
            for i, turn in enumerate(turns):
                error = np.sqrt(np.mean(tracked[i, :, turn : 2 * turn] ** 2, -1))
                best = int(np.argmin(np.where(np.isfinite(error), error, np.inf)))
                rms[r, own.start + i], rms_z[r, own.start + i] = error[best], track_z[best]
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
            "case": cases,
            "z": ("z", grid, {"units": "1", "long_name": "z = α·Ts"}),
        },
    )


def _lanes(q0, alpha, M, radius, Ts):
    """Arguments of many loops, broadcast against each other and laid out in one row."""
    shape = np.broadcast_shapes(np.shape(q0)[:-1], np.shape(alpha), np.shape(M), np.shape(Ts))
    flat = lambda v, kind=float: np.broadcast_to(np.asarray(v, kind), shape).ravel()  # noqa: E731
    starts = np.broadcast_to(q0, (*shape, q0.shape[-1])).reshape(-1, q0.shape[-1])
    return starts, flat(alpha), flat(M, int), flat(radius), flat(Ts)


def _errors(law, rest, reach, circle, stage, N, method, progress):
    """‖e‖ (loops, N + 1) about a circle through the tip at `rest`, one turn per second."""
    at = reference_from("circle", law.chain, law.task, rest, radius=1.0, period=1.0)

    def one(q0, alpha, M, radius, Ts):
        curve = at.curve
        path = replace(
            at,
            curve=replace(
                curve,
                center=curve.center + (1 - radius) * curve.first,
                first=radius * curve.first,
                second=radius * curve.second,
            ),
        )
        own = stage if isinstance(stage, stages.Picard) and stage.maximum == 0 else replace(stage, M=M)
        run = solve(replace(law, alpha=law.alpha * alpha), path, q0, Ts, N, method, own)
        return jnp.sqrt(jnp.sum(run.e**2, -1))

    both = [np.concatenate(pair) for pair in zip(reach, circle, strict=True)]
    work = len(both[0]) * N * int(evaluations_per_step(method, replace(stage, M=stage.maximum), law.chain.n))
    size = np.asarray(maps.many(one, work)(*both))
    if progress is not None:
        progress(len(size))
    return size


def _arrival(size, tolerance):
    """Whether loops (..., N + 1) stay below the tolerance in their last quarter, and after how many steps."""
    N = size.shape[-1] - 1
    above = ~(size <= tolerance)
    last = np.where(above.any(-1), N - np.argmax(above[..., ::-1], -1), -1)
    return ~above[..., N - N // 4 :].any(-1), last + 1


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
                    cells += [f"{values[i]:.3g}", f"{float(data.z[i]):.2f}"]
                else:
                    cells += ["–", "–"]
            reached = data.z.values[np.isfinite(one.steps.values)]
            cells.append(f"{reached.max():.2f}" if reached.size else "–")
            cells += [f"{float(one.rms):.2e}", f"{float(one.rms_z):.2f}", f"{int(one.rms_N)}"]
            lines.append(f"| {case} | " + " | ".join(cells) + " |")
        fewest = part.evaluations.min("z")
        quick = part.steps.min("z")
        track = part.rms
        winner = lambda v: ", ".join(data.case.values[v.values == np.nanmin(v.values)])  # noqa: E731
        lines += [
            "",
            f"Fewest evaluations to reach: {winner(fewest)}. Fewest steps: {winner(quick)}. "
            f"Best tracking at equal cost: {winner(track)}.",
        ]
    return "\n".join(lines) + "\n"


STUDIES = {"agreement": agreement_study, "implicit": implicit_study}
TABLES = {"agreement": _agreement_table, "implicit": _implicit_table}
