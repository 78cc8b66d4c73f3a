"""Sphinx configuration of the documentation; `scripts/docs` builds it.

The pages load nothing from other hosts. The references are made from the program (COPHASE_PROGRAM), from the Python package
on the C library (COPHASE_LIBRARY), from the C headers and from the MATLAB package.
"""

import sys
import tomllib
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path[:0] = [str(DOCS), str(ROOT / "bindings/python")]

project = "cophase"
author = "the authors of cophase"
version = release = tomllib.loads((ROOT / "Cargo.toml").read_text("utf-8"))["workspace"]["package"]["version"]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.matlab",
    "_site.mathml",
    "_site.matlab_help",
    "_site.docstrings",
    "_site.forms",
    "_site.references",
    "_site.repository",
    "_site.rust",
]
exclude_patterns = ["_site", "tutorials"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

# Two dashes of an option and straight quotes of TOML stay as they are.
smartquotes = False
myst_enable_extensions = ["amsmath", "attrs_inline", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
math_renderer = "mathml"

nitpicky = True
nitpick_ignore_regex = [
    # Types of C, NumPy and Python that have no page here.
    ("c:identifier", r"u?int\d+_t|size_t|ptrdiff_t"),
    ("py:.*", r"(?!cophase\b).*"),
    ("mat:.*", r"(?!cophase\.).*"),
]

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
# The docstrings have the shapes, which annotations have not.
napoleon_attr_annotations = False
matlab_src_dir = str(ROOT / "bindings/matlab")
matlab_keep_package_prefix = False

sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    # A page that asks other hosts for scripts.
    "write_computation_times": False,
    "matplotlib_animations": False,
    "abort_on_example_error": True,
    "copyfile_regex": r"$^",
    # What a script prints, and not the value of its last line.
    "capture_repr": (),
}

html_theme = "furo"
# The version is in the sidebar and in the title of every page.
html_title = f"cophase {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
html_search_language = "en"
pygments_style = "friendly"
pygments_dark_style = "monokai"
