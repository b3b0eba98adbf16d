"""Sphinx: the pages of this folder and the reference from docstrings."""

import sys
from importlib.util import find_spec
from pathlib import Path

from uoarm import __version__

project = "uoarm"
author = "the uoarm authors"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
suppress_warnings = [
    "myst.xref_missing",  # links to examples; tests/docs follows every link
    "ref.python",  # a plugin's Robot is not the configuration's; annotations name either by itself
]
html_theme = "furo"
html_title = f"uoarm {release}"
exclude_patterns = ["_build"]
nitpicky = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# What is not installed is left blank in the reference; `make docs` installs everything.
_OPTIONAL = (
    *("cbor2", "hypothesis", "msgpack", "omniORB", "orjson", "prometheus_client", "pybase64"),
    *("CosNaming", "PortableServer", "_omnipy", "defusedxml", "numpy", "pytest", "serial"),
    *("cryptography", "paho", "websockets", "zenoh"),
)
sys.path += map(str, Path(__file__).parents[1].glob("plugins/*/src"))
autodoc_mock_imports = [name for name in _OPTIONAL if find_spec(name) is None]
if "omniORB" in autodoc_mock_imports:
    autodoc_mock_imports.append("_uoarm_rtm_stubs")  # generated, and of nothing but omniORB
napoleon_google_docstring = True
napoleon_use_ivar = True
