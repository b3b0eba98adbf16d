"""Sphinx: the pages of this folder and the reference from docstrings."""

from uoarm import __version__

project = "uoarm"
author = "the uoarm authors"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]  # links to examples; tests/docs follows every link
html_theme = "furo"
html_title = f"uoarm {release}"
exclude_patterns = ["_build"]
nitpicky = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = True
napoleon_use_ivar = True
