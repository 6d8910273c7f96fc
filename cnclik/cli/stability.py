"""`cnclik stability`: which gain is safe at which sampling time, as numbers, regions and measured maps."""

import dataclasses
import pathlib
import time
from typing import Annotated

import tyro

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.problem import LoopOptions, Numbers, RobotOptions, TaskOptions, problem, table

_EXPLICIT, _IMPLICIT = ("EE", "HEUN", "MIDPOINT", "RK4"), ("IE", "CN", "TRAPEZOID")


@dataclasses.dataclass(kw_only=True)
class Args(LoopOptions, TaskOptions, RobotOptions):
    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")] = "planar-clockwise:1,1,1,1,1"
    """A URDF file, panda, ur5, or planar:1,1,1 (link lengths in m); the paper's 5-dof arm by default."""
    target: Numbers = None
    """Where the loop is to come to rest: position [m], for a pose optionally a quaternion w x y z."""
    N: int = 100
    """Horizon of the measured loops: steps."""
    tolerance: float = 1e-3
    """Fraction of the initial error below which a measured loop must stay to count as converged."""
    plane: bool = False
    """Regions in the complex z-plane for --methods and --passes, and the real-axis limits as a table."""
    map: bool = False
    """Measured map of whole loops over alpha and Ts, and a strip over M for implicit methods."""
    methods: tuple[str, ...] = (*_EXPLICIT, *_IMPLICIT)
    """Methods of --plane."""
    passes: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 10)
    """Passes M of --plane; the strip over M goes up to the largest."""
    alpha_range: tuple[float, float] | None = None
    """Gains of --map [1/s]; by default about --alpha and the linear boundary."""
    Ts_range: tuple[float, float] | None = None
    """Sampling times of --map [s]; by default about --Ts and the linear boundary."""
    cells: int = 128
    """Cells of --map along each axis."""
    out: pathlib.Path = pathlib.Path("results/stability")
    """Folder for figures and data (netCDF)."""


def run(args: Args) -> None:
    """Numbers on the terminal; figures and labelled data in the folder."""
    from cnclik.show.output import output_folder

    if args.cells < 2:
        raise errors.fail("cells", "be at least 2", f"is {args.cells}")
    for name in ("methods", "passes"):
        if not getattr(args, name):
            raise errors.fail(name, "name at least one", "is empty")
    for M in args.passes:
        errors.integer("passes", M, at_least=0)
    errors.integer("N", args.N, at_least=4)
    errors.number("tolerance", args.tolerance, positive=True)
    for name, given in (("alpha-range", args.alpha_range), ("Ts-range", args.Ts_range)):
        if given is not None:
            errors.number(name, given[0], positive=True)
            if not given[0] < given[1]:
                raise errors.fail(name, "increase", f"is {given[0]:g} to {given[1]:g}")
    if args.plane or args.map:
        with output_folder(args.out) as out:
            if args.plane:
                _plane(args, out)
            if args.map:
                _map(args, out)
        print(f"Results in {args.out}")
    else:
        _advise(args, *_loop(args))


# --- the loop at rest ---------------------------------------------------------------------------------


def _loop(args):
    from cnclik.stability.spectrum import settle

    found = problem(args)
    return found, settle(found.law, found.reference, found.q0)


def _advise(args, found, rest):
    """What is safe, and how far the operating point is from what is not."""
    import numpy as np
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from cnclik.stability import spectrum

    loop = dict(method=found.method, stage=found.stage, target=found.reference)
    gains = spectrum.recommend(found.law, rest, Ts=found.Ts, **loop)
    times = spectrum.recommend(found.law, rest, **loop)
    now = spectrum.margin(found.law, rest, found.Ts, **loop)
    eigen = spectrum.spectrum(found.law, found.reference, rest, found.Ts, found.method, found.stage)
    how = f"{found.method}" + (f", {found.stage}" if found.method.implicit else "")
    shown = Table(title=f"{found.name}, {how}, task {' '.join(found.law.task.names)}", title_justify="left")
    for column, justify in (("", "left"), ("value", "right"), ("z = alpha·Ts", "right"), ("error × per step", "right")):
        shown.add_column(column, justify=justify)
    number = lambda v: np.array2string(np.asarray(v), precision=5, separator=", ")  # noqa: E731
    edge = lambda found: "1" if np.isfinite(found.z_largest) else "–"  # noqa: E731
    shown.add_row(f"alpha now, Ts = {found.Ts:g} s", number(found.law.alpha), f"{now.z:.4g}", f"{now.radius:.4g}")
    shown.add_row("largest stable alpha [1/s]", number(gains.largest), f"{gains.z_largest:.4g}", edge(gains))
    shown.add_row("fastest alpha [1/s]", number(gains.fastest), f"{gains.z_fastest:.4g}", f"{gains.radius:.3g}")
    shown.add_row(
        escape("largest stable Ts [s] at alpha now"), number(times.largest), f"{times.z_largest:.4g}", edge(times)
    )
    shown.add_row(
        escape("fastest Ts [s] at alpha now"), number(times.fastest), f"{times.z_fastest:.4g}", f"{times.radius:.3g}"
    )
    console = Console()
    console.print(shown)
    verdict = "stable" if now.margin > 1 else "UNSTABLE"
    console.print(f"{verdict}: gain margin {now.margin:.4g}; {now.limit}.", highlight=False)
    console.print(
        f"Gain per step as pink and mink take it: {now.z:.4g}. Null space: {len(eigen.null)} directions, "
        f"|λ| = {eigen.null_radius:.4g}. {gains.evaluations} evaluations per step.",
        highlight=False,
    )
    return now


# --- the plane ----------------------------------------------------------------------------------------


def _plane(args, out):
    import jax.numpy as jnp
    import numpy as np
    import xarray as xr
    from rich.console import Console
    from rich.table import Table

    from cnclik.integrate import stage as stages
    from cnclik.integrate.method import METHODS
    from cnclik.measure.dataset import as_json, provenance
    from cnclik.show import stability as show
    from cnclik.stability import linear

    methods = [METHODS[errors.one_of("methods", name, METHODS)] for name in args.methods]
    explicit, implicit = [m for m in methods if not m.implicit], [m for m in methods if m.implicit]
    # One compiled program per method: the number of passes is an array.
    most = max(args.passes, default=0)
    picard = lambda M: stages.picard(jnp.asarray(M), maximum=most)  # noqa: E731
    regions, rows, delays = {}, [], []
    if explicit:
        regions["explicit"] = {m.name: linear.stability_region(m, points=201) for m in explicit}
        rows += [(m.name, "", linear.limits(m)) for m in explicit]
    with progress.bar("limits") as report:
        total, done = len(implicit) * (most + 2), 0
        for m in implicit:
            regions[m.name] = {}
            for M in (*range(most + 1), None):
                name, stage = ("exact", stages.chord(1)) if M is None else (f"picard({M})", picard(M))
                if M is None or M in args.passes:
                    regions[m.name][name] = linear.stability_region(m, stage, points=201)
                rows.append((m.name, name, linear.limits(m, stage)))
                done += 1
                report(done, total)
    for m in methods:
        delays.append((m.name, [linear.delay_limit(d, m, stages.chord(1)) for d in range(5)]))
    show.plane(regions, out / "plane.png", {"Title": "stability regions"})
    shown = Table(title="Limits of z = alpha·Ts on the real axis", title_justify="left")
    for name in ("method", "stage", "stable", "monotone", "dead-beat", "fastest", "error × per step"):
        shown.add_column(name, justify="left" if name in ("method", "stage") else "right")
    for method, stage, found in rows:
        shown.add_row(method, stage, *_values(found))
    Console().print(shown)
    late = Table(title="Largest stable z, error measured d samples late, stages exact", title_justify="left")
    for name in ("method", *(f"d = {d}" for d in range(5))):
        late.add_column(name, justify="left" if name == "method" else "right")
    for method, found in delays:
        late.add_row(method, *_numbers(found))
    Console().print(late)
    (out / "plane.md").write_text(_limits_text(rows, delays), encoding="utf-8")
    names = ("stable", "monotone", "dead_beat", "fastest", "rate")
    shown_rows = [(group, name) for group, several in regions.items() for name in several]
    first = next(iter(next(iter(regions.values())).values()))
    table_ = xr.Dataset(
        {n: ("row", np.array([getattr(f, n) for _, _, f in rows]), {"units": "1"}) for n in names}
        | {
            "region": (
                ("region_row", "im", "re"),
                np.stack([r.values.astype(np.float32) for g in regions.values() for r in g.values()]),
                {"units": "1", "long_name": "|R(z)|"},
            ),
            "delay_limit": (
                ("delayed", "delay"),
                np.array([found for _, found in delays]),
                {"units": "1", "long_name": "largest stable z, error measured late, stages exact"},
            ),
        },
        coords={
            "method": ("row", [r[0] for r in rows]),
            "stage": ("row", [r[1] for r in rows]),
            "region_row": [" ".join(pair) for pair in shown_rows],
            "delayed": [m for m, _ in delays],
            "delay": ("delay", np.arange(5), {"units": "1", "long_name": "samples"}),
            "re": first.re,
            "im": first.im,
        },
        attrs=provenance(float) | {"config": as_json({"methods": args.methods, "passes": args.passes})},
    )
    _write(table_, out / "plane.nc")


def _values(found):
    return _numbers((found.stable, found.monotone, found.dead_beat, found.fastest, found.rate))


def _numbers(values):
    return ["–" if v != v else "none" if v == float("inf") else f"{v:.4f}" for v in values]


def _limits_text(rows, delays):
    lines = [
        "# Limits of z = alpha·Ts on the real axis",
        "",
        "`exact` is what chord(M) and newton(M) do. none: no limit.",
        "",
        "| method | stage | stable | monotone | dead-beat | fastest | error × per step |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *(f"| {method} | {stage} | " + " | ".join(_values(found)) + " |" for method, stage, found in rows),
        "",
        "## Error measured d samples late, stages exact: largest stable z",
        "",
        "| method | d = 0 | 1 | 2 | 3 | 4 |",
        "| --- | --- | --- | --- | --- | --- |",
        *(f"| {method} | " + " | ".join(_numbers(found)) + " |" for method, found in delays),
    ]
    return "\n".join(lines) + "\n"


# --- the map ------------------------------------------------------------------------------------------


def _map(args, out):
    import numpy as np

    from cnclik.measure.dataset import as_json, provenance
    from cnclik.show import stability as show
    from cnclik.stability import maps
    from cnclik.stability.spectrum import largest_rate

    begun = time.perf_counter()
    found, rest = _loop(args)
    now = _advise(args, found, rest)
    rate = largest_rate(found.law.alpha)
    # Half the way to the boundary, as a ratio, by the gain and half by the sampling time: both are in the picture.
    half = np.sqrt(min(now.margin, 20 / now.z))
    alphas = np.geomspace(*_range(args.alpha_range, rate, half), args.cells)
    times = np.geomspace(*_range(args.Ts_range, found.Ts, half), args.cells)
    config = table(args) | {"tolerance": args.tolerance}
    loop = dict(method=found.method, stage=found.stage, N=args.N, tolerance=args.tolerance)
    with progress.bar("loops") as report:
        total = args.cells**2
        data = maps.stability_map(
            found.law, found.reference, found.q0, alphas, times, progress=lambda done: report(done, total), **loop
        )
    attributes = provenance(float) | {"config": as_json(config)}
    data = data.assign_attrs(attributes)
    _write(data, out / "map.nc")
    how = f"{found.method}" + (f", {found.stage}" if found.method.implicit else "")
    show.stability_map(
        data,
        out / "map.png",
        {"Title": f"stability map, {found.name}", "Description": as_json(config)},
        title=f"{found.name}, {how}, N = {args.N}",
        operating=(rate, found.Ts, now.margin),
    )
    if found.method.implicit:
        z = np.linspace(0.02, 3.0, 2 * args.cells)
        some = range(max(args.passes) + 1)
        strip = maps.passes_map(found.law, found.reference, found.q0, z, some, Ts=found.Ts, **loop)
        strip = strip.assign_attrs(attributes)
        _write(strip, out / "passes.nc")
        title = f"{found.name}, {found.method}, {strip.attrs['stage']}(M)"
        show.passes({title: strip}, out / "passes.png", {"Title": title, "Description": as_json(config)})
    counts = {
        name: int(np.sum(data.kind.values == i)) for i, name in enumerate(data.kind.attrs["flag_meanings"].split())
    }
    print(", ".join(f"{name} {count}" for name, count in counts.items()))
    inside = maps.agreement(data.kind.values, data.alpha.values, data.limit.values[:, None])
    print(f"{total:,} loops in {time.perf_counter() - begun:.1f} s; agreement with the linear boundary: {inside:.2%}")


def _range(given, now, half):
    """The range given, or from a third of what is now to three times what lies half the way to the boundary."""
    return given if given is not None else (now * min(1, half) / 3, now * max(1, half) * 3)


def _write(data, path):
    packed = {
        v: {"zlib": True, "complevel": 6} for v in data.data_vars if data[v].dtype.kind in "fiub" and data[v].ndim
    }
    data.to_netcdf(path, engine="h5netcdf", encoding=packed)
