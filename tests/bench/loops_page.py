"""The tables and the figure of `tests.bench.loops`, from what it measured."""

import json

import matplotlib.pyplot as plt
import numpy as np

from cnclik.measure.files import markdown, plain
from cnclik.show import style
from tests.bench.loops_advice import ANY, MUCH, figures
from tests.bench.loops_words import ADVICE, CALM, FINDINGS, FINE, LAG, METHOD, NAMES, REBASED, TOOLS

MODELS = ("kinematic", "delay", "lag", "second order", "modes", "fitted", "together", "lower", "equations")
CLOSE = 0.15  # by which a prediction may be off
ZERO = 5e-6  # share below which is said none


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


def _rows(found, ending) -> list:
    """Rows of all parts whose names end so."""
    return [row for name, part in found.items() if name.endswith(ending) for row in part["rows"]]


def _number(value):
    """From JSON, where ∞ is null."""
    return np.inf if value is None else float(value)


def ratio(cell, model) -> float:
    """Predicted over measured largest gain of a cell; NaN where a model does not speak of it."""
    if model == "equations":
        told = cell["in_time"]["equations"][0]
    elif model == "lower":
        told = min((cell["predicted"][m][0] for m in ("fitted", "together")), key=_number)
    elif model in cell["predicted"]:
        told = cell["predicted"][model][0]
    else:
        return np.nan
    return _number(told) / _number(cell["largest"])


def _said(value, digits=2) -> str:
    if np.isnan(value):
        return ""
    return "∞" if np.isinf(value) else f"{value:.{digits}f}"


def _off(value) -> float:
    """How far a ratio is from 1, either way."""
    return np.abs(np.log(value))


# --- tables -------------------------------------------------------------------------------------------


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


def _first(cells) -> list:
    """The cells of the first table of this kind."""
    return [c for c in cells if c["robot"] == "UR5" and c["rate"] in (500, 100)]


def trial(cells) -> str:
    """The UR5's table: measured largest gains, and what each model says over them."""
    lines = []
    for c in _first(cells):
        said = [_said(ratio(c, m)) for m in MODELS]
        lines.append([c["servo"], c["rate"], c["delay"], f"{_number(c['largest']):.1f}", *said])
    return markdown(["servo", "rate [Hz]", "delay", "measured [1/s]", *MODELS], lines)


def carry(cells, by) -> str:
    """Predicted over measured by servo and rate, or delay: median, and the worst."""
    lines = []
    for servo in dict.fromkeys(c["servo"] for c in cells):
        for value in sorted({c[by] for c in cells}):
            some = [c for c in cells if c["servo"] == servo and c[by] == value]
            line = [servo, value, len(some)]
            for m in MODELS:
                of = np.array([v for c in some if not np.isnan(v := ratio(c, m))])
                line.append(f"{_said(np.median(of))} ({_said(of[np.argmax(_off(of))])})" if len(of) else "")
            lines.append(line)
    return markdown(["servo", {"rate": "rate [Hz]", "delay": "delay"}[by], "cells", *MODELS], lines)


def reason(cell) -> str:
    """Why a fitted drive is off in a cell, by which models are not."""
    off = {m: _off(v) > np.log1p(CLOSE) for m in MODELS if not np.isnan(v := ratio(cell, m))}
    much = ratio(cell, "fitted") > 1
    if off["equations"]:
        return "not linear: the coupled linear equations are off as well"
    if cell["servo"].startswith("position"):
        return "coupled inertia: the direction that swings is heavier than any joint" if much else "coupled inertia"
    if much:
        return "coupled inertia: in the recorded step other joints give way, which is read as less dead time or lag"
    return "MuJoCo's step: it moves half a step of the physics earlier than a held command does"


def beyond(cells) -> str:
    """Where the fitted drive is off by more than CLOSE."""
    lines = []
    for c in cells:
        value = ratio(c, "fitted")
        if _off(value) > np.log1p(CLOSE):
            said = [_said(v) for v in (value, *(ratio(c, m) for m in ("lower", "modes", "equations")))]
            lines.append([c["robot"], c["servo"], c["rate"], c["delay"], *said, reason(c)])
    head = ["robot", "servo", "rate [Hz]", "delay", "fitted", "lower", "modes", "equations", "why"]
    return markdown(head, lines, left=2) if lines else "None.\n"


def calm(cells) -> str:
    """Fastest gains without overshoot."""
    lines = []
    for servo in dict.fromkeys(c["servo"] for c in cells):
        best = "lag" if servo.startswith("velocity") else "second order"
        for rate in sorted({c["rate"] for c in cells}):
            some = [c for c in cells if c["servo"] == servo and c["rate"] == rate]
            seen = np.array([_number(c["calm"]) for c in some])
            line = [servo, rate, f"{seen.min():.3g} – {seen.max():.3g}"]
            for told in (
                [_number(c["predicted"]["delay"][1]) for c in some],
                [_number(c["predicted"][best][1]) for c in some],
                [_number(c["predicted"]["fitted"][1]) for c in some],
                [_number(c["predicted"][best][2]) for c in some],
                [_number(c["in_time"]["drive"][1]) for c in some],
                [_number(c["in_time"]["equations"][1]) for c in some],
            ):
                of = np.array(told) / seen
                line.append(f"{np.median(of):.2f} ({of[np.argmax(_off(of))]:.2f})")
            lines.append(line)
    head = ["servo", "rate [Hz]", "measured [1/s]", "delay", "own drives", "fitted", "recommended", "drives in time"]
    return markdown([*head, "equations in time"], lines)


def feedback(rows) -> str:
    """Largest gains and lags for each feedback."""
    lines = []
    for r in rows:
        largest, told = _number(r["largest"]), _number(r["predicted"])
        share = _said(told / largest) if 0 < largest < np.inf else ""
        named = [r["robot"], r["servo"], r["feedback"], r["delay"]]
        lags = [f"{1e3 * _number(v):.1f}" for v in (r["lag"], r["lag_predicted"], 1 / r["alpha"], r["late"])]
        lines.append([*named, _said(largest, 1), _said(told, 1), share, f"{r['alpha']:.3g}", *lags])
    head = ["robot", "servo", "feedback", "delay", "largest measured", "predicted", "ratio", "at alpha", "lag [ms]"]
    return markdown([*head, "predicted", "1/alpha", "late by"], lines, left=3)


def finer(rows) -> str:
    lines = []
    for r in rows:
        said = [_said(r[m] / _number(r["largest"])) for m in ("lag", "modes")]
        lines.append([r["robot"], r["servo"], r["delay"], f"{_number(r['largest']):.1f}", *said])
    return markdown(["robot", "servo", "delay", "measured [1/s]", "lag", "modes"], lines, left=2)


def checked(rows) -> str:
    """In words: what the second looks gave."""
    sides = [[_number(v) for v in r["around"]] for r in rows if "around" in r]
    right = sum(low < 0 < high for low, high in sides)
    return (
        f"- cnclik's own nonlinear loop (`solve`) through the same drives: the error falls at 0.95 and grows at "
        f"1.05 times the largest gain in {right} of {len(sides)} loops.\n"
    )


def advice(rows) -> str:
    """What was recommended and what it did, cell by cell."""
    lines = []
    for r in rows:
        named = [r["robot"], r["servo"], r["rate"], r["delay"], r["world"] or "–", r["feedback"]]
        if "not fitted" in r:
            lines.append([*named, "not fitted", *[""] * 4])
            continue
        told = [t for name in ("recommended", "unknown") for t in _lane(r.get(name))]
        share = _said(r["recommended"]["alpha"] / r["best"]) if r.get("best") else ""
        lines.append([*named, *told, share])
    head = ["robot", "servo", "rate [Hz]", "delay", "besides", "feedback", "recommended", "beyond", "nothing said"]
    return markdown([*head, "beyond", "of best"], lines, left=2)


def begun_at(rows) -> str:
    """Whether a gain is named of rebased feedback, and whether one is stable."""
    lines = []
    for r in rows:
        calm = [f"{alpha / r['rate']:.2g}" for alpha in r.get("calm", ())]
        lines.append([r["robot"], r["delay"], *_lane(r.get("recommended")), ", ".join(calm)])
    return markdown(["robot", "delay", "recommended", "beyond", "else calm at alpha·Ts"], lines)


def _lane(lane) -> list:
    if lane is None:
        return ["none", ""]
    over = _number(lane["over"])
    return [f"{lane['alpha']:.3g}", "unstable" if lane["unstable"] else f"{100 * max(over, 0.0):.1f} %"]


def advised(rows) -> str:
    """In a sentence each: what the advice is worth."""
    f = figures(rows)
    return (
        f"- **Recommended from a recorded step of all joints**: of {f['cells']} cells {f['recommended named']} have a "
        f"gain; {f['recommended unstable']} of these are unstable, {f['recommended over 5 %']} go beyond the target by "
        f"more than {100 * MUCH:.0f} %; the gain is {f['median of best']:.2f} of the best one without overshoot in the "
        f"median.\n"
        f"- In the other {f['cells'] - f['recommended named']} cells, all with rebased feedback, no gain is named. In "
        f"{f['calm where none is named']} of these one of {len(ANY)} gains up to alpha·Ts = 1 was stable, arrived and "
        f"did not overshoot.\n"
        f"- **With nothing said of the drives**: {f['unknown named']} of {f['cells']} cells have a gain (rebased "
        f"feedback has none); {f['unknown unstable']} unstable, {f['unknown over 5 %']} beyond by "
        f"more than {100 * MUCH:.0f} %.\n"
    )


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


# --- the page -----------------------------------------------------------------------------------------


def figure(cells, path):
    """Predicted over measured largest gain against delay, a panel per servo."""
    shown = ("kinematic", "delay", "lag", "second order", "modes", "lower")
    servos = list(dict.fromkeys(c["servo"] for c in cells))
    with style.style():
        drawn, panels = plt.subplots(1, len(servos), figsize=(style.PAGE, 2.5), sharey=True)
        for panel, servo in zip(panels, servos, strict=True):
            delays = sorted({c["delay"] for c in cells})
            panel.axhspan(1 / (1 + CLOSE), 1 + CLOSE, color="0.9", zorder=0)
            panel.axhline(1, **style.GUIDE)
            for k, model in enumerate(shown):
                values = [(delays.index(c["delay"]), ratio(c, model)) for c in cells if c["servo"] == servo]
                values = [(i, v) for i, v in values if np.isfinite(v)]
                if values:
                    at, of = np.array(values).T
                    look = style.series(k, linestyle="none", markersize=3, markerfacecolor="none")
                    panel.plot(at + 0.11 * (k - 2.5), of, label=model, **look)
            panel.set(
                xticks=range(len(delays)), xticklabels=delays, xlabel="delay [samples]", yscale="log", title=servo
            )
            panel.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
            panel.minorticks_off()
        panels[0].set_ylabel("predicted over measured\nlargest gain")
        handles = {label: h for p in panels for h, label in zip(*p.get_legend_handles_labels(), strict=True)}
        drawn.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(shown))
        style.save(drawn, path, {"Title": "Predicted over measured largest gain against delay"})


def summary(found, cells) -> str:
    """What is true and what is not, with the numbers of this run."""
    said = []
    if "peers" in found:
        rows = found["peers"]["rows"]
        off = 100 * max(abs(r["predicted"] / r["measured"] - 1) for r in rows)
        quiet = sum(r["quiet"] for r in rows)
        said.append(
            f"- **pink and mink have the limit that cnclik names**: they agree within {off:.2g} % with 0 to 5 "
            f"samples of delay, and its recommended gain is quiet (no rise of the error, no joint that goes back) in "
            f"{quiet} of {len(rows)} loops."
        )
    for some, words in ((_first(cells), "in the UR5's table below"), (cells, "in all cells")):
        told = []
        for m in MODELS:
            of = np.array([v for c in some if not np.isnan(v := ratio(c, m))])
            within = np.sum(_off(of) <= np.log1p(CLOSE))
            told.append(f"{m} {within} of {len(of)}")
        said.append(f"- Predicted largest gain within {100 * CLOSE:.0f} % of MuJoCo's, {words}: {', '.join(told)}.")
    return "\n".join(said) + "\n"


def write(found, folder) -> None:
    """README.md and the figure of what there is."""
    cells = _rows(found, " Hz")
    m = found["machine"]
    head = (
        "# Do recommended gains hold in pink, mink and on simulated robots?\n\nThe simulated robots have known servos, "
        "delays and rates. How accurate is each model of their drives?\n\n"
        f"`python -m tests.bench.loops` (extra `peers`; {sum(p.get('seconds', 0) for p in found.values()) / 60:.0f} "
        f"minutes of one core); loops.json holds all. MuJoCo {m['mujoco']}, mink {m['mink']}, pink {m['pin-pink']}, "
        f"Pinocchio {m['pin']}, JAX {m['jax']}.\n"
    )
    made = [head, f"## What is true\n\n{summary(found, cells)}{FINDINGS}"]
    if "peers" in found:
        made.append(f"## pink and mink\n\n{peers(found['peers']['rows'])}")
    if rows := plain(_rows(found, "tools")):
        made.append(f"## Settings for other tools\n\n{TOOLS}\n{tools(rows)}")
    if rows := _rows(found, ", advice"):
        made.append(f"## What the advice is worth on simulated robots\n\n{ADVICE}\n{advised(rows)}\n{advice(rows)}")
    if rows := _rows(found, ", rebased"):
        made.append(f"### Position commands that begin at the measured joints\n\n{REBASED}\n{begun_at(rows)}")
    if cells:
        figure(cells, folder / "ratios.png")
        made.append(f"## MuJoCo\n\n{NAMES}\n{METHOD}\n![Predicted over measured largest gain](ratios.png)\n")
        made.append(f"### The UR5, cell by cell\n\n{trial(cells)}")
        made.append(
            f"### How far each model carries: median (worst) of predicted over measured\n\n{carry(cells, 'rate')}"
        )
        made.append(carry(cells, "delay"))
        made.append(f"### Where the fitted drive is off by more than {100 * CLOSE:.0f} %\n\n{beyond(cells)}")
        made.append(f"### Fastest gain without overshoot\n\n{CALM}\n{calm(cells)}")
    if rows := _rows(found, ", feedback"):
        made.append(f"### Feedback, and the lag behind a ramp (100 Hz)\n\n{LAG}\n{feedback(rows)}")
    if rows := _rows(found, ", fine"):
        made.append(f"### Physics in steps of 0.1 ms\n\n{FINE}\n{finer(rows)}")
    if rows := _rows(found, ", checks"):
        made.append(f"### Second looks\n\n{checked(rows)}")
    (folder / "README.md").write_text("\n".join(made), encoding="utf-8")
