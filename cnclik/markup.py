"""Markup: the colours of figures and pages, and text in them. Loads no other package."""

import html

LEAST_ERROR = 1e-15  # [m, rad] what is below is rounding
BLUE = "#0072B2"  # Okabe & Ito (2008), as all but one of the next: distinguishable with any colour vision
LEVELS = FINE, WARNING, LOST = "#009E73", "#E69F00", "#CC3311"  # the last by Tol (2021); see `status.level`
GENERATOR = '<meta name="generator" content="cnclik">'  # in pages, which are known again by it


def escaped(text) -> str:
    return html.escape(str(text))
