"""How Sphinx builds these pages: `sphinx-build -W -n --keep-going docs build/docs`; nothing is fetched."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "contactqp"
author = "The contactqp developers"
copyright = author  # Sphinx knows this name only
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "mathml",  # extensions/: what is not worth a package of its own
    "absolute_values",
    "commented_fields",
    "public_names",
]
exclude_patterns = ["extensions"]

# Markdown as GitHub shows it, with $formulas$ and links to headings.
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

# Docstrings are numpydoc's, `backticks` are code or a public name, and types stand in the text: what is left of a
# signature is names.
default_role = "code-or-name"
smartquotes = False  # u'Ku is a formula
autodoc_typehints = "none"
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"
numpydoc_show_class_members = False

# Cross-references resolve, all of them.
nitpicky = True

html_theme = "pydata_sphinx_theme"
html_title = "contactqp"
templates_path = ["templates"]
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_sidebars = {"**": ["site-navigation.html"]}
html_theme_options = {
    "navbar_center": [],  # all pages stand in the sidebar
    "show_prev_next": True,
    "show_toc_level": 2,
    "footer_start": [],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
html_context = {"default_mode": "auto"}
html_show_sourcelink = False
