"""The pages' own examples: a build runs them as the tests do (`tests/test_docs.py`), before it writes a page."""

import os
import pathlib
import subprocess
import sys

from sphinx.errors import ExtensionError
from sphinx.util import logging

LOG = logging.getLogger(__name__)
ROOT = pathlib.Path(__file__).parents[2]


def run(app):
    if os.environ.get("CNCLIK_DOCS_RUN", "all") != "all":
        return
    LOG.info("running the examples of README and docs/*.md")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        os.environ.get("CNCLIK_DOCS_WORKERS", "2"),
        "tests/test_docs.py",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise ExtensionError(f"an example of a page failed:\n{done.stdout[-4000:]}{done.stderr[-2000:]}")
    LOG.info(done.stdout.strip().splitlines()[-1])


def setup(app):
    app.connect("builder-inited", run)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
