"""Plots drawn with matplotlib, in the manner of figures 5-2 to 5-27 of the thesis.

Panels, keys and labels have fixed places in inches. A layout that measures all text, and matplotlib's own
legends, would take twice as long to draw as everything else.
"""

from __future__ import annotations

import functools
import gc
import inspect
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from massprop_drake.display import detector_plots, filter_plots, motion_plots, plots
from massprop_drake.display.plot_source import Source
from massprop_drake.display.spec import (
    Array,
    Band,
    Bars,
    Level,
    Line,
    Mark,
    Panel,
    Plot,
    Points,
    ShadedWindow,
    SymmetricLog,
    Whiskers,
    Zone,
)
from massprop_drake.display.style import (
    DECLARED_COLOR,
    DOTS_PER_INCH,
    GRID_OPACITY,
    KEY_SIZE,
    LABEL_SIZE,
    ROW_SIZE,
    THIN_LINE,
    TITLE_SIZE,
    TRUTH_COLOR,
    UNARMED_COLOR,
    WINDOW_COLOR,
    WINDOW_OPACITY,
    WINDOW_SIZE,
)

_STYLE: Any = {  # as `rc_context` takes it
    "axes.grid": True,
    "grid.alpha": GRID_OPACITY,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelsize": LABEL_SIZE,
    "xtick.labelsize": LABEL_SIZE,
    "ytick.labelsize": LABEL_SIZE,
    "text.parse_math": False,  # a dollar in a user's name is a dollar
    "axes.titley": 1.0,  # panels have no titles: their place need not be found
}

# Places, inches
_WIDTH, _LEFT, _RIGHT = 9.0, 0.85, 0.2
_TITLE, _BOTTOM = 0.34, 0.5
_PANEL, _GAP, _ROW = 1.6, 0.17, 0.15  # height of a panel, space above it, height of one of many rows
_SQUARE, _SAID = 2.1, 0.22  # height of a panel in a row of them, and of what is said below
_MARKS = 5  # on a vertical axis at most
_FEW_ROWS = 5  # that fit into an ordinary panel
_KEY, _HANDLE, _LETTER = 0.19, 0.24, 0.063  # height of a row of a key, width of a symbol and of a letter
_WINDOW_STEP, _SMALL_LETTER = 0.11, 0.058  # height of a window's name, width of its letters


class Drawing(Figure):
    """Figure that shows itself in a notebook, with no magic and no pyplot."""

    def _repr_png_(self) -> bytes:
        """Returns the figure as PNG for a notebook."""
        picture = io.BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()


class _Figures(Mapping[str, Figure]):
    """Figures that are drawn when they are asked for, so that one at a time is held."""

    def __init__(self, source: Source):
        self._source = source
        self._plots = plots.available_plots(source)

    def __getitem__(self, name: str) -> Figure:
        return draw_plot(self._plots[name](self._source))

    def __iter__(self) -> Iterator[str]:
        return iter(self._plots)

    def __len__(self) -> int:
        return len(self._plots)


def _make_plot_method(describe: Callable[[Source], Plot]) -> Callable[[Plots], Figure]:
    """Makes a method of `Plots` that draws the plot of a function, with that function's name and docstring."""

    @functools.wraps(describe, assigned=("__name__", "__doc__"), updated=())
    def draw(self: Plots) -> Figure:
        """Draws the plot of the run; its docstring is that of the function."""
        return draw_plot(describe(self.source))

    return draw


class Plots:
    """Draws a run's signals; every function that describes a plot is a method, which returns a matplotlib figure.

    Args:
        source: the signals, and what is known about them.
    """

    def __init__(self, source: Source):
        self.source = source

    def all(self) -> Mapping[str, Figure]:
        """Maps names of all plots, in reading order, to matplotlib figures, each drawn when it is accessed."""
        return _Figures(self.source)

    def save(self, folder: Path) -> None:
        """Writes every figure into a folder, as `<name>.png`; raises the first error once the others are written."""
        drawn, failed = self.all(), []
        for name in drawn:
            path = folder / f"{name}.png"
            try:
                # a picture of lines hardly gets smaller by compressing it harder, which takes half the time of drawing
                drawn[name].savefig(path, pil_kwargs={"compress_level": 1})
            except Exception as error:
                path.unlink(missing_ok=True)
                failed.append(error)
            gc.collect()  # a figure is full of cycles: else a few, of many megabytes each, wait to be freed
        if failed:
            raise failed[0]

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Callable[[], Figure]: ...


for _module in (motion_plots, filter_plots, detector_plots, plots):
    for _name, _describe in inspect.getmembers(_module, inspect.isfunction):
        _is_own = _describe.__module__ == _module.__name__ and not _name.startswith("_")
        if _is_own and _describe.__annotations__["return"] == "Plot":
            setattr(Plots, _name, _make_plot_method(_describe))


# ----------------------------------------------------------------------------------------- figures


def draw_plot(plot: Plot) -> Figure:
    """Draws a plot as a matplotlib figure: panels over time in a column, panels over other quantities in a row."""
    return _draw_row(plot) if plot.panels[0].over else _draw_column(plot)


def _draw_row(plot: Plot) -> Figure:
    """Draws a figure of panels side by side, with the first panel's legend above them."""
    keys = _key_rows(plot.panels[0])
    total = _TITLE + _GAP + _KEY * len(keys) + _SQUARE + _BOTTOM + _SAID
    width = (_WIDTH - _RIGHT) / len(plot.panels) - _LEFT
    with mpl.rc_context(_STYLE):
        figure = Drawing(figsize=(_WIDTH, total), dpi=DOTS_PER_INCH)
        figure.suptitle(f"{plot.title}   ({plot.caption})", fontsize=TITLE_SIZE, y=1.0 - 0.08 / total)
        _draw_key(figure, keys, _SAID + _BOTTOM + _SQUARE + 0.03)
        for number, panel in enumerate(plot.panels):
            left = _LEFT + number * (width + _LEFT)
            axes = figure.add_axes((left / _WIDTH, (_SAID + _BOTTOM) / total, width / _WIDTH, _SQUARE / total))
            _draw_panel(axes, panel)
            axes.locator_params(axis="x", nbins=_MARKS)
            axes.yaxis.set_label_coords((0.26 - _LEFT) / width, 0.5)
            if panel.over:
                axes.set_xlabel(panel.over.axis_label)
                axes.xaxis.set_label_coords(0.5, -0.32 / _SQUARE)
                axes.set_xlim(*panel.over.limits)
        figure.text(0.5, 0.08 / total, plot.meaning, fontsize=KEY_SIZE, ha="center", va="bottom")
    return figure


def _draw_column(plot: Plot) -> Figure:
    """Draws a figure of panels over the same time, one above the other."""
    keys = [_key_rows(panel) for panel in plot.panels]
    left = _left_margin(plot.panels)
    width = _WIDTH - left - _RIGHT
    levels = _window_levels(plot.windows, float(plot.time_s[-1] - plot.time_s[0]) / width)
    names = _WINDOW_STEP * (max(levels, default=-1) + 1)  # height of the windows' names
    spaces = [_GAP + _KEY * len(rows) for rows in keys]  # above each panel
    spaces[0] += names
    heights = [_panel_height(panel) for panel in plot.panels]
    total = _TITLE + sum(spaces) + sum(heights) + _BOTTOM
    with mpl.rc_context(_STYLE):
        figure = Drawing(figsize=(_WIDTH, total), dpi=DOTS_PER_INCH)
        figure.suptitle(f"{plot.title}   ({plot.caption})", fontsize=TITLE_SIZE, y=1.0 - 0.08 / total)
        bottom = total - _TITLE
        axes: list[Axes] = []
        for panel, key, space, height in zip(plot.panels, keys, spaces, heights, strict=True):
            bottom -= space + height
            _draw_key(figure, key, bottom + height + (0.03 if axes else names + 0.03))
            place = (left / _WIDTH, bottom / total, width / _WIDTH, height / total)
            axes.append(figure.add_axes(place, sharex=axes[0] if axes else None))
            _draw_panel(axes[-1], panel)
            axes[-1].yaxis.set_label_coords((0.16 - left) / width, 0.5)
            _draw_times(axes[-1], plot)
        for window, level in zip(plot.windows, levels, strict=True):
            _label_window(axes[0], window, level)
        said = plot.meaning or plot.note
        axes[-1].set_xlabel(f"time, s   ({said})" if said else "time, s")
        axes[-1].xaxis.set_label_coords(0.5, -0.32 / heights[-1])
        if plot.time_s[-1] > plot.time_s[0]:
            axes[0].set_xlim(float(plot.time_s[0]), float(plot.time_s[-1]))
        _continue_grid(axes)
    return figure


def _continue_grid(axes: Sequence[Axes]) -> None:
    """Draws the lowest panel's time grid in the panels above, and hides their time axes."""
    lines = [[(time_s, 0.0), (time_s, 1.0)] for time_s in axes[-1].xaxis.get_majorticklocs()]
    for above in axes[:-1]:
        above.xaxis.set_visible(False)
        grid = LineCollection(
            lines,
            transform=above.get_xaxis_transform(),
            zorder=0.5,
            colors=mpl.rcParams["grid.color"],
            linewidths=mpl.rcParams["grid.linewidth"],
            alpha=GRID_OPACITY,
        )
        above.add_collection(grid, autolim=False)


def _panel_height(panel: Panel) -> float:
    """Returns the drawn height of a panel, inches."""
    return _PANEL if len(panel.rows) <= _FEW_ROWS else max(_PANEL, _ROW * len(panel.rows))


def _left_margin(panels: Sequence[Panel]) -> float:
    """Computes the margin left of the panels for numbers or row names, inches.

    It is at most half of the figure: longer names are cut.
    """
    longest = max(len(row) for panel in panels for row in (*panel.rows, ""))
    return min(max(_LEFT, 0.35 + _LETTER * longest), 0.5 * _WIDTH)


def _draw_panel(axes: Axes, panel: Panel) -> None:
    """Draws a panel into axes: scale, limits, marks, row names and label."""
    match panel.scale:
        case SymmetricLog(small, large):
            set_symmetric_log(axes, small, large)
        case "log":
            axes.set_yscale("log")
            _mark_powers_of_ten(axes)
        case "linear":
            axes.locator_params(axis="y", nbins=_MARKS)
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
    for mark in panel.marks:
        _draw_mark(axes, mark)
    if panel.rows:
        size = LABEL_SIZE if len(panel.rows) <= _FEW_ROWS else ROW_SIZE
        axes.set_yticks(range(len(panel.rows)), panel.rows, fontsize=size)
        axes.set_ylim(len(panel.rows) - 0.4, -0.6)
    axes.set_ylabel(panel.axis_label)


def _draw_mark(axes: Axes, mark: Mark) -> None:
    """Draws one mark of a panel into axes: line, points, band, bars, level or zone."""
    match mark:
        case Line():
            (line,) = axes.plot(mark.x, mark.y, color=mark.color, linewidth=mark.width, label=mark.label)
            line.set_linestyle(_line_style(mark.dashed))
            line.set_drawstyle("steps-post" if mark.steps else "default")
        case Points(drawn=True):
            symbol = _SYMBOLS[mark.symbol]
            axes.plot(mark.x, mark.y, symbol, color=mark.color, markersize=mark.size, label=mark.label)
        case Whiskers():
            axes.vlines(mark.x, mark.low, mark.high, colors=mark.color, linewidth=mark.width, label=mark.label)
        case Band():
            axes.fill_between(
                mark.x,
                mark.low,
                mark.high,
                step="post" if mark.steps else None,
                color=mark.color,
                alpha=mark.opacity,
                linewidth=0.0,
                label=mark.label,
            )
        case Bars():
            half = 0.5 * mark.height
            corners = _rectangles(mark.begin, mark.end, mark.row - half, mark.row + half)
            axes.add_collection(PolyCollection(corners, facecolors=mark.color, linewidth=0.0), autolim=False)
        case Level():
            axes.axhline(mark.y, color=mark.color, linewidth=THIN_LINE, linestyle="--", label=mark.label)
        case Zone():
            axes.axhspan(mark.low, mark.high, color=mark.color, alpha=mark.opacity, linewidth=0.0, label=mark.label)


_SYMBOLS = {"dot": ".", "tick": "|", "up": "^", "down": "v"}


def _line_style(dashed: bool) -> Literal["--", "-"]:
    """Returns matplotlib's style of a dashed or solid line."""
    return "--" if dashed else "-"


def _rectangles(left: Array, right: Array, low: Array, high: Array) -> list[Array]:
    """Returns the corners of n rectangles from their sides, shape (4, 2) each."""
    x, y = np.stack([left, right, right, left], axis=1), np.stack([low, low, high, high], axis=1)
    return list(np.stack([x, y], axis=2))


def _draw_times(axes: Axes, plot: Plot) -> None:
    """Draws a plot's time windows and event times over the whole height of a panel."""
    whole = axes.get_xaxis_transform()
    if plot.windows:
        start, end = np.array([(window.start_s, window.end_s) for window in plot.windows]).T
        corners = _rectangles(start, end, np.zeros_like(start), np.ones_like(start))
        colors = [WINDOW_COLOR if window.armed else UNARMED_COLOR for window in plot.windows]
        shade = PolyCollection(
            corners, transform=whole, zorder=0.5, facecolors=colors, alpha=WINDOW_OPACITY, linewidth=0.0
        )
        axes.add_collection(shade, autolim=False)
    for declared, color, style in ((False, TRUTH_COLOR, ":"), (True, DECLARED_COLOR, "-")):
        times = [moment.time_s for moment in plot.moments if moment.declared == declared]
        if times:
            lines = [[(time_s, 0.0), (time_s, 1.0)] for time_s in times]
            rules = LineCollection(lines, transform=whole, colors=color, linewidths=THIN_LINE, linestyles=style)
            axes.add_collection(rules, autolim=False)


def _window_levels(windows: Sequence[ShadedWindow], seconds_per_inch: float) -> list[int]:
    """Assigns the name of each time window to the lowest text line that has room for it; returns line numbers."""
    ends: list[float] = []  # of the names at each level, s
    levels = []
    for window in windows:
        level = next((number for number, end in enumerate(ends) if end <= window.start_s), len(ends))
        ends[level:] = [window.start_s + _SMALL_LETTER * len(window.text) * seconds_per_inch, *ends[level + 1 :]]
        levels.append(level)
    return levels


def _label_window(axes: Axes, window: ShadedWindow, level: int) -> None:
    """Writes the name of a time window above a panel, on a numbered text line."""
    above = 1.0 + (0.03 + _WINDOW_STEP * level) * axes.figure.dpi / axes.bbox.height
    transform = axes.get_xaxis_transform()
    axes.text(window.start_s, above, window.text, transform=transform, fontsize=WINDOW_SIZE, color="#555555")


def set_symmetric_log(axes: Axes, small: float, large: float) -> None:
    """Makes a vertical axis linear up to a small value and logarithmic up to a large one, with few ticks."""
    first = math.ceil(math.log10(max(small, 1e-300)))
    last = max(math.floor(math.log10(max(large, 1e-300))), first)
    step = max(1, round((last - first) / 3))
    marks = [10.0**power for power in range(first, last + 1, step)]
    axes.set_yscale("symlog", linthresh=10.0**first, linscale=0.8)
    axes.set_yticks([*(-mark for mark in reversed(marks)), 0.0, *marks])
    _mark_powers_of_ten(axes)


def _mark_powers_of_ten(axes: Axes) -> None:
    """Limits the ticks of a vertical axis to powers of ten, as plain numbers."""
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


# -------------------------------------------------------------------------------------------- keys


def _key_rows(panel: Panel) -> list[list[Mark]]:
    """Arranges the labeled marks of a panel in legend rows that fit the figure's width."""
    rows: list[list[Mark]] = []
    for mark in panel.marks:
        if isinstance(mark, Bars) or not mark.label or (isinstance(mark, Points) and not mark.drawn):
            continue
        if not rows or _key_width([*rows[-1], mark]) > _WIDTH - _LEFT - _RIGHT - 0.7:
            rows.append([])
        rows[-1].append(mark)
    return rows


def _key_width(marks: Sequence[Mark]) -> float:
    """Estimates the width of a legend row, inches."""
    return sum(_entry_width(mark) for mark in marks)


def _entry_width(mark: Mark) -> float:
    """Estimates the width of a mark's legend entry, inches."""
    return 0.0 if isinstance(mark, Bars) else _HANDLE + 0.22 + _LETTER * len(mark.label)


def _draw_key(figure: Figure, rows: Sequence[Sequence[Mark]], bottom: float) -> None:
    """Draws a panel's legend, aligned right, clear of the exponent that an axis writes at the left."""
    width, height = figure.get_size_inches()
    for number, row in enumerate(reversed(rows)):
        at, level = _WIDTH - _RIGHT - _key_width(row), (bottom + _KEY * (number + 0.5)) / height
        for mark in row:
            figure.add_artist(_key_symbol(mark, at / width, (at + _HANDLE) / width, level))
            label = "" if isinstance(mark, Bars) else mark.label
            figure.text((at + _HANDLE + 0.06) / width, level, label, fontsize=KEY_SIZE, va="center_baseline")
            at += _entry_width(mark)


def _key_symbol(mark: Mark, left: float, right: float, level: float) -> Line2D:
    """Makes the legend symbol of a mark, placed in fractions of the figure."""
    middle = 0.5 * (left + right)
    match mark:
        case Points():
            return Line2D([middle], [level], color=mark.color, marker=_SYMBOLS[mark.symbol], markersize=6, linestyle="")
        case Whiskers():
            return Line2D([middle], [level], color=mark.color, marker="|", markersize=8, linestyle="")
        case Band() | Zone():
            handle = Line2D([left, right], [level, level], color=mark.color, alpha=mark.opacity, linewidth=7.0)
            handle.set_solid_capstyle("butt")
            return handle
        case Line():
            return Line2D([left, right], [level, level], color=mark.color, linestyle=_line_style(mark.dashed))
        case _:
            return Line2D([left, right], [level, level], color=mark.color, linestyle="--", linewidth=THIN_LINE)
