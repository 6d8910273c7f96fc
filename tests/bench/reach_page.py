"""The tables and figures of `tests.bench.reach`, from what it measured."""

import json

import matplotlib.pyplot as plt
import numpy as np

from cnclik.measure.files import markdown
from cnclik.show import style

PUBLISHED = [  # µs per target in batches, µs of a single one, and where: as their authors published them
    ("PyRoki", "15", "3,270", "RTX 6000 / 4090, batches of 100 to 2,000"),
    ("cuRobo v1", "25", "4,480", "RTX 4090"),
    ("cuRobo v2", "26", "–", "RTX 4090, Franka"),
]


def text(found) -> str:
    """The JSON, a list of numbers a line."""
    curves = {r["robot"]: r["curve"] for r in found.get("robots", [])}
    kept = json.loads(json.dumps(found))
    for row in kept.get("robots", []):
        row["curve"] = f"<{row['robot']}>"
    out = json.dumps(kept, indent=1)
    for name, curve in curves.items():
        out = out.replace(json.dumps(f"<{name}>"), json.dumps(curve))
    return out + "\n"


def percent(value, digits=2):
    """A share as it is told: never rounded up to all."""
    return f"{np.floor(value * 10 ** (digits + 2)) / 10**digits:.{digits}f} %"


def statuses(row):
    """Counts of statuses in words."""
    return ", ".join(f"{v:,} {k}" for k, v in row["statuses"].items())


def robots(rows):
    """Solve rates on all robots."""
    lines = [
        [
            r["robot"],
            percent(r["solved"]),
            percent(r["wrong"]),
            f"{r['evaluations']:.1f}",
            f"{r['us']:.1f}",
            f"{r['cpu_us']:.1f}",
            f"{r['first_s']:.1f}",
            statuses(r),
        ]
        for r in rows
    ]
    head = ["robot", "solved", "wrong", "evaluations", "µs per target", "of CPU", "first call [s]", "statuses"]
    return (
        f"{rows[0]['targets']:,} random poses that can be reached, to 1e-6 m and 1e-6 rad, within limits; every answer "
        "looked at with Pinocchio. One core; evaluations and µs are means per target, of a warm call for all.\n\n"
        + markdown(head, lines)
    )


def peers(rows):
    """In turn with others."""
    lines = [
        [r["robot"], r["name"], f"{r['targets']:,}", percent(r["solved"]), f"{r['us']:.1f}", f"{r['ratio']:.2f}"]
        for r in rows
    ]
    options = "; ".join(
        f"{r['name']} on the {r['robot']}: {', '.join(f'{k} {v:g}' for k, v in r['options'].items() if k != 'version')}"
        for r in rows
        if r["options"]
    )
    head = ["robot", "", "targets", "solved", "µs per target", "times reach's"]
    absent = "" if any("Toolbox" in r["name"] for r in rows) else " Robotics Toolbox was not installed."
    return (
        "The same targets, tolerance and limits, in turn, one core, a thread each; medians of 7 rounds; solved is what "
        f"Pinocchio's kinematics confirm. Peers have the options that were best for them on 200 of the targets.{absent}"
        f"\n\n{markdown(head, lines, left=2)}\n{options}.\n"
    )


def papers(rows):
    """Beside published figures."""
    lines = [
        ["reach", f"{r['batch']:,}", f"{r['us_per_target']:.1f}", percent(r["solved"]), "this machine, one core"]
        for r in rows
    ]
    for name, many, one, where in PUBLISHED:
        lines += (
            [[name, "batch", many, "", where], [name, "1", one, "", where]]
            if one != "–"
            else [[name, "batch", many, "", where]]
        )
    return (
        "The Panda at the tolerance of papers on GPUs, 5 mm and 0.05 rad. Their figures are as published, for "
        "targets and machines of their own: an order of magnitude, not a comparison.\n\n"
        + markdown(["", "batch", "µs per target", "solved", "on"], lines)
    )


def single(found):
    """One target at a time."""
    lines = []
    for name, r in found.items():
        lines.append([name, "one target, warm", f"{r['us']:.0f} µs", f"{r['us_99']:.0f} µs", percent(r["solved"])])
        n = r["near"]
        lines.append(
            [name, "a step of 1 mm, near, jump", f"{n['us']:.0f} µs", f"{n['us_99']:.0f} µs", percent(n["right"])]
        )
        for count, c in r["cold"].items():
            what = f"first answer, {int(count):,} target{'s' * (count != '1')}"
            lines.append([name, what, f"{c['first_s']:.2f} s", "", f"+ {c['import_s']:.2f} s import"])
    head = ["robot", "", "median", "99 % within", "solved"]
    return "From Python. First answers: fresh processes without compiled programs of others.\n\n" + markdown(
        head, lines, left=2
    )


def beyond(found):
    """Out of reach."""
    lines = []
    for name, r in found.items():
        near = percent(r["within_1_percent"]) if "within_1_percent" in r else ""
        lines.append([name, statuses(r), percent(r["wrong"]), r.get("missed", ""), near, f"{r['us']:,.0f}"])
    head = ["targets", "statuses", "wrong", "missed", "nearest within 1 %", "µs per target"]
    return (
        "Missed: an answer that a long search finds (of positions: brute force, on 50 of those without an answer; of "
        "poses: Pinocchio C++ from 1,000 starts, on all of them).\n\n" + markdown(head, lines, left=2)
    )


def path(found):
    """Paths."""
    lines = [
        [
            n,
            f"{r['waypoints']:,}",
            statuses(r),
            f"{r['largest_step']:.4f}",
            f"{r['evaluations']:.1f}",
            f"{r['us']:.1f}",
        ]
        for n, r in found.items()
    ]
    head = ["robot", "waypoints", "statuses", "largest step [rad]", "evaluations", "µs each"]
    return 'A closed curve, `near="previous"`, `jump=0.2`.\n\n' + markdown(head, lines)


def parts(rows):
    """Ablations."""
    lines = [
        [r["part"], percent(r["solved"]), f"{r['evaluations']:.1f}", f"{r['us']:.1f}", f"{r['ratio']:.2f}"]
        for r in rows
    ]
    return "The Panda, one change at a time, in turn.\n\n" + markdown(
        ["", "solved", "evaluations", "µs per target", "times as long"], lines
    )


TITLES = {
    robots: "Eight robots",
    peers: "Beside peers",
    papers: "At the tolerance of papers",
    single: "One at a time",
    beyond: "Out of reach",
    path: "Paths",
    parts: "What each part is worth",
}


def solve_figure(rows, path):
    """Share of targets without an answer against evaluations."""
    with style.style():
        figure, panel = plt.subplots(figsize=(style.COLUMN, 2.9))
        for k, row in enumerate(rows):
            spent, done = np.array(row["curve"]).T
            left = np.where(done < 1, 1 - done, np.nan)
            look = style.series(k, linewidth=1.2, markevery=style.sparse(k, 40))
            panel.plot(spent, left, label=row["robot"], **look)
            last = np.flatnonzero(done >= 1)
            if len(last):  # the last one found
                panel.plot(spent[last[0]], 1 / row["targets"], "v", color=style.COLORS[k], clip_on=False)
        panel.set(xscale="log", yscale="log", xlabel="evaluations spent on a target", ylabel="share not solved yet")
        panel.set_ylim(0.9 / rows[0]["targets"], 1.1)
        panel.legend(loc="lower left")
        style.save(figure, path, {"Title": "Share of targets not solved against evaluations"})


def batch_figure(found, path):
    """Time per target against batch size, for numbers of cores."""
    with style.style():
        figure, panel = plt.subplots(figsize=(style.COLUMN, 2.5))
        for k, (cores, rows) in enumerate(sorted(found.items())):
            size, us = np.array(rows).T
            panel.plot(size, us, label=f"{cores} core{'s' * (cores != '1')}", **style.series(k, linewidth=1.2))
        panel.set(xscale="log", yscale="log", xlabel="targets in a call (Panda)", ylabel="time per target [µs]")
        panel.legend()
        style.save(figure, path, {"Title": "Time per target against batch size"})


def write(found, folder) -> None:
    """README.md and figures of what there is."""
    m = found["machine"]
    wide = "with" if m["avx512"] else "without"
    load = ", ".join(map(str, m["load"]))
    made = [
        "# How fast is reach, and how often is it right?\n\n"
        "Batched inverse kinematics, measured by `python -m tests.bench.reach`; `reach.json` has all numbers.\n\n"
        f"{m['cpu']} ({wide} AVX-512), {m['cores']} cores that others use, too (load {load}): times drift, so compare "
        f"within a table. Python {m['python']}, JAX {m['jax']}, Pinocchio {m['pinocchio']}.\n"
    ]
    for table, title in TITLES.items():
        if table.__name__ in found:
            made.append(f"## {title}\n\n{table(found[table.__name__])}")
        if table is robots and "robots" in found:
            solve_figure(found["robots"], folder / "solved.png")
            made.append("![Share of targets not solved against evaluations](solved.png)\n")
    if "scaling" in found:
        batch_figure(found["scaling"], folder / "batch.png")
        busy = "Other work kept the cores busy, so this does not show what a second core gains.\n\n" * (
            m["load"][0] > 1
        )
        made.append(f"## Batch size\n\n{busy}![Time per target against batch size](batch.png)\n")
    (folder / "README.md").write_text("\n".join(made), encoding="utf-8")
