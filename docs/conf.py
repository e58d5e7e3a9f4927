# SPDX-License-Identifier: Apache-2.0
"""The documentation site: ``make docs`` writes it to out/docs, and any warning is an error."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

import generated_pages  # noqa: E402

from taccel_lab.version import __version__  # noqa: E402

project = "taccel-lab"
copyright = "the authors of taccel-lab"
author = "the authors of taccel-lab"
release = version = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["examples", "README.md"]
templates_path: list[str] = []
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
# Notebooks are kept executed; tests hold that they are what their scripts give.
nb_execution_mode = "off"
# Types in docstrings are words (shape, tet_count) that several classes have as fields.
suppress_warnings = ["ref.python"]

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_typehints = "signature"
autodoc_class_signature = "separated"

html_theme = "furo"
html_title = "taccel-lab"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}


def setup(app: object) -> None:
    """Pages that are written from the program itself."""
    generated_pages.write(DOCS / "reference" / "generated")
