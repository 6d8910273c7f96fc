"""Figures of gallery and tutorials have the look of `cnclik.show`."""

import pathlib
import tempfile

ON_START = ("%matplotlib inline", "import look; look.wear(); del look")
KERNEL = f"""c = get_config()
c.IPKernelApp.log_level = "ERROR"
c.InlineBackend.figure_formats = {{"svg"}}
c.IPKernelApp.exec_lines = {list(ON_START)!r}
"""


def wear() -> None:
    """The project's settings, until others are made."""
    import matplotlib

    from cnclik.show.style import COLORS, style

    before = matplotlib.rcParams.copy()
    with style():
        own = {key: value for key, value in matplotlib.rcParams.items() if value != before[key]}
    matplotlib.rcParams.update(own | {"axes.prop_cycle": matplotlib.cycler(color=COLORS)})


def of_project(gallery, name):
    """What sphinx-gallery calls before each script, once matplotlib is as it was."""
    wear()


def kernels() -> str:
    """A folder for IPYTHONDIR, with the configuration of the tutorials' kernels: figures as SVG."""
    folder = pathlib.Path(tempfile.mkdtemp(prefix="cnclik-docs-"))
    profile = folder / "profile_default"
    profile.mkdir()
    (profile / "ipython_kernel_config.py").write_text(KERNEL, encoding="utf-8")
    return str(folder)
