"""Sphinx configuration: `make docs` builds the site offline, with warnings as errors."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "src"))
os.environ.setdefault("MPLBACKEND", "agg")

from rootmatch import __version__  # noqa: E402

project = "rootmatch"
author = "the rootmatch authors"
copyright = "the rootmatch authors"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
root_doc = "index"

html_theme = "furo"
html_title = f"rootmatch {version}"
html_static_path: list[str] = []

myst_enable_extensions = ["deflist", "colon_fence"]
myst_heading_anchors = 3

autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
napoleon_google_docstring = False
napoleon_numpy_docstring = True
napoleon_use_ivar = True
napoleon_use_rtype = False
default_role = "py:obj"  # `match` in a docstring links to what has that name, and is code where nothing does
python_use_unqualified_type_names = True

sphinx_gallery_conf = {
    "examples_dirs": ["../examples/concepts", "../examples/gallery"],
    "gallery_dirs": ["concepts", "gallery"],
    "filename_pattern": r"/plot_",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "abort_on_example_error": True,
    "show_memory": False,
    "min_reported_time": 0,
    "parallel": False,
    "copyfile_regex": r".*\.csv",
    "reset_modules": ("matplotlib",),
}

EXAMPLE = re.compile(r"\]\(((?:\.\./)*)\.\./examples/(gallery|concepts)/(plot_\w+)\.py\)")
"""A link to an example, as a repository page shows it; on the site it leads to the page that is made of the example."""
ROOT_PAGES = {"development": "CONTRIBUTING.md", "changelog": "CHANGELOG.md"}
"""Pages of the site that are files of the repository's root."""


def link_examples(app: Any, name: str, text: list[str]) -> None:
    """Lead links to examples to their pages."""
    text[0] = EXAMPLE.sub(r"](\1\2/\3.rst)", text[0])


def show_root_page(app: Any, name: str, text: list[str]) -> None:
    """Put a file of the repository's root in place of a page, its links as they are from here."""
    if name not in ROOT_PAGES:
        return
    shown = (HERE.parent / ROOT_PAGES[name]).read_text(encoding="utf-8").replace("](docs/", "](")
    for page, file in ROOT_PAGES.items():
        shown = shown.replace(f"]({file})", f"]({page}.md)")
    text[0] = re.sub(r"\]\((SECURITY|README)\.md\)", r"](../\1.md)", shown)


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", show_root_page)
    app.connect("source-read", link_examples)
