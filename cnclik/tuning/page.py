"""A tuning on one page, in Markdown: the result, the lines for a controller, the figures."""

import math

import numpy as np

from cnclik.measure.files import markdown
from cnclik.quantities import in_samples
from cnclik.record import in_words
from cnclik.tuning.controller import controller_lines
from cnclik.tuning.result import kept_in_words, with_unit

CAPTIONS = {
    "history": "Loss and worst constraint over the evaluations.",
    "error": "Error before and after.",
    "operating": "Operating point on the stability map (spectral radius of the linear loop at the end of the path).",
    "front": "Smaller and larger gains: the loss over the noise gain and over the dead time that the loop tolerates in "
    "addition; filled points keep every constraint.",
    "responses": "Response to a step and a sine (30 samples per period) of 1 mm or 1 mrad around the end of the path, "
    "through the drive; axes with the same response coincide.",
}


def page(tuned, name: str, *, seconds=None, figures=()) -> str:
    """A `Tuned` on one page.

    Args: name: of the loop. seconds: duration of the tuning, or None. figures: names of figures beside the page, of
      CAPTIONS.
    """
    method = f"{tuned.method} with {tuned.stage}" if tuned.method.implicit else str(tuned.method)
    task, stack = tuned.law.task, [name for name, _ in tuned.law.task.tasks]
    what = f"tasks {', '.join(stack)}" if stack else f"task {' '.join(task.names)}"
    loop = f"{method}, {what}, N = {tuned.N} steps of Ts = {1e3 * tuned.Ts:g} ms."
    title = f"# {'Tuned' if tuned.satisfied else 'Not tuned'}: {name}"
    text = [title, "", tuned.why, "", loop, "", markdown(("", ""), _rows(tuned, seconds), left=2)]
    lines = controller_lines(tuned)
    if tuned.satisfied:
        text += ["## For a controller", "", "```python", lines["rate"], "```", ""]
        line = lines["pink_mink"]
        can_run = line.startswith("task")
        text += ["pink and mink:", "", "```python", line, "```"] if can_run else [f"pink and mink: {line}."]
    else:
        text += ["## Nothing for a controller", "", f"The constraints are {kept_in_words(tuned)}."]
    if figures:
        text += ["", "## Figures", "", *(f"![{CAPTIONS[f]}]({f}.png)\n\n{CAPTIONS[f]}\n" for f in figures)]
    return "\n".join(text).rstrip() + "\n"


def _rows(tuned, seconds=None) -> list:
    """[(name, text)]: the result in numbers with their units. Args: as for `page`."""
    before, after = tuned.before, tuned.after
    rows = [
        (p.name, f"{in_words(tuned.values[p.name])}{with_unit(p)} (from {in_words(p.start)})") for p in tuned.parameters
    ]
    beyond = f" (with {before.worst} {100 * before.violation:.3g} % beyond its bound)"
    beyond = "" if before.violation <= 0 else beyond
    removed, removed_before = (_finite(100 * run.correction, " %") for run in (after, before))
    rows += [
        ("loss", f"{tuned.loss}: {_finite(before.loss)} before{beyond}, {_finite(after.loss)} after"),
        *((f"RMS of {name}", said) for name, said in tuned.of_tasks()),
        ("z = alpha·Ts", f"{after.z:.5g} (before {before.z:.5g})"),
        ("spectral radius", f"{_finite(after.radius)} (margin {tuned.margin:g}; before {_finite(before.radius)})"),
        ("error removed per step", f"{removed} (before {removed_before})"),
    ]
    drive = tuned.conditions.drive
    if drive.delay:
        rows.append(("dead time", in_samples(drive.delay, tuned.Ts)))
    if drive.order:
        late = 1e3 * np.max(drive.late_by(tuned.Ts))
        rows.append(("drive", f"{late:.3g} ms behind its command, dead time included; order {drive.order}"))
    if np.isfinite(after.noise_gain):
        room = "any" if np.isinf(after.delay_margin) else f"up to {in_samples(after.delay_margin, tuned.Ts)}"
        rows += [
            ("noise", f"1 mrad RMS of measurement noise moves the joints by {after.noise_gain:.3g} mrad RMS"),
            ("stable with further dead time", room),
        ]
    if after.speed:
        rows.append(("joint velocity", f"{100 * after.speed:.4g} % of the limit at most"))
    rows += [("constraints", kept_in_words(tuned)), ("gradients", f"{tuned.gradient}; {tuned.evaluations} evaluations")]
    if seconds is not None:
        rows.append(("time", f"{seconds:.1f} s, compilation included"))
    return rows


def _finite(value, unit=""):
    return f"{value:.4g}{unit}" if math.isfinite(value) else "not finite"
