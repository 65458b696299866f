"""Pages of tables and plots that are about more than one run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from massprop_drake.display import interactive, templates

_HERE = Path(__file__).parent
_STYLES = (_HERE / "report.css", _HERE / "plotted.css")
# of plotly the part that draws heat maps besides lines, points and bars: a third of it
_SCRIPTS = (_HERE / "plotly-cartesian.min.js", _HERE / "themed.js", _HERE / "plotted.js")


def page(template: Path, content: Mapping[str, Any]) -> str:
    """Returns a page of tables and plots, filled from a template, as one HTML text that needs no network.

    Args:
        template: see `templates.page`; it has a place `plot-<name>` for each plot.
        content: values for it, `plots` among them, as plotly takes them.
    """
    return templates.page(
        template,
        content,
        data={"plots": content["plots"]},
        styles=[path.read_text(encoding="utf-8") for path in _STYLES],
        scripts=[path.read_text(encoding="utf-8") for path in _SCRIPTS],
        extra_policy=interactive.NEEDS,
    )
