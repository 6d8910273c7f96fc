"""`python -m tests.bench.loops`: loops as they run in pink, mink and MuJoCo, against what cnclik says of them.

Largest gains of pink's and mink's own loops; each line of settings for another tool in that tool (`--only tools`; Placo
where it is there); what the advice is worth on four arms in MuJoCo with servos, friction, encoders and the like
(`--only advice`). Into results/loops (10 minutes on one core); what is there already is kept unless --fresh, so a run
that was stopped goes on. Needs the extra `peers`.
"""

import argparse
import importlib.metadata
import importlib.util
import json
import pathlib
import sys
import time

import jax
import numpy as np

from cnclik.measure.files import markdown, plain
from tests.bench import loops_advice, timing
from tests.bench.loops_advice import ANY, MUCH, figures
from tests.bench.loops_mujoco import POSTURES, Arm

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "loops"
ZERO = 5e-6  # share below which is said none


def parts(names):
    """(name of a part, what measures it)."""
    from tests.bench import loops_peers, loops_tools  # the page is written without what these run

    yield "peers", loops_peers.measure
    yield "tools", loops_tools.measure
    if importlib.util.find_spec("placo"):  # brings a Pinocchio of its own: an environment of its own
        yield "Placo, tools", lambda: loops_tools.measure(("Placo",))
    for name in names:
        cells = [cell[1:] for cell in loops_advice.cells(POSTURES) if cell[0] == name]
        yield f"{name}, advice", lambda a=Arm(name), c=cells: [loops_advice.measure(a, *one) for one in c]


# --- the page -----------------------------------------------------------------------------------------


def text(found) -> str:
    """The JSON, a row a line; what is not finite is null."""
    lines = []
    for name, part in plain(found).items():
        if "rows" in part:
            rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in part["rows"])
            lines.append(f'{json.dumps(name)}: {{"seconds": {part["seconds"]}, "rows": [\n  {rows}]}}')
        else:
            lines.append(f"{json.dumps(name)}: {json.dumps(part)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def peers(rows) -> str:
    """Largest gains of pink and mink."""
    lines = []
    for r in rows:
        lines.append(
            [r["robot"], r["library"], r["delay"], f"{r['predicted']:.4f}", f"{r['measured']:.4f}"]
            + [f"{r['predicted'] / r['measured']:.3f}", f"{r['recommended']:.4f}"]
            + ["none" if r[k] < ZERO else f"{r[k]:.1e}" for k in ("rise", "back")]
            + [f"{100 * r['back_near']:.0f} %"]
        )
    head = ["robot", "library", "delay", "largest z, cnclik", "measured", "ratio", "recommended z"]
    return markdown([*head, "error rises", "a joint goes back", "the same at 0.9 of the largest"], lines, left=2)


def tools(rows) -> str:
    """Settings as they were run."""
    lines = []
    for r in rows:
        ends = ["ran away"] + [""] * 2 if r["overshoot"] is None else [
            f"{100 * r['overshoot']:.1f} %",
            "no" if r["settled"] is None else f"{r['settled']:.3g}",
            "" if r["tool"] not in ("pink", "mink", "Placo") else f"{100 * r['posture']:.2g} %",
        ]  # fmt: skip
        promised = "" if r["promised"] is None else f"{r['promised']:.3g}"
        lines.append([r["tool"], r["case"], r["way"], f"{r['set']:.4g}", promised, *ends])
    head = ["tool", "drives", "set", "gain", "2 % promised [s]", "overshoot", "2 % after [s]", "left to the posture"]
    return markdown(head, lines, left=3)


def advice(rows) -> str:
    """What was recommended and what it did, cell by cell."""
    lines = []
    for r in rows:
        named = [r["robot"], r["servo"], r["rate"], r["delay"], r["world"] or "–", r["feedback"]]
        if "not fitted" in r:
            lines.append([*named, "not fitted", *[""] * 4])
            continue
        cells = [cell for name in ("recommended", "unknown") for cell in _lane(r.get(name))]
        share = f"{r['recommended']['alpha'] / r['best']:.2f}" if r.get("best") else ""
        lines.append([*named, *cells, share])
    head = ["robot", "servo", "rate [Hz]", "delay", "besides", "feedback", "recommended", "beyond", "nothing said"]
    return markdown([*head, "beyond", "of best"], lines, left=2)


def _lane(lane) -> list:
    if lane is None:
        return ["none", ""]
    over = np.inf if lane["over"] is None else lane["over"]
    return [f"{lane['alpha']:.3g}", "unstable" if lane["unstable"] else f"{100 * max(over, 0.0):.1f} %"]


PAGE = """# Do recommended gains hold in pink, mink and on simulated robots?

`python -m tests.bench.loops` (extra `peers`; {minutes:.0f} minutes of one core); loops.json holds all. \
MuJoCo {mujoco}, mink {mink}, pink {pin-pink}, Pinocchio {pin}, JAX {jax}.

## pink and mink

They have the limit that cnclik names: within {off:.2g} % with 0 to 5 samples of delay. The recommended gain is quiet \
(no rise of the error, no joint that goes back) in {quiet} of {loops} loops.

{peers}
## Settings for other tools

`python -m tests.bench.loops --only tools` applies each of `Gains.elsewhere` to a Panda whose joints follow
through the drive of the case. pink, mink and Placo run themselves, with a posture task 0.2 rad away along the null
space. Isaac Lab's differential IK, MoveIt Servo's pose tracking and a loop around servoj are copies after their
sources and manuals. Placo brings its own Pinocchio: its rows need an environment in which it was installed last.
"Nothing said": the robot has the assumed drives. Isaac Lab has no row if there is no gain for it, as with dead time
alone. A posture task with its default gain of 1 diverges, and a servoj loop that begins at the measured joints does
not arrive.

{tools}
## What the advice is worth on simulated robots

`python -m tests.bench.loops --only advice` runs four arms in MuJoCo. Servos are "position 5, 10, 50" with that
k_p/k_v [1/s] (5 and 10 as the UR5e and Panda of the menagerie), servos of ζ = 0.4, and velocity servos with k_v of
400 and 40 and with integral parts. Some cells add dry friction of 1 and 0.2 N m and viscous friction; encoders of 15
bits; torque of at most 80 and 15 N m; motion that is 0.95 or 1.08 of its command; or several of these. Each cell
records a step of all joints (1.2 s, at most 200 rows), fits the drive, and runs a step of 3 cm and 60 mrad for 3 s.
*Beyond*: the overshoot of the tip as a share of the step. *Of best*: the recommended gain over the largest with at
most 1 % overshoot. *Nothing said*: the gain that is recommended for unknown drives. With rebased feedback no gain is
given then, and none if the motion differs from its command (a gain other than 1), because the difference adds up from
step to step.

- **Recommended from a recorded step of all joints**: of {cells} cells {recommended named} have a gain; \
{recommended unstable} of these are unstable, {recommended over 5 %} go beyond the target by more than {much:.0f} %; \
the gain is {median of best:.2f} of the best one without overshoot in the median.
- In the other {silent} cells no gain is named, as with rebased feedback, or where the log leaves a drive open. \
In {calm where none is named} of these one \
of {any} gains up to alpha·Ts = 1 was stable, arrived and did not overshoot.
- **With nothing said of the drives**: {unknown named} of {cells} cells have a gain (rebased feedback has none); \
{unknown unstable} unstable, {unknown over 5 %} beyond by more than {much:.0f} %.

{advice}"""


def page(found) -> str:
    """The README of what was measured."""
    rows = {kind: [r for n, part in found.items() if n.endswith(kind) for r in part["rows"]]
            for kind in ("peers", "tools", "advice")}  # fmt: skip
    numbers = figures(rows["advice"]) | found["machine"] | {"much": 100 * MUCH, "any": len(ANY)}
    numbers["silent"] = numbers["cells"] - numbers["recommended named"]
    numbers["minutes"] = sum(part.get("seconds", 0) for part in found.values()) / 60
    numbers["off"] = 100 * max(abs(r["predicted"] / r["measured"] - 1) for r in rows["peers"])
    numbers |= {"quiet": sum(r["quiet"] for r in rows["peers"]), "loops": len(rows["peers"])}
    return PAGE.format_map(numbers | {kind: globals()[kind](plain(some)) for kind, some in rows.items()})


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.loops", description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="*", choices=list(POSTURES), default=list(POSTURES))
    parser.add_argument("--fresh", action="store_true", help="measure again what is there already")
    parser.add_argument("--only", default="", help="parts whose names end so, such as advice or tools")
    parser.add_argument("--page", action="store_true", help="only write the page again")
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "loops.json"
    found = json.loads(file.read_text()) if file.exists() else {}
    for name, measure in () if args.page else parts(args.robots):
        if (name in found and not args.fresh) or not name.endswith(args.only):
            continue
        begun = time.process_time()
        rows = measure()
        found[name] = {"seconds": round(time.process_time() - begun, 1), "rows": rows}
        found["machine"] = timing.machine()
        for library in ("mujoco", "mink", "pin-pink", "pin"):
            found["machine"][library] = importlib.metadata.version(library)
        print(f"{name}: {found[name]['seconds']} s", file=sys.stderr, flush=True)
        kept = file.with_suffix(".part")
        kept.write_text(text(found), encoding="utf-8")
        kept.replace(file)
    (args.out / "README.md").write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
