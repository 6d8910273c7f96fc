"""Report: one result as one page that opens offline: the answer, its numbers, figures, the moving robot.

The figures are those of the verb. The page is written last, so that a failure loses no result.
"""

import dataclasses
import pathlib
import platform
from collections.abc import Callable

from cnclik import errors
from cnclik.markup import BLUE, GENERATOR, escaped, table
from cnclik.measure.dataset import provenance
from cnclik.show import report_figures
from cnclik.show.output import FigureError
from cnclik.show.viewer import need
from cnclik.show.viewer.page import as_page, seconds
from cnclik.writing import output_folder

MOST_ROWS, SHORT = 60, 8  # largest number of rows of a table, and of a table above the figures


@dataclasses.dataclass(frozen=True, kw_only=True)
class Report:
    """The content of a page."""

    title: str  # what was asked of which robot
    answer: str  # in a sentence
    facts: tuple = ()  # ((name, text), …): numbers with their units
    lines: tuple = ()  # further sentences, below the figures
    tables: tuple = ()  # ((caption, header, rows), …)
    figures: dict[str, tuple[Callable, str]] = dataclasses.field(default_factory=dict)  # as `show.output.draw` has them
    captions: dict = dataclasses.field(default_factory=dict)  # {name of a figure without ending: caption}
    motions: Callable | None = None  # returns one or two `Motion`s; None where nothing moves
    command: str = ""  # the line that makes it again
    dtype: str = "float64"  # of the numbers


def write(report: Report, file) -> None:
    """Write the page. A part that can't be drawn is left out, with a line in its place.

    Raises: FigureError at the end, naming those parts; ArgumentError where the page could not be written.
    """
    file, failed = pathlib.Path(file), {}
    text = page(report, failed)
    with output_folder(file.parent, name="report") as folder:
        folder.write_text(file.name, text)
    if failed:
        what = ", ".join(f"{part} ({reason})" for part, reason in failed.items())
        raise FigureError(f"Not in {file.name}: {what}; all else is.")


def page(report: Report, failed=None) -> str:
    """The page as a text. Args: failed: a dict, to which parts that could not be drawn are added: {part: why}."""
    failed = {} if failed is None else failed
    parts = [f"<h1>{escaped(report.title)}</h1>", f'<p class="answer">{escaped(report.answer)}</p>']
    if report.facts:
        parts.append(_wide(table((), report.facts, left=2)))
    short, long = ([t for t in report.tables if (len(t[2]) <= SHORT) == kind] for kind in (True, False))
    parts += [_table(*one) for one in short]
    parts.append(_moving(report, failed))
    drawn = [_figure(file, *made, report.captions, failed) for file, made in report.figures.items()]
    if drawn:
        parts.append(f'<h2>Figures</h2><div class="figures">{"".join(drawn)}</div>')
    parts += [_table(*one) for one in long]
    if report.lines:
        parts.append(f"<h2>In words</h2><ul>{''.join(f'<li>{escaped(line)}</li>' for line in report.lines)}</ul>")
    parts.append(_again(report))
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">{GENERATOR}{_SHEET}'
    )
    title = f"<title>{escaped(report.title)}</title>"
    body = f"<body><main>{''.join(parts)}</main></body>"
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}{title}</head>{body}</html>\n'


def _wide(text) -> str:
    return f'<div class="wide">{text}</div>'


def _table(caption, header, rows) -> str:
    rows = list(rows)
    more = f"<p>{len(rows) - MOST_ROWS:,} more rows are in the data.</p>" if len(rows) > MOST_ROWS else ""
    return f"<h2>{escaped(caption)}</h2>{_wide(table(header, rows[:MOST_ROWS]))}{more}"


def _figure(file, make, about, captions, failed) -> str:
    name = pathlib.Path(file).stem
    caption = escaped(captions.get(name, name.replace("_", " ")))
    try:
        drawn = report_figures.picture(make, escaped(name), about)
    except Exception as error:  # any failure of a figure leaves out that figure only
        failed[name] = errors.in_a_line(error)
        drawn = f"<p>Not drawn: {escaped(failed[name])}</p>"
    return f"<figure>{drawn}<figcaption>{caption}</figcaption></figure>"


def _moving(report, failed) -> str:
    """The moving robot in a frame of its own, and what its colours mean."""
    if report.motions is None:
        return ""
    if not need.has_viser():
        return (
            f'<p class="note">The moving robot is left out, as it takes the extra viewer: {escaped(need.INSTALL)}</p>'
        )
    try:
        motions = list(report.motions())
        inner = as_page(motions).replace("&", "&amp;").replace('"', "&quot;")
    except Exception as error:  # any failure of meshes or viser leaves out the robot only
        failed["the moving robot"] = errors.in_a_line(error)
        return f'<p class="note">The moving robot could not be drawn: {escaped(failed["the moving robot"])}</p>'
    names = [f"{'in grey' if k else 'in blue'}: {escaped(m.name)}" for k, m in enumerate(motions)]
    who = f"{'; '.join(names)}. " if len(motions) > 1 else ""
    pace = _pace(motions, seconds(motions))
    targets = "Targets are green where they are reached, orange with the nearest pose, red without joint values."
    way = "The way of the tip is green where steps are OK, orange with a warning, red in an unstable loop."
    said = f"{who}{pace}{targets if motions[0].unit == 'target' else way}"
    frame = f'<iframe title="the moving robot" loading="lazy" srcdoc="{inner}"></iframe>'
    note = f'<p class="note">{said} Drag to turn, scroll to zoom.</p>'
    return f'<section class="moving"><h2>The robot</h2>{frame}{note}</section>'


def _pace(motions, shown) -> str:
    """The speed of the animation, where it is not real time."""
    if motions[0].unit == "target":
        return "One target after the other. "
    factor = max(m.t[-1] - m.t[0] for m in motions) / shown
    if 0.95 < factor < 1.05 or factor == 0:
        return ""
    return f"Played {factor:.2g} times as fast as it was. " if factor > 1 else f"Slowed down {1 / factor:.2g} times. "


def _again(report) -> str:
    about = provenance(report.dtype) | {"python": platform.python_version(), "system": platform.platform()}
    command = f"<pre>{escaped(report.command)}</pre>" if report.command else ""
    return f"<h2>To repeat it</h2>{command}{_wide(table((), about.items(), left=2))}"


_SHEET = (
    """<style>
:root{color-scheme:light dark;--ink:#1b1f23;--paper:#fff;--soft:#6a737d;--edge:#d8dde2;--line:"""
    + BLUE
    + """}
@media(prefers-color-scheme:dark){:root{--ink:#e3e6e9;--paper:#16191c;--soft:#9aa4ad;--edge:#3a4148}}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",sans-serif}
main{max-width:62rem;margin:0 auto;padding:1rem 1rem 3rem}
h1{font-size:1.5rem;line-height:1.25;margin:.6rem 0;overflow-wrap:anywhere}
h2{font-size:1.1rem;margin:2rem 0 .5rem}
.answer{font-size:1.15rem;border-left:.3rem solid var(--line);padding:.3rem 0 .3rem .8rem;margin:1rem 0}
.wide{overflow-x:auto;font-size:.92rem;font-variant-numeric:tabular-nums}
.note,figcaption{color:var(--soft);font-size:.85rem}
pre{white-space:pre-wrap;overflow-wrap:anywhere;font-size:.85rem;
border:1px solid var(--edge);border-radius:.3rem;padding:.6rem}
iframe{width:100%;height:30rem;border:1px solid var(--edge);border-radius:.3rem;background:#fff}
.figures{display:flex;flex-wrap:wrap;gap:1rem;align-items:flex-start}
figure{margin:0;max-width:100%}
figcaption{max-width:24rem}
ul{padding-left:1.2rem}
li{margin:.3rem 0}
figure img{display:block;max-width:100%;height:auto;background:#fff;
border:1px solid var(--edge);border-radius:.3rem}
figure .pixels{width:43rem}
@media(max-width:40rem){iframe{height:22rem}body{font-size:15px}}
@media print{.moving{display:none}main{max-width:none;padding:0}figure,tr{break-inside:avoid}.wide{overflow:visible}
:root{--ink:#000;--paper:#fff;--soft:#444;--edge:#bbb}}
</style>"""
)
