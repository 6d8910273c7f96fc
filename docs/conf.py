"""The site: `python -m sphinx -W --keep-going -b html docs site`.

All examples are run. `CNCLIK_DOCS_RUN=0` runs none: pages, API and links alone, in a minute; `CNCLIK_DOCS_RUN=site`
runs those of tutorials and gallery, where the tests have run the pages' own.
"""

import os
import pathlib
import sys
import warnings

HERE = pathlib.Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]
# Kernels of the tutorials import what is documented, not what may be installed, and `look`.
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(HERE.parent), str(HERE / "_ext"), os.environ.get("PYTHONPATH", "")]
).rstrip(os.pathsep)

import look  # noqa: E402

from cnclik.version import __version__  # noqa: E402

RUN = os.environ.get("CNCLIK_DOCS_RUN", "all") != "0"

project = "cnclik"
author = "The cnclik developers"
copyright = "The cnclik developers, Apache-2.0"
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "docstrings",
    "maths",
    "evidence",
    "examples",
    "names",
    "narrow",
    "offline",
]
exclude_patterns = [
    "_ext",
    "_static",
    "gallery/*",
    *(f"gallery-pages/*.{kind}" for kind in ("ipynb", "py", "zip", "json")),
]
nitpicky = False

# Pages
source_suffix = {".md": "myst-nb", ".rst": "restructuredtext"}
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
highlight_language = "text"  # a fence without a language is what a terminal shows
os.environ["IPYTHONDIR"] = look.kernels()
nb_execution_mode = "force" if RUN else "off"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_merge_streams = True

# API
autodoc_member_order = "bysource"
default_role = "py:obj"  # `name` in a docstring is code, and a link where it is known
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_class_signature = "separated"
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Fields", "params_style")]
add_module_names = False
toc_object_entries = False

# Gallery
sphinx_gallery_conf = {
    "examples_dirs": ["gallery"],
    "gallery_dirs": ["gallery-pages"],
    "filename_pattern": r"/gallery/",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "plot_gallery": str(RUN),
    "run_stale_examples": RUN,
    "download_all_examples": False,
    "remove_config_comments": True,
    "min_reported_time": 1e9,
    "capture_repr": (),  # what a script prints, not what its last line happens to return
    "write_computation_times": False,
    "image_srcset": ["2x"],
    "reset_modules": ("matplotlib", "look.of_project"),
}
# matplotlib's Agg canvas has no window to show; every script of a gallery is told so.
warnings.filterwarnings("ignore", category=UserWarning, message=".*non-interactive.*")

# Looks
html_theme = "furo"
html_title = f"cnclik {release}"
html_static_path = ["_static"]
html_css_files = ["cnclik.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072b2", "color-brand-content": "#0072b2"},
    "dark_css_variables": {"color-brand-primary": "#56b4e9", "color-brand-content": "#56b4e9"},
}
copybutton_prompt_text = r"\$ |>>> "
copybutton_prompt_is_regexp = True
