"""Settings of the documentation: `make docs` builds it into build/docs, offline."""

from __future__ import annotations

import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # for the extensions beside this file

project = "massprop_drake"
author = "massprop_drake developers"
copyright = "massprop_drake developers"
version = release = installed_version("massprop-drake")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docstring_sections",
    "mathml",
    "module_blocks",
    "own_names",
]
exclude_patterns = ["tutorials/*.py", "tutorials/air_bearing/*"]
templates_path: list[str] = []

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

# docstrings: `name` is a link where there is such a thing, and plain type where there is not
default_role = "py:obj"
nitpick_ignore_regex = [
    ("py:obj", r".*"),
    ("py:(class|data|exc)", r"(?!massprop_drake\.).*"),  # types of other packages, which are not linked
    (
        "py:class",
        r"massprop_drake\.(.*\._|inputs\.model\.M$|systems\.(caching|stopwatch)\.T$|maths\.kernels\.F$).*",
    ),  # private
]
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_preserve_defaults = True
autodoc_use_type_comments = False  # there are none, and each module is parsed again for them
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_theme_options = {"light_css_variables": {"code-font-size": "75%"}}  # the tutorials' lines fit
html_title = f"massprop_drake {version}"
html_math_renderer = "mathml"
html_show_sphinx = False
html_static_path: list[str] = []


def _skip_conversion(app: object, what: str, name: str, *rest: object) -> bool | None:
    """Leaves out the methods and names that Drake's `TemplateSystem` adds to a module."""
    of_scalar = "\N{MATHEMATICAL BOLD SCRIPT CAPITAL T}" in name
    return True if of_scalar or name.startswith(("ToScalarType", "ToAutoDiffXd", "ToSymbolic")) else None


def setup(app: Any) -> None:
    """Connects this file's functions to the build."""
    app.connect("autodoc-skip-member", _skip_conversion)
