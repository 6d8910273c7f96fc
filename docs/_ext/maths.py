"""Formulas by MathJax from one file of the site itself: nothing comes from a network, any browser draws them alike."""

import importlib.util
import pathlib
import shutil

FILE = "tex-svg.js"  # draws glyphs as paths: no fonts beside it


def copy(app, exception):
    """The file out of the package that brings MathJax."""
    if exception is None and app.builder.format == "html":
        package = pathlib.Path(importlib.util.find_spec("sphinx-mathjax-offline").origin).parent
        shutil.copy2(package / "static" / "mathjax" / FILE, pathlib.Path(app.outdir) / "_static" / FILE)


def setup(app):
    app.setup_extension("sphinx.ext.mathjax")
    app.config.mathjax_path = FILE
    app.connect("build-finished", copy, priority=100)  # before links are looked at
    return {"parallel_read_safe": True, "parallel_write_safe": True}
