"""Description of a plot as data for any renderer: panels with marks in them, over time or over a quantity.

A `Plot` says everything that its picture shows and nothing of how it is drawn: `figures` draws it with
matplotlib, `interactive` with plotly.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.style import (
    BAND_COLOR,
    BAND_OPACITY,
    LINE_WIDTH,
    POINT_SIZE,
    THIN_LINE,
    TRUTH_COLOR,
)

Array = NDArray[np.float64]


class Line(NamedTuple):
    """A curve through values; NaN interrupts it.

    Attributes:
        x: times, s, or values of what the panel is drawn over, shape (n,).
        y: values in the unit of the panel, shape (n,).
        color: as '#rrggbb'.
        label: in the legend; empty for no entry. The same for every mark below.
        width: points.
        dashed: whether the curve is dashed.
        steps: whether a value holds until the next one, instead of a straight line between them.
    """

    x: Array
    y: Array
    color: str
    label: str = ""
    width: float = LINE_WIDTH
    dashed: bool = False
    steps: bool = False


class Points(NamedTuple):
    """Single values.

    Attributes:
        x: times, s, shape (n,).
        y: values, shape (n,).
        color, label: as of a `Line`.
        size: points.
        symbol: a dot; a vertical tick for an event; or a triangle up or down for a value beyond the panel's limits,
            which stands at the edge.
        drawn: whether they are drawn; else they are only read, where a reader asks for values at a time.
        group: of many of which a reader wants the largest, what they are; empty: these are read by themselves.
    """

    x: Array
    y: Array
    color: str
    label: str = ""
    size: float = POINT_SIZE
    symbol: Literal["dot", "tick", "up", "down"] = "dot"
    drawn: bool = True
    group: str = ""


class Whiskers(NamedTuple):
    """Vertical lines from a low to a high value: error bars, or the range of many values.

    Attributes:
        x: times, s, shape (n,).
        low, high: ends, shape (n,) each.
        color, label: as of a `Line`.
        width: points.
    """

    x: Array
    low: Array
    high: Array
    color: str
    label: str = ""
    width: float = THIN_LINE


class Band(NamedTuple):
    """The area between two curves.

    Attributes:
        x: times, s, shape (n,).
        low, high: edges, shape (n,) each.
        color, label, steps: as of a `Line`.
        opacity: 0 to 1.
    """

    x: Array
    low: Array
    high: Array
    color: str = BAND_COLOR
    label: str = ""
    opacity: float = BAND_OPACITY
    steps: bool = False


class Bars(NamedTuple):
    """Horizontal bars in the rows of a panel.

    Attributes:
        begin, end: times, s, shape (n,) each.
        row: whole number of the row each bar lies in, from 0 at the top, shape (n,).
        color: of all.
        height: of each, in rows.
        label: what they show, for a reader who asks; it stands in no legend.
    """

    begin: Array
    end: Array
    row: Array
    color: str
    height: float = 0.84
    label: str = ""


class Level(NamedTuple):
    """A dashed horizontal line, such as a threshold."""

    y: float
    color: str = TRUTH_COLOR
    label: str = ""


class Zone(NamedTuple):
    """A shaded range of values at all times, such as the one that a statistic should stay in."""

    low: float
    high: float
    color: str = BAND_COLOR
    label: str = ""
    opacity: float = BAND_OPACITY


Mark = Line | Points | Whiskers | Band | Bars | Level | Zone


class SymmetricLog(NamedTuple):
    """A scale that is linear around zero and logarithmic beyond.

    Attributes:
        small: where the logarithmic parts begin, about.
        large: the largest magnitude to show.
    """

    small: float
    large: float


class Over(NamedTuple):
    """A quantity along the horizontal axis of a panel, in place of the time.

    Attributes:
        label, unit: of it.
        limits: low and high.
    """

    label: str
    unit: str
    limits: tuple[float, float]

    @property
    def axis_label(self) -> str:
        """Label and unit, such as 'attitude error x, deg'."""
        return f"{self.label}, {self.unit}"


class Panel(NamedTuple):
    """One pair of axes of a plot.

    Attributes:
        label: what the vertical axis shows.
        unit: of it; empty for none.
        marks: what is drawn, in this order.
        scale: of the vertical axis.
        limits: of the vertical axis, low and high; None: as the marks need.
        rows: names of the rows 0, 1, ... from the top down, in place of numbers on the vertical axis.
        over: what the horizontal axis shows, where it is not the time; its first mark is then a path over the sample
            times of its plot.
        most: whether the limits are those of most of its points; where a reader zooms in time,
            they are those of most that are in the window.
    """

    label: str
    unit: str
    marks: tuple[Mark, ...]
    scale: Literal["linear", "log"] | SymmetricLog = "linear"
    limits: tuple[float, float] | None = None
    rows: tuple[str, ...] = ()
    over: Over | None = None
    most: bool = False

    @property
    def axis_label(self) -> str:
        """Label and unit, such as 'x, deg/s'."""
        return f"{self.label}, {self.unit}" if self.unit else self.label


class ShadedWindow(NamedTuple):
    """A shaded interval of time, s, and its name: something is commanded, or the detector is not armed."""

    start_s: float
    end_s: float
    text: str
    armed: bool = True


class MomentLine(NamedTuple):
    """A vertical line at a time, s: something happens (dotted) or is declared by the detector (solid)."""

    time_s: float
    declared: bool


class Plot(NamedTuple):
    """Panels one above the other over the same time; or beside each other, each over a quantity of its own.

    Attributes:
        name: of its file and of its place in a page.
        title: what it shows.
        caption: whose data it shows.
        time_s: sample times, s, shape (n,); the axis of time spans them.
        panels: from the top down, or from the left; over the time all, or none.
        windows, moments: shown in every panel.
        note: what shades and vertical lines mean.
        meaning: what its marks mean, where no label says it.
        folded: whether a page shows it only when it is asked for.
    """

    name: str
    title: str
    caption: str
    time_s: Array
    panels: tuple[Panel, ...]
    windows: tuple[ShadedWindow, ...] = ()
    moments: tuple[MomentLine, ...] = ()
    note: str = ""
    meaning: str = ""
    folded: bool = False
