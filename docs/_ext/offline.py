"""What is looked at once the pages are written: links lead somewhere, and nothing is loaded from a network."""

import html.parser
import pathlib
import urllib.parse

from sphinx.errors import ExtensionError

LOADING = {"script": "src", "img": "src", "source": "src", "iframe": "src", "video": "src", "link": "href"}


class Page(html.parser.HTMLParser):
    """Names to which one can jump, links, and what a browser loads."""

    def __init__(self, text):
        super().__init__()
        self.names, self.links, self.loaded = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        said = dict(attributes)
        self.names |= {said[key] for key in ("id", "name") if said.get(key)}
        if tag == "a" and said.get("href"):
            self.links.append(said["href"])
        if tag in LOADING and said.get(LOADING[tag]) and said.get("rel") not in ("canonical", "prev", "next"):
            self.loaded.append(said[LOADING[tag]])


def faults(folder) -> list:
    """What is wrong with the pages of a folder, one line each."""
    folder = pathlib.Path(folder).resolve()
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    wrong = []
    for path, page in pages.items():
        name = path.relative_to(folder)
        for address in page.loaded:
            if urllib.parse.urlsplit(address).scheme in ("http", "https") or address.startswith("//"):
                wrong.append(f"{name} loads {address}")
        for address in (*page.links, *page.loaded):
            parts = urllib.parse.urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            to = (path.parent / urllib.parse.unquote(parts.path)).resolve() if parts.path else path
            if not to.exists():
                wrong.append(f"{name} links {address}, which is not there")
            elif parts.fragment and to in pages and urllib.parse.unquote(parts.fragment) not in pages[to].names:
                wrong.append(f"{name} links {address}, a place which is not there")
    return wrong


def look(app, exception):
    if exception is None and app.builder.name == "html":
        wrong = faults(app.outdir)
        if wrong:
            raise ExtensionError("broken pages:\n" + "\n".join(wrong[:100]))


def setup(app):
    app.connect("build-finished", look)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
