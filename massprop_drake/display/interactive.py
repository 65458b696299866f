"""Plots as plotly figures, for a page that draws them in the browser.

The page replaces black by the color of its text, which is light in the dark theme, and colors the grid. A
trace without `x` is drawn over the sample times, which the page holds once.
"""

from __future__ import annotations

import html
import json
import math
import operator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.display.spec import (
    Array,
    Band,
    Bars,
    Level,
    Line,
    Mark,
    Over,
    Panel,
    Plot,
    Points,
    SymmetricLog,
    Whiskers,
    Zone,
)
from massprop_drake.display.style import DECLARED_COLOR, TRUTH_COLOR, UNARMED_COLOR, WINDOW_COLOR, WINDOW_OPACITY

Json = dict[str, Any]

# plotly writes its own styles, and turns a plot into a picture for the reader to save
NEEDS = {"style-src": "'unsafe-inline'", "img-src": "data: blob:"}

_HERE = Path(__file__).parent
# of plotly the part that draws lines, points and bars: a quarter of it, which a browser has read that much sooner
_SCRIPTS = ("plotly-basic.min.js", "themed.js", "report.js")

_DIGITS, _DIGITS_READ = 6, 4  # of a number in the page, and of one that is only read
_LEAST = 0.001  # of the 3-sigma at the end: below it a logarithmic view does not begin
_PIXELS_PER_POINT = 4.0 / 3.0

# Places, pixels
_TOP, _BOTTOM, _LEFT, _LABEL = 10, 40, 80, 67  # the last: of a vertical axis's label, left of it
_PANEL, _ONE_PANEL, _ROW, _GAP = 120, 190, 13, 14
_BAR = 6.0  # width of a bar as high as a row
_KEY, _SYMBOL, _LETTER, _NARROW = 18, 40, 6, 430  # height of a row of a key, and the widths that fill it


def plotly_figure(plot: Plot) -> Json:
    """Converts a plot to plotly's traces and layout, with titles and axis views, as data for the page.

    Returns:
        `name` and `title`; `traces` and `layout` as plotly takes them; and `views`, the vertical axes that the
        reader switches between a linear and a logarithmic view, with the least value of the latter. A trace of one
        view names it in `view`, which the page takes out. A path over a quantity says in `meta.over` what its
        horizontal axis shows; it has a point for each sample time. `most` are the vertical axes that show most of
        their points; what is beyond stands in traces with an `edge`, which the page fills anew as the reader zooms.
    """
    traces: list[Json] = []
    shapes: list[Json] = []
    axes: Json = {}
    views: dict[str, float] = {}
    heights = [_panel_height(panel, alone=len(plot.panels) == 1) for panel in plot.panels]
    axis_above = _BOTTOM if plot.panels[0].over else 0  # height of the horizontal axis of the panel above
    spaces = [_GAP + _key_height(panel) + axis_above * (number > 0) for number, panel in enumerate(plot.panels)]
    total = sum(heights) + sum(spaces)
    top = total
    for number, (panel, height, space) in enumerate(zip(plot.panels, heights, spaces, strict=True), 1):
        top -= space
        suffix = "" if number == 1 else str(number)
        marks = [mark for mark in panel.marks if not isinstance(mark, Level | Zone)]
        scale = panel.scale
        if isinstance(scale, SymmetricLog):
            views[f"yaxis{suffix}"] = _LEAST * scale.small
        for trace in _log_axis_views(plot, marks) if isinstance(scale, SymmetricLog) else _traces(plot, marks, panel):
            if "meta" in trace:
                trace["meta"] |= {"label": f"{panel.label} {trace['meta']['label']}".strip(), "unit": panel.unit}
            traces.append({**trace, "yaxis": f"y{suffix}", "legend": f"legend{suffix}"})
        vertical = {**_vertical_axis(panel), "domain": [(top - height) / total, top / total]}
        if panel.over:
            axes[f"xaxis{suffix}"] = _horizontal_axis(panel.over, suffix)
            vertical["anchor"] = f"x{suffix}"
            _set_quantity_axis(traces[-len(marks) :], panel, panel.over, suffix)
        else:
            shapes += _spanning_shapes(plot, panel, suffix)
        axes[f"yaxis{suffix}"] = vertical
        axes[f"legend{suffix}"] = {
            "orientation": "h", "x": 1.0, "xanchor": "right", "y": top / total, "yanchor": "bottom",
            "font": {"size": 10},
        }  # fmt: skip
        top -= height
    if not plot.panels[-1].over:
        axes["xaxis"] = {
            "title": {"text": "time, s"},
            "range": [_round_number(plot.time_s[0]), _round_number(plot.time_s[-1])],
            "anchor": f"y{suffix}",  # of the lowest panel
        }
    layout = {
        "height": total + _TOP + _BOTTOM,
        "margin": {"l": _LEFT, "r": 12, "t": _TOP, "b": _BOTTOM},
        "shapes": shapes,
        "annotations": [_axis_label(panel, number) for number, panel in enumerate(plot.panels, 1) if not panel.rows],
        **axes,
    }
    return {
        "name": plot.name,
        "title": plot.title,
        "note": plot.meaning,
        "folded": plot.folded,
        "traces": traces,
        "layout": layout,
        "views": views,
        "most": [f"yaxis{number if number > 1 else ''}" for number, panel in enumerate(plot.panels, 1) if panel.most],
    }


def scripts() -> list[str]:
    """Returns the texts of the scripts that draw plotly figures, in loading order; they require policy `NEEDS`."""
    return [(_HERE / name).read_text(encoding="utf-8") for name in _SCRIPTS]


class _Lists:
    """Lists of numbers that a page holds once each.

    Attributes:
        found: the lists.
    """

    def __init__(self) -> None:
        self.found: list[list[float | None]] = []
        self._places: dict[tuple[float | None, ...], int | list[Any]] = {}

    def store(self, values: list[float | None], *, mirrored: bool) -> int | list[Any]:
        """Stores a list once; returns its number or, if mirrored, that of a stored list to negate or take `abs` of."""
        key = tuple(values)
        if key not in self._places:
            number = len(self.found)
            self.found.append(values)
            self._places[key] = number
            if mirrored:
                for operation, change in (("minus", operator.neg), ("abs", abs)):
                    changed = tuple(None if value is None else change(value) for value in values)
                    self._places.setdefault(changed, [number, operation])
        return self._places[key]


def pack_figures(figures: Sequence[Json]) -> Json:
    """Packs plotly figures for a page, with every list of numbers and every shape stored once.

    Args:
        figures: as `plotly_figure` makes them, which are changed.

    Returns:
        `lists`, `shapes`, and `plots` in which a shape is its number, and the values of a trace are the number of
        their list, or that and "minus" or "abs".
    """
    lists, shapes = _Lists(), dict[str, int]()
    for figure in figures:
        for trace in figure["traces"]:
            for key in {"x", "y"} & set(trace):
                trace[key] = lists.store(trace[key], mirrored=key == "y" and bool(figure["views"]))
        layout = figure["layout"]
        layout["shapes"] = [shapes.setdefault(json.dumps(shape), len(shapes)) for shape in layout["shapes"]]
    return {"lists": lists.found, "shapes": [json.loads(shape) for shape in shapes], "plots": list(figures)}


def round_times(time_s: Array) -> list[float]:
    """Rounds sample times, s, to nine digits."""
    return [float(f"{value:.9g}") for value in time_s.tolist()]


def _panel_height(panel: Panel, *, alone: bool) -> int:
    """Returns the height of a panel on the page, pixels."""
    return max(_ROW * len(panel.rows), _ONE_PANEL if alone or panel.over else _PANEL)


def _key_height(panel: Panel) -> int:
    """Estimates the height of a panel's legend, pixels, in a narrow card where its entries wrap into columns."""
    widths = [
        _SYMBOL + _LETTER * len(mark.label)
        for mark in panel.marks
        if not isinstance(mark, Bars) and mark.label and not (isinstance(mark, Points) and not mark.drawn)
    ]
    if sum(widths) <= _NARROW:
        return _KEY if widths or panel.most else 0  # for what a zoom leaves beyond
    return _KEY * math.ceil(len(widths) / max(1, _NARROW // max(widths)))


def _horizontal_axis(quantity: Over, suffix: str) -> Json:
    """Returns plotly's horizontal axis of a panel over a quantity other than time."""
    return {
        "title": {"text": escape_text(quantity.axis_label), "font": {"size": 10}},
        "range": list(quantity.limits),
        "anchor": f"y{suffix}",
        "exponentformat": "power",
    }


def _set_quantity_axis(traces: Sequence[Json], panel: Panel, quantity: Over, suffix: str) -> None:
    """Moves a panel's traces from the time axis to that of a quantity; only the first, the path, keeps readings."""
    for trace in traces:
        trace["xaxis"] = f"x{suffix}"
        trace.pop("meta", None)
    traces[0]["meta"] = {"label": panel.label, "unit": panel.unit, "over": [quantity.label, quantity.unit]}


def _axis_label(panel: Panel, number: int) -> Json:
    """Returns plotly's annotation that labels a vertical axis in a fixed place, where titles overlap numbers."""
    suffix = "" if number == 1 else str(number)
    return {
        "text": escape_text(panel.axis_label), "textangle": -90, "showarrow": False, "font": {"size": 10},
        "xref": f"x{suffix if panel.over else ''} domain", "x": 0.0, "xshift": -_LABEL,
        "yref": f"y{suffix} domain", "y": 0.5,
    }  # fmt: skip


def _vertical_axis(panel: Panel) -> Json:
    """Returns plotly's vertical axis of a panel: scale, range, and row names."""
    axis: Json = {"exponentformat": "power", "automargin": True, "nticks": 5}
    axis["type"] = "log" if panel.scale == "log" else "linear"
    if panel.limits is not None:
        limits = np.log10(panel.limits) if panel.scale == "log" else np.array(panel.limits)
        axis["range"] = limits.tolist()
    if panel.rows:
        names = [escape_text(row) for row in panel.rows]
        axis["title"] = {"text": escape_text(panel.axis_label), "font": {"size": 10}}
        axis |= {"tickvals": list(range(len(names))), "ticktext": names, "tickfont": {"size": 9}}
        axis["range"] = [len(names) - 0.4, -0.6]
    return axis


# ------------------------------------------------------------------------------------------ traces


def _traces(plot: Plot, marks: Sequence[Mark], panel: Panel) -> list[Json]:
    """Converts the marks of a panel to plotly traces, except those that span all times, which are shapes."""
    traces = []
    for mark in marks:
        match mark:
            case Line():
                traces.append(_line_trace(plot, mark))
            case Points():
                traces.append(_points_trace(mark))
            case Whiskers():
                traces.append(_whiskers_trace(mark))
            case Band():
                traces += _band_traces(plot, mark)
            case Bars():
                traces.append(_bars_trace(mark, panel.rows))
    return traces


def _log_axis_views(plot: Plot, marks: Sequence[Mark]) -> list[Json]:
    """Makes linear traces, and logarithmic ones of magnitudes, as plotly has no symmetric logarithmic axis."""
    linear, log = [], []
    for mark in marks:
        match mark:
            case Line():
                linear.append(_line_trace(plot, mark))
                log.append(_line_trace(plot, mark._replace(y=np.abs(mark.y))))
            case Band():
                linear += _band_traces(plot, mark)
                log.append(_line_trace(plot, Line(mark.x, mark.high, mark.color, mark.label, dashed=True)))
            case _:
                raise TypeError(f"{type(mark).__name__} has no logarithmic view")
    return [{**trace, "view": "linear"} for trace in linear] + [{**trace, "view": "log"} for trace in log]


def _line_trace(plot: Plot, mark: Line) -> Json:
    """Converts a line to a plotly trace."""
    style = {
        "color": mark.color,
        "width": mark.width * _PIXELS_PER_POINT,
        "dash": "dash" if mark.dashed else "solid",
        "shape": _line_shape(mark.steps),
    }
    content = {**_trace_times(plot, mark.x), "y": rounded_numbers(mark.y), "mode": "lines", "line": style}
    return _trace(mark.label, {**content, "meta": _reading_name(mark.label)})


def _reading_name(label: str, **more: Any) -> Json:
    """Returns the metadata of a trace's readings: its label without the final value, and extra entries."""
    return {"label": label.partition(",")[0], **more}


def _points_trace(mark: Points) -> Json:
    """Converts points to a plotly trace, hidden if they are only for readings."""
    marker: Json = {"color": mark.color, "size": mark.size}
    if mark.symbol != "dot":
        marker["symbol"] = _SYMBOLS[mark.symbol]
    y = rounded_numbers(mark.y, digits=_DIGITS if mark.drawn else _DIGITS_READ)
    content: Json = {"x": rounded_numbers(mark.x), "y": y, "mode": "markers", "marker": marker}
    if mark.symbol == "dot":
        content["meta"] = _reading_name(mark.label, **({"group": mark.group} if mark.group else {}))
    if not mark.drawn:
        content |= {"visible": False, "showlegend": False}
    if mark.symbol in ("up", "down"):
        content |= {"edge": mark.symbol, "hoverinfo": "text"}
    return _trace(mark.label, content)


_SYMBOLS = {"tick": "line-ns-open", "up": "triangle-up", "down": "triangle-down"}


def _whiskers_trace(mark: Whiskers) -> Json:
    """Converts vertical ranges to one plotly trace of separate segments."""
    gap = np.full(mark.x.shape, np.nan)
    x, y = (np.stack(parts, axis=1).ravel() for parts in ((mark.x, mark.x, gap), (mark.low, mark.high, gap)))
    style = {"color": mark.color, "width": mark.width * _PIXELS_PER_POINT}
    return _trace(mark.label, {"x": rounded_numbers(x), "y": rounded_numbers(y), "mode": "lines", "line": style})


def _band_traces(plot: Plot, mark: Band) -> list[Json]:
    """Converts a band to two plotly traces without lines, the upper one filled down to the lower."""
    edge = {**_trace_times(plot, mark.x), "mode": "lines", "line": {"width": 0, "shape": _line_shape(mark.steps)}}
    face = {"fill": "tonexty", "fillcolor": f"{mark.color}{round(255 * mark.opacity):02x}"}
    low = _trace("", {**edge, "y": rounded_numbers(mark.low), "hoverinfo": "skip"})
    high = {**edge, "y": rounded_numbers(mark.high), **face}
    meta = {"meta": _reading_name(mark.label, half=True)} if mark.label else {}  # read as half of what lies between
    return [low, _trace(mark.label, high | meta)]


def _bars_trace(mark: Bars, rows: Sequence[str]) -> Json:
    """Converts horizontal bars to one plotly trace of separate segments, named by row."""
    gap = np.full(mark.begin.shape, np.nan)
    x = np.stack([mark.begin, mark.end, gap], axis=1).ravel()
    y = np.stack([mark.row, mark.row, gap], axis=1).ravel()
    names = [escape_text(row) for row in rows]
    text = [name for row in np.round(mark.row).astype(int).tolist() for name in (names[row], names[row], "")]
    style = {"color": mark.color, "width": round(_BAR * mark.height, 1)}
    bars: Json = {
        "x": rounded_numbers(x),
        "y": rounded_numbers(y),
        "text": text,
        "hoverinfo": "text+x",
        "mode": "lines",
        "line": style,
    }
    if mark.label:
        bars["meta"] = {"label": mark.label, "bars": True}
    return _trace("", bars)


def _trace(label: str, content: Json) -> Json:
    """Makes a plotly trace of a label, which the legend shows unless it is empty, and other entries."""
    base: Json = {"type": "scatter", "hoverinfo": "x+y+name", "name": escape_text(label), "showlegend": bool(label)}
    return {**base, **content}


def escape_text(text: str) -> str:
    """Escapes HTML and dollar signs in a text, which plotly takes for markup and TeX."""
    return html.escape(text, quote=False).replace("$", "&#36;")


def _trace_times(plot: Plot, x: Array) -> Json:
    """Returns the horizontal values of a trace as plotly data by key; empty where they are the sample times."""
    return {} if x is plot.time_s else {"x": rounded_numbers(x)}


def _line_shape(steps: bool) -> str:
    """Returns plotly's shape of a line: with steps, or straight between values."""
    return "hv" if steps else "linear"


def rounded_numbers(values: Array, *, digits: int = _DIGITS) -> list[float | None]:
    """Converts an array to a list of numbers rounded to some digits; None for what is not finite."""
    return [_round_number(value, digits) if math.isfinite(value) else None for value in values.tolist()]


def _round_number(value: float, digits: int = _DIGITS) -> float:
    """Rounds a number to some significant digits."""
    return float(f"{value:.{digits}g}")


# ------------------------------------------------------------------------------------------ shapes


def _spanning_shapes(plot: Plot, panel: Panel, suffix: str) -> list[Json]:
    """Makes plotly shapes that span a panel: time windows and events in height, levels and zones in width."""
    over_values = {"xref": "x", "yref": f"y{suffix} domain", "y0": 0, "y1": 1}
    over_times = {"xref": "x domain", "yref": f"y{suffix}", "x0": 0, "x1": 1}
    shapes: list[Json] = []
    for window in plot.windows:
        color = WINDOW_COLOR if window.armed else UNARMED_COLOR
        face = {"fillcolor": color, "opacity": WINDOW_OPACITY, "line": {"width": 0}, "layer": "below"}
        shapes.append({"type": "rect", **over_values, "x0": window.start_s, "x1": window.end_s, **face})
    for moment in plot.moments:
        color, dash = (DECLARED_COLOR, "solid") if moment.declared else (TRUTH_COLOR, "dot")
        line = {"color": color, "width": 1, "dash": dash}
        shapes.append({"type": "line", **over_values, "x0": moment.time_s, "x1": moment.time_s, "line": line})
    for mark in panel.marks:
        match mark:
            case Zone():
                face = {"fillcolor": mark.color, "opacity": mark.opacity, "line": {"width": 0}, "layer": "below"}
                zone = {"type": "rect", **over_times, "y0": mark.low, "y1": mark.high, **face}
                shapes.append({**zone, **_legend_entry(mark.label, suffix)})
            case Level():
                line = {"color": mark.color, "width": 1, "dash": "dash"}
                level = {"type": "line", **over_times, "y0": mark.y, "y1": mark.y, "line": line}
                shapes.append({**level, **_legend_entry(mark.label, suffix)})
    return shapes


def _legend_entry(label: str, suffix: str) -> Json:
    """Returns the entries of a plotly shape that name it in a panel's legend; {} without a label."""
    return {"name": escape_text(label), "showlegend": True, "legend": f"legend{suffix}"} if label else {}
