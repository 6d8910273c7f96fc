"""Tables of docs/speed.md from the files that were measured: `python -m tests.bench.document`.

The page's text is written by hand; between `<!-- NAME -->` and `<!-- end -->` stands what this module writes from
results/speed/peers.json (`python -m tests.bench`) and first.json (`python -m tests.bench.first --json`).
"""

import itertools
import json
import os
import pathlib
import re
import statistics
import sys

from cnclik.measure.files import markdown
from tests.bench import first

ROOT = pathlib.Path(__file__).parents[2]
PAGE = ROOT / "docs" / "speed.md"
RESULTS = ROOT / "results" / "speed"


def machine() -> dict:
    """What the numbers were measured on."""
    import platform

    import jax
    import jaxlib

    from cnclik.threads import cores
    from tests.bench import timing as bench

    return {
        "processor": bench.processor(),
        "cores": cores(),
        "vectors": _vectors(),
        "system": platform.system(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "load": round(os.getloadavg()[0], 1),
    }


def _vectors():
    """The widest vector instructions the processor names."""
    try:
        with open("/proc/cpuinfo") as info:
            flags = next(row for row in info if row.startswith("flags")).split()
    except (OSError, StopIteration):
        return "unknown"
    return next((name for flag, name in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in flags), "unknown")


# --- rows ---------------------------------------------------------------------------------------------


def pick(records, **wanted):
    """The one record with these values."""
    (found,) = [r for r in records if all(r.get(name) == value for name, value in wanted.items())]
    return found


def ratio(slow, fast) -> tuple:
    """How many times faster: median, least and largest of the ratios round by round."""
    ratios = [a / b for a, b in zip(slow["seconds"], fast["seconds"], strict=True)]
    return statistics.median(ratios), min(ratios), max(ratios)


def to_reach(found) -> list[dict]:
    """One row per claim that can be made from what was measured: what, wanted, found, low, high, reached."""
    rows = []

    def row(what, wanted, values, *, unit, at_least):
        middle, low, high = values
        reached = middle >= wanted if at_least else middle < wanted
        rows.append(
            {"what": what, "wanted": wanted, "found": middle, "low": low, "high": high, "unit": unit}
            | {"at_least": at_least, "reached": reached}
        )

    if "peers" in found:
        all_peers, singles = found["peers"]["peers"], found["peers"]["single"]

        def peer(name, task="EE", dtype="float32", flags="default", inverse="damped"):
            return pick(all_peers, name=name, task=task, dtype=dtype, flags=flags, inverse=inverse)

        def times(what, wanted, slow, fast):
            row(what, wanted, ratio(slow, fast), unit="×", at_least=True)

        cpp = peer("Pinocchio C++", dtype="float64")
        times("Panda EE, float32, against Pinocchio C++ (float64)", 15, cpp, peer("cnclik"))
        times("Panda EE, float32, against Pinocchio C++ (float32)", 15, peer("Pinocchio C++"), peer("cnclik"))
        times("Panda EE, float64, against Pinocchio C++ (float64)", 8, cpp, peer("cnclik", dtype="float64"))
        cpp_cn = peer("Pinocchio C++", "CN", "float64")
        times("Panda CN, picard(5), float32, against Pinocchio C++ (float64)", 12, cpp_cn, peer("cnclik", "CN"))
        times("against textbook JAX under vmap, float32", 100, peer("textbook JAX, cho_solve"), peer("cnclik"))
        times(
            "against frax 0.1.0, single-thread flags, float32",
            25,
            peer("frax 0.1.0", flags="single thread"),
            peer("cnclik"),
        )
        for dtype, flags in itertools.product(("float32", "float64"), ("single thread", "default")):
            one, other = (pick(singles, name=name, dtype=dtype, flags=flags) for name in ("cnclik", "Pinocchio C++"))
            what = f"one warm solve of {one['N']} steps from Python, {dtype}, {flags} flags, over Pinocchio C++"
            row(what, 1.5, ratio(one, other), unit="×", at_least=False)
    if "cores" in found:
        one, two = (
            {"seconds": [1 / r["evaluations_per_second"] for r in found["cores"] if r["cores"] == count]}
            for count in (1, 2)
        )
        row("two cores against one, batch 262144", 1.8, ratio(one, two), unit="×", at_least=True)
    if "compile" in found:
        for key, what, wanted in (("cold_s", "cold", 6), ("cached_s", "with the persistent cache", 1)):
            row(f"compile time, Panda, {what}", wanted, _range(found["compile"], key), unit=" s", at_least=False)
    if "gradient" in found:
        for key, what, wanted in (("alpha_gradient", "alpha, forward mode", 2.5), ("gradient", "q0, reverse mode", 6)):
            values = _range(found["gradient"], f"{key}_over_forward")
            row(f"value and gradient w.r.t. {what}, over the value", wanted, values, unit="×", at_least=False)
            values = _range(found["gradient"], f"{key}_compile_s")
            row(f"compile time of it ({what})", 8, values, unit=" s", at_least=False)
    for dtype in ("float32", "float64") if "million" in found else ():
        some = [r for r in found["million"] if r["dtype"] == dtype]
        what = f"1e6 loops of 30 steps, 5 joints, CN, M = 5, two cores, {dtype}"
        row(what, 5, _range(some, "run_s"), unit=" s", at_least=False)
        row(f"peak memory of it, {dtype}", 1024, _range(some, "peak_mib"), unit=" MiB", at_least=False)
    return rows


def _range(records, key):
    values = [r[key] for r in records]
    return statistics.median(values), min(values), max(values)


# --- tables in Markdown -------------------------------------------------------------------------------


ELSEWHERE = re.compile("compile|gradient|memory|single thread flags")  # on the page in other words, or of no use there


def _reach(found):
    rows = [r for r in to_reach(found) if not ELSEWHERE.search(r["what"])]
    rows = [(r["what"], f"{r['found']:.3g}{r['unit']}", f"{r['low']:.3g} - {r['high']:.3g}") for r in rows]
    return markdown(("what", "measured", "range"), rows)


def _machine(found):
    m = found["machine"]
    return (
        f"{m['processor']}, {m['cores']} cores, {m['vectors']}, {m['system']}; Python {m['python']}, JAX {m['jax']}, "
        f"jaxlib {m['jaxlib']}; load average at the end {m['load']}."
    )


def sections(results: pathlib.Path) -> dict:
    """Name and Markdown of each table for which there is data."""
    made = {}
    if (results / "peers.json").exists():
        found = json.loads((results / "peers.json").read_text())
        made |= {"machine": _machine(found), "reach": _reach(found)}
    if (results / "first.json").exists():
        made["first"] = first.table(json.loads((results / "first.json").read_text()))
    return made


def fill(text: str, made: dict) -> str:
    """A page with every marked section replaced that there is something new for."""
    for name, table in made.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = pattern.sub(lambda m, table=table: f"{m[1]}\n{table.strip()}\n\n{m[2]}", text)
    return text


def show(found: dict) -> None:
    """What was to be reached, on the terminal."""
    from rich.console import Console
    from rich.table import Table

    shown = Table(title=_machine(found), header_style="bold")
    for name in ("what", "to reach", "measured", "range", "reached"):
        shown.add_column(name, justify="left" if name == "what" else "right")
    for r in to_reach(found):
        wanted = f"{'at least' if r['at_least'] else 'under'} {r['wanted']:g}{r['unit']}"
        measured, around = f"{r['found']:.3g}{r['unit']}", f"{r['low']:.3g} - {r['high']:.3g}"
        shown.add_row(r["what"], wanted, measured, around, "yes" if r["reached"] else "no")
    Console().print(shown)


if __name__ == "__main__":
    made = sections(RESULTS)
    PAGE.write_text(fill(PAGE.read_text(), made))
    print(f"Wrote {', '.join(made) or 'nothing'} in {PAGE.name}", file=sys.stderr)
