# SPDX-License-Identifier: Apache-2.0
"""How Sphinx makes the site from the pages beside this file: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import library_pages
import plain_docstrings

import smallwheel_ros

HERE = Path(__file__).parent
library_pages.write(HERE.parent / "smallwheel_ros", HERE / "_api")

project = "smallwheel_ros"
version = release = smallwheel_ros.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "mathml",
    "table_directive",
    "ros_messages",
]
exclude_patterns = ["_build"]
default_role = "code"
highlight_language = "text"

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath", "deflist"]
# Blocks show what a shell prints, and JSON with remarks; two modules may use one name for a type.
suppress_warnings = ["misc.highlighting_failure", "ref.python"]

napoleon_use_ivar = True
napoleon_attr_annotations = False  # as with `autodoc_typehints`
toc_object_entries = (
    False  # a page of the library lists its modules; with their members it takes twice the time
)
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # units and shapes are in the text; types are in the code

html_theme = "furo"
html_title = f"smallwheel_ros {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_last_updated_fmt = None
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#0b5394",
        "color-brand-content": "#0b5394",
        "font-stack": "system-ui, sans-serif",
    },
    "dark_css_variables": {
        "color-brand-primary": "#7fb8f0",
        "color-brand-content": "#7fb8f0",
    },
}


def skip_member(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out what a named tuple says of its fields; the text of its class has them."""
    return True if (getattr(obj, "__doc__", None) or "").startswith("Alias for field") else None


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-skip-member", skip_member)
    # Before napoleon, which has the default priority of 500.
    app.connect("autodoc-process-docstring", plain_docstrings.process, priority=400)
