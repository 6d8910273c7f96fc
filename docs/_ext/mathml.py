"""Formulas as MathML, which browsers draw by themselves: no script, nothing from a network."""

from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

LOG = logging.getLogger(__name__)


def _drawn(node, as_block):
    try:
        return tex2mathml(node.astext(), as_block=as_block)
    except MathError as wrong:
        LOG.warning("a formula has no MathML: %s", wrong, location=node)
        return ""


def inline(translator, node):
    from docutils.nodes import SkipNode

    translator.body.append(f'<span class="math">{_drawn(node, False)}</span>')
    raise SkipNode


def displayed(translator, node):
    from docutils.nodes import SkipNode

    translator.body.append(f'<div class="math">{_drawn(node, True)}</div>')
    raise SkipNode


def setup(app):
    app.add_html_math_renderer("mathml", (inline, None), (displayed, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
