"""Markup: pieces of pages, made by hand: escaped text, tables, and the plot of an error that a notebook shows.

Styles stand in the elements: what a notebook shows has no sheet of its own. Loads NumPy alone.
"""

import html

import numpy as np

_CELL = "padding:0.15em 0.6em;border-bottom:1px solid rgba(128,128,128,0.3);text-align:"
WIDTH, HEIGHT = 420, 170  # of a plot [px]
_LEFT, _RIGHT, _TOP, _BELOW = 52, 8, 8, 34
LEAST_ERROR = 1e-15  # [m, rad] what is below is rounding
MOST_POINTS = 400
BLUE = "#0072B2"  # Okabe & Ito (2008), as all but one of the next: distinguishable with any colour vision
LEVELS = FINE, WARNING, LOST = "#009E73", "#E69F00", "#CC3311"  # the last by Tol (2021); see `status.level`
GENERATOR = '<meta name="generator" content="cnclik">'  # in pages, which are known again by it


def escaped(text) -> str:
    return html.escape(str(text))


def table(header, rows, *, left=1) -> str:
    """A table; the first `left` columns are set left, the others right. No header where that is ()."""

    def line(cells, tag):
        sides = ("left" if i < left else "right" for i in range(len(cells)))
        made = (f"<{tag} style='{_CELL}{side}'>{escaped(c)}</{tag}>" for c, side in zip(cells, sides, strict=True))
        return f"<tr>{''.join(made)}</tr>"

    head = f"<thead>{line(header, 'th')}</thead>" if header else ""
    body = "".join(line(row, "td") for row in rows)
    return f"<table style='border-collapse:collapse'>{head}<tbody>{body}</tbody></table>"


def error_plot(t, size, level) -> str:
    """An SVG of an error (K,) over time (K,) [s] on a logarithmic scale, and below it marks in the colours of LEVELS.

    Args: level: (K,) integers, places in LEVELS; 0 has no mark.
    """
    t, size, level = (np.asarray(v) for v in (t, size, level))
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST_POINTS)).round().astype(int))
    # What is left out counts by its worst.
    size, level = np.where(np.isfinite(size), size, 0.0), level.copy()
    size[some], level[some] = np.maximum.reduceat(size, some), np.maximum.reduceat(level, some)
    known = size[np.isfinite(size) & (size > LEAST_ERROR)]
    low, high = (np.floor(np.log10(known.min())), np.ceil(np.log10(known.max()))) if known.size else (-1, 0)
    high = max(high, low + 1)
    wide, tall = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BELOW
    x = _LEFT + wide * (t - t[0]) / max(float(t[-1] - t[0]), 1e-300)

    def height(value):
        return _TOP + tall * (high - np.log10(np.clip(value, 10.0**low, 10.0**high))) / (high - low)

    parts = []
    for decade in np.unique(np.linspace(low, high, min(int(high - low), 4) + 1).round()):
        y = height(10.0**decade)
        parts.append(f"<path d='M{_LEFT} {y:.1f}h{wide}' stroke='#888' stroke-opacity='0.3'/>")
        parts.append(f"<text x='{_LEFT - 6}' y='{y + 4:.1f}' text-anchor='end'>1e{decade:.0f}</text>")
    shown = [i for i in some if np.isfinite(size[i]) and size[i] > LEAST_ERROR]
    points = " ".join(f"{x[i]:.1f},{height(size[i]):.1f}" for i in shown)
    parts.append(f"<polyline points='{points}' fill='none' stroke='{BLUE}' stroke-width='1.5'/>")
    for i in some[level[some] > 0]:
        fill = LEVELS[level[i]]
        parts.append(f"<rect x='{x[i]:.1f}' y='{HEIGHT - _BELOW + 2}' width='2' height='4' fill='{fill}'/>")
    for place, anchor, value in ((x[0], "start", t[0]), (x[-1], "end", t[-1])):
        parts.append(f"<text x='{place:.1f}' y='{HEIGHT - 14}' text-anchor='{anchor}'>{value:.4g} s</text>")
    parts.append(f"<text x='{_LEFT + wide / 2}' y='{HEIGHT - 3}' text-anchor='middle'>‖e‖ [m, rad] over time</text>")
    look = "font:11px sans-serif;max-width:100%"
    return (
        f"<svg viewBox='0 0 {WIDTH} {HEIGHT}' width='{WIDTH}' height='{HEIGHT}' style='{look}' fill='currentColor' "
        f"role='img' aria-label='error over time'>{''.join(parts)}</svg>"
    )
