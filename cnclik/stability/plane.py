"""The plane of z = alpha·Ts: regions, limits on the real axis and delay limits of methods, as one labelled dataset."""

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.method import named
from cnclik.integrate.stage import chord, picard
from cnclik.measure.dataset import about
from cnclik.measure.files import markdown
from cnclik.precision import of_numbers
from cnclik.stability.linear import delay_limit, real_axis_limits, stability_region

DELAYS = 5  # 0 … 4 samples
EXPLICIT = ("EE", "HEUN", "MIDPOINT", "RK4")
IMPLICIT = ("IE", "CN", "TRAPEZOID")
LIMITS = ("stable", "monotone", "dead_beat", "fastest", "rate")
_LATE = "largest stable z, error measured late, stages exact"
_HEADER = ("stable", "monotone", "dead-beat", "fastest", "error × per step")


@of_numbers
def plane(methods=(*EXPLICIT, *IMPLICIT), passes=(0, 1, 2, 3, 4, 5, 10), *, points=201, progress=None):
    """Stability regions and limits of methods, implicit ones for Picard passes M and solved exactly. In float64.

    Args:
      methods: names. passes: M of the regions; limits are there for every M up to the largest.
      points: of a region, along each axis.
      progress: called as progress(limits found, of how many), or None.
    Returns: an xarray.Dataset: limits over `row` (method, stage), |R(z)| over (region_row, im, re), and `delay_limit`
      over (delayed, delay), stages solved exactly.
    """
    import xarray as xr

    methods = [named(method, "methods") for method in methods]
    passes = [errors.integer("passes", M, at_least=0) for M in passes]
    for name, given in (("methods", methods), ("passes", passes)):
        if not given:
            raise errors.fail(name, "name at least one", "is empty")
    rows, regions = [], []
    cases = [case for method in methods for case in _cases(method, passes)]
    for i, (method, name, stage, is_drawn) in enumerate(cases):
        rows.append((method.name, name, real_axis_limits(method, stage)))
        if is_drawn:
            regions.append((f"{method} {name}".strip(), stability_region(method, stage, points=points)))
        if progress is not None:
            progress(i + 1, len(cases))
    first = regions[0][1]
    drawn = np.stack([region.values.astype(np.float32) for _, region in regions])
    late = [[delay_limit(d, m, chord(1)) for d in range(DELAYS)] for m in methods]
    return xr.Dataset(
        {n: ("row", np.array([getattr(found, n) for *_, found in rows]), {"units": "1"}) for n in LIMITS}
        | {
            "region": (("region_row", "im", "re"), drawn, about("|R(z)|", "1")),
            "delay_limit": (("delayed", "delay"), np.array(late), about(_LATE, "1")),
        },
        coords={
            "method": ("row", [r[0] for r in rows]),
            "stage": ("row", [r[1] for r in rows]),
            "region_row": [name for name, _ in regions],
            "delayed": [m.name for m in methods],
            "delay": ("delay", np.arange(DELAYS), about("samples", "1")),
            "re": first.re,
            "im": first.im,
        },
    )


def _cases(method, passes):
    """(method, the stage's name, the stage, whether its region is drawn) for each way to solve it."""
    if not method.implicit:
        yield method, "", None, True
        return
    most = max(passes)
    for M in range(most + 1):  # one compiled program per method: the number of passes is an array
        yield method, f"picard({M})", picard(jnp.asarray(M), maximum=most), M in passes
    yield method, "exact", chord(1), True


def limit_tables(data):
    """The tables of a `plane`: [(title, header, rows)], numbers as text, "none" for no limit."""
    limits = [
        [str(method), str(stage), *_texts(values)]
        for method, stage, *values in zip(
            data.method.values, data.stage.values, *(data[n].values for n in LIMITS), strict=True
        )
    ]
    late = [[str(m), *_texts(v)] for m, v in zip(data.delayed.values, data.delay_limit.values, strict=True)]
    delays = [f"d = {d}" for d in data.delay.values]
    return [
        ("Limits of z = alpha·Ts on the real axis", ["method", "stage", *_HEADER], limits),
        ("Largest stable z, error measured with a delay of d samples, stages exact", ["method", *delays], late),
    ]


def plane_page(data) -> str:
    """The tables of a `plane` as a Markdown page."""
    first, late = limit_tables(data)
    return "\n".join([
        *(f"# {first[0]}", "", "`exact` is what chord(M) and newton(M) do. none: no limit.", ""),
        markdown(*first[1:], left=2),
        *(f"## {late[0]}", "", markdown(*late[1:])),
    ])  # fmt: skip


def _texts(values):
    return ["–" if v != v else "none" if v == np.inf else f"{v:.4f}" for v in values]
