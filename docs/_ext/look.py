"""Figures of gallery and tutorials have the look of `cnclik.show`."""

import pathlib
import tempfile

HELD = []  # contexts end when they are forgotten
ON_START = ("%matplotlib inline", "from cnclik.show.style import style; _look = style(); _look.__enter__()")
KERNEL = f"""c = get_config()
c.IPKernelApp.log_level = "ERROR"
c.InlineBackend.figure_formats = {{"svg"}}
c.IPKernelApp.exec_lines = {list(ON_START)!r}
"""


def of_project(gallery, name):
    """What sphinx-gallery calls before each script, once matplotlib is as it was."""
    from cnclik.show.style import style

    HELD.append(style())
    HELD[-1].__enter__()


def kernels() -> str:
    """A folder for IPYTHONDIR, with the configuration of the tutorials' kernels: figures as SVG."""
    folder = pathlib.Path(tempfile.mkdtemp(prefix="cnclik-docs-"))
    profile = folder / "profile_default"
    profile.mkdir()
    (profile / "ipython_kernel_config.py").write_text(KERNEL, encoding="utf-8")
    return str(folder)
