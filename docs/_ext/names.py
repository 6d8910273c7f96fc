"""The table of every public name on the API's first page: a link, and the first sentence of its docstring."""

import importlib
import inspect
import re


def rows(folder):
    """(whole name, first sentence about it) of everything that the API's pages describe."""
    for page in sorted(folder.glob("*.md")):
        module, lines = "cnclik", page.read_text(encoding="utf-8").splitlines()
        for k, line in enumerate(lines):
            if said := re.match(r"\.\. currentmodule:: (\S+)", line):
                module = said[1]
            elif said := re.match(r"\.\. (auto\w+|py:data):: (\S+)", line):
                obj = getattr(importlib.import_module(module), said[2])
                text = inspect.getdoc(obj) or "" if said[1] != "py:data" else next(filter(_is_text, lines[k + 1 :]))
                yield f"{module}.{said[2]}", re.split(r"(?<=\.)\s(?=[A-Z])", " ".join(text.split("\n\n")[0].split()))[0]


def _is_text(line) -> bool:
    return bool(line.strip()) and not line.startswith("..")


def listed(app, docname, source):
    if docname == "api/index":
        each = sorted(rows(app.srcdir / "api"), key=lambda row: row[0].lower())
        public = importlib.import_module("cnclik").__all__  # a result's class is imported from its module
        called = {n: f"ck.{n[7:]}" if n.count(".") < 3 and n.split(".")[1] in public else n for n, _ in each}
        text = [f"| {{py:obj}}`{called[n]} <{n}>` | {about.replace('|', chr(92) + '|')} |" for n, about in each]
        source[0] += "\n".join(["", "## Every name", "", "| name | what it is |", "| --- | --- |", *text, ""])


def setup(app):
    app.connect("source-read", listed)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
