"""What a page needs on a phone: long cells keep a width; wide figures and drawn tables scroll by themselves."""

import pathlib
import re
import struct

from docutils import nodes

LONG, WIDE = 40, 1600  # letters of a cell; pixels of a figure, whose text would be too small in one column
OPTION = 30  # letters of an option that does not break, which it would after a hyphen
DRAWN = re.compile(r"^.*(?:[│┃└├]|\S {2,}\S+ {2,}\S).*$", re.MULTILINE)  # lines of a table or a tree in a terminal
FITS, SENTENCE = 59, 110  # letters of a line on a phone; of a row whose last column is a sentence


def width(file) -> int:
    """Pixels of a PNG; 0 of other files."""
    head = file.read_bytes()[:24] if file.suffix == ".png" and file.exists() else b""
    return struct.unpack(">I", head[16:20])[0] if head[:4] == b"\x89PNG" else 0


def mark(app, doctree):
    for cell in doctree.findall(nodes.entry):
        if cell.parent.index(cell) and len(cell.astext()) > LONG:
            cell["classes"].append("long")
    for block in doctree.findall(nodes.literal_block):
        if any(FITS < len(line) < SENTENCE for line in DRAWN.findall(block.astext())):
            block["classes"].append("drawn")
    for code in doctree.findall(nodes.literal):
        if code.astext().startswith("-") and len(code.astext()) < OPTION:
            code["classes"].append("option")
    for image in doctree.findall(nodes.image):
        if width(pathlib.Path(app.srcdir) / image["uri"]) > WIDE:
            image["classes"].append("wide")


def setup(app):
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
