"""Pages of `results/` in the site.

Pages link them as they lie in the repository (`../results/plane/README.md`), so that the same link works there; Sphinx
reads nothing outside of its folder. So the pages and their pictures are copied to `docs/results`, and links lead there.
"""

import pathlib
import re
import shutil

ROOT = pathlib.Path(__file__).parents[2]
KEPT = (".md", ".png", ".svg")


def copy(app, config):
    """`results/**` that a page may show, as `docs/results`; what has not changed is left alone."""
    source, copies = ROOT / "results", pathlib.Path(app.srcdir) / "results"
    found = {p.relative_to(source) for p in source.rglob("*") if p.suffix in KEPT and "data.zarr" not in p.parts}
    found -= {
        name for name in found if name.suffix == ".md" and not (source / name).read_text("utf-8").startswith("# ")
    }
    for old in [p for p in copies.rglob("*") if p.is_file()] if copies.exists() else ():
        if old.relative_to(copies) not in found:
            old.unlink()
    for name in found:
        to = copies / name
        to.parent.mkdir(parents=True, exist_ok=True)
        if not to.exists() or to.stat().st_mtime < (source / name).stat().st_mtime:
            shutil.copy2(source / name, to)


def lead(app, docname, source):
    """Links to the copies, and from them back to pages; to the gallery as it is built."""
    if docname.startswith("results/"):
        source[0] = re.sub(r"\]\(((?:\.\./)+)docs/", r"](\1", source[0])
    else:
        source[0] = re.sub(r"\]\(((?:\.\./)*)\.\./results/", r"](\1results/", source[0])
        source[0] = source[0].replace("](gallery/GALLERY_HEADER.rst)", "](gallery-pages/index.rst)")


def setup(app):
    app.connect("config-inited", copy)
    app.connect("source-read", lead)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
