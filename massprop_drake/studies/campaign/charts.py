"""Plots of a campaign's pages, as plotly takes them.

Black is the color of the page's text, which the page's script puts in. All texts are plain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from massprop_drake.display.interactive import escape_text, rounded_numbers
from massprop_drake.display.style import BAND_COLOR, COLORS, ESTIMATE_COLOR, FAILED_COLOR, TRUTH_COLOR
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.studies.campaign.merit import InjectedEvent, OperatingPoint, failure_size
from massprop_drake.studies.campaign.statistics import Detections, Figure, SizeCurve

Array = NDArray[np.float64]
Json = dict[str, Any]

PARAMETERS = dict(zip(NAMES, SYMBOLS, strict=True))
_BAND = "22"  # opacity of a band, hexadecimal
_LEAST_DELAY_S = 0.05  # on a logarithmic axis
_DASHES = ("solid", "dash", "dot", "dashdot")  # once the colors have been used up
_CURVE_COLOR = "#7d8894"
_MOST_POINTS = 2000  # of a cloud
_MARGIN = {"l": 60, "r": 14, "t": 10, "b": 48}
_RIGHT, _WRONG, _NOTHING = (
    [[0.0, "#cfe4f3"], [1.0, ESTIMATE_COLOR]],
    [[0.0, "#fbdcc6"], [1.0, FAILED_COLOR]],
    [[0.0, "#dfe4ea"], [1.0, "#7d8894"]],
)
_DIVERGING = [[0.0, FAILED_COLOR], [0.5, "#f4f6f9"], [1.0, ESTIMATE_COLOR]]


def _style(number: int) -> tuple[str, str]:
    """Returns color and dash pattern of the n-th series; black is left to expected values."""
    colors = [color for color in COLORS if color != TRUTH_COLOR]
    return colors[number % len(colors)], _DASHES[number // len(colors) % len(_DASHES)]


def _axis(title: str, **options: Any) -> Json:
    """Makes a plotly axis with a plain-text title."""
    return {"title": {"text": escape_text(title), "font": {"size": 11}}, "automargin": True, **options}


def _log_axis(title: str, low: float, high: float, **options: Any) -> Json:
    """Makes a plotly logarithmic axis over a range, with few round numbers at its ticks."""
    ends = [math.log10(low), math.log10(high)]
    decades = range(math.floor(ends[0]), math.ceil(ends[1]) + 1)
    steps = (1.0,) if ends[1] - ends[0] > 2.5 else (1.0, 2.0, 5.0) if ends[1] - ends[0] > 0.6 else (1, 1.5, 2, 3, 5, 7)
    ticks = [float(f"{step}e{decade}") for decade in decades for step in steps]
    ticks = [tick for tick in ticks if low <= tick <= high]
    return _axis(title, type="log", range=ends, tickvals=ticks, ticktext=[f"{tick:g}" for tick in ticks], **options)


def _make_plot(
    name: str, title: str, traces: Sequence[Json], layout: Json, note: str = "", *, wide: bool = False
) -> Json:
    """Makes a plot for the page from its texts, plotly traces and layout."""
    return {
        "name": name,
        "title": title,
        "note": note,
        "wide": wide,
        "traces": list(traces),
        "layout": {"height": 330, "margin": _MARGIN, "legend": _KEY, **layout},
    }


_KEY = {"orientation": "h", "x": 0.0, "y": 1.02, "yanchor": "bottom", "font": {"size": 10}}


def _error_bars(figures: Sequence[Figure]) -> Json:
    """Makes plotly error bars from the figures' intervals; a bound that is missing or open has none."""

    def bar_length(value: float, bound: float) -> float | None:
        """Returns the distance of a bound from the value; None where either is not finite."""
        return abs(bound - value) if math.isfinite(value) and math.isfinite(bound) else None

    return {
        "type": "data",
        "symmetric": False,
        "array": [bar_length(figure.value, figure.high) for figure in figures],
        "arrayminus": [bar_length(figure.value, figure.low) for figure in figures],
        "thickness": 1.2,
        "width": 3,
    }


def _finite_values(figures: Sequence[Figure]) -> list[float | None]:
    """Returns the values of figures, None where not finite."""
    return [figure.value if math.isfinite(figure.value) else None for figure in figures]


def _line_trace(x: Array, y: Array, color: str, label: str = "", **options: Any) -> Json:
    """Makes a plotly trace of a line; without a label it is not in the legend."""
    style = {"color": color, "width": 1.6, **options.pop("line", {})}
    return {
        "type": "scatter", "mode": "lines", "x": rounded_numbers(x), "y": rounded_numbers(y), "line": style,
        "name": escape_text(label),
        "showlegend": bool(label), **options,
    }  # fmt: skip


def _band_traces(x: Array, low: Array, high: Array, color: str, **options: Any) -> list[Json]:
    """Makes two plotly traces of a shaded band between two curves."""
    shape = options.pop("shape", "linear")
    edge = {"line": {"width": 0, "shape": shape}, "hoverinfo": "skip", **options}
    return [
        _line_trace(x, low, color, **edge),
        _line_trace(x, high, color, **edge, fill="tonexty", fillcolor=f"{color}{_BAND}"),
    ]


# ------------------------------------------------------------------------------------------ delays


def delays(curves: Mapping[str, Detections], name: str = "delays", grouping: str = "by kind of failure") -> Json:
    """Plots Kaplan-Meier curves of detection delay, one color per group; delays below 50 ms are drawn at 50 ms."""
    traces: list[Json] = []
    longest = max([curve.followed_s for curve in curves.values()], default=0.0)
    for number, (label, curve) in enumerate(curves.items()):
        color, dash = _style(number)
        x = np.maximum(np.concatenate([[0.0], curve.delay_s, [curve.followed_s]]), _LEAST_DELAY_S)
        edges = [
            np.concatenate([[start], edge, edge[-1:] if edge.size else [start]])
            for start, edge in ((0.0, curve.low), (0.0, curve.found), (curve.at(0.0).high, curve.high))
        ]
        traces += _band_traces(x, edges[0], edges[2], color, shape="hv", legendgroup=str(number))
        words = f"{label} ({curve.n_found} of {curve.n})"
        traces.append(
            _line_trace(x, edges[1], color, words, line={"dash": dash, "shape": "hv"}, legendgroup=str(number))
        )
    layout = {
        "xaxis": _log_axis("time since the failure first acted, s", _LEAST_DELAY_S, max(1.05 * longest, 1.0)),
        "yaxis": _axis("probability of being found", range=[-0.02, 1.02]),
    }
    note = (
        "Kaplan-Meier, bands 95 %. What was never found, or taken for something else, is censored at the end of its "
        "flight; each curve ends where the longest flight does. In brackets: found, of those that acted."
    )
    return _make_plot(name, f"Delay to the right declaration, {grouping}", traces, layout, note)


def operating_curve(
    by_threshold: Sequence[OperatingPoint], by_cell: Sequence[OperatingPoint], as_flown: OperatingPoint, swept: str
) -> Json:
    """Plots share found, and delay, over false declarations per hour: by threshold, by cell, and as flown.

    Args:
        by_threshold: by threshold.
        by_cell: of the sweep.
        as_flown: the operating point.
        swept: what the labels of the cells are values of.
    """
    traces: list[Json] = []
    points_all = [*by_threshold, *by_cell, as_flown]
    high = max(point.false_per_hour.high for point in points_all)
    low = min(_rate_position(point) for point in points_all)
    panels: tuple[tuple[str, Callable[[OperatingPoint], Figure]], ...] = (
        ("", lambda point: point.found),
        ("2", lambda point: point.delay_s),
    )
    for axis, figure_of in panels:
        place = {"xaxis": f"x{axis}", "yaxis": f"y{axis}"}
        if by_threshold:
            x = np.array([_rate_position(point) for point in by_threshold])
            y = np.array([figure_of(point).value for point in by_threshold])
            settings = [f"likelihood argument at least {point.setting:.4g}" for point in by_threshold]
            label = "as flown, less what is below a threshold" if not axis else ""
            style = {"line": {"dash": "dot"}, "text": settings, "hoverinfo": "x+y+text"}
            traces.append(_line_trace(x, y, _CURVE_COLOR, label, **style, **place))
        for points, color, symbol, label in (
            (list(by_cell), ESTIMATE_COLOR, "circle", f"flown again with other {escape_text(swept)}"),
            ([as_flown], FAILED_COLOR, "star", "operating point"),
        ):
            if not points:
                continue
            figures = [figure_of(point) for point in points]
            false = [point.false_per_hour._replace(value=_rate_position(point)) for point in points]
            false = [figure._replace(low=max(figure.low, 0.2 * low)) for figure in false]
            traces.append(
                {
                    "type": "scatter", "mode": "markers+text", "x": [figure.value for figure in false],
                    "y": _finite_values(figures),
                    "error_x": {**_error_bars(false), "color": color},
                    "error_y": {**_error_bars(figures), "color": color},
                    "marker": {
                        "color": color, "size": 13 if symbol == "star" else 8,
                        "symbol": [symbol if point.false_per_hour.value else f"{symbol}-open" for point in points],
                    },
                    "text": [escape_text(str(point.setting)) if symbol == "circle" else "" for point in points],
                    "textposition": "top left", "textfont": {"size": 10}, "hoverinfo": "x+y+text",
                    "name": label, "showlegend": not axis, "legendgroup": symbol, **place,
                }
            )  # fmt: skip
    rate = "false declarations of jets per hour"
    layout = {
        "height": 480,
        "xaxis": _log_axis("", 0.5 * low, 1.3 * high, anchor="y", showticklabels=False),
        "xaxis2": _log_axis(rate, 0.5 * low, 1.3 * high, anchor="y2", matches="x"),
        "yaxis": _axis("share found", domain=[0.54, 1.0], range=[-0.02, 1.02]),
        "yaxis2": _axis("median delay, s", domain=[0.0, 0.46], anchor="x2", rangemode="tozero"),
    }
    note = (
        "Bars: 95 %. An open symbol has no false declaration: it stands at half of one, and its bar reaches to "
        "3 / hours flown. Jumps of the mass properties have another statistic and are not counted here."
    )
    if by_threshold:
        note += (
            " The dotted curve leaves out declarations of these flights with a lower likelihood argument. None was "
            "flown again for it, so that what would have been declared later is missing: of the share found it is a "
            "lower bound, and what a lower threshold would declare it cannot say."
        )
    return _make_plot("operating", "Operating curve", traces, layout, note)


def _rate_position(point: OperatingPoint) -> float:
    """Returns the false declarations per hour to draw on a logarithmic axis: for none, that of half of one."""
    figure = point.false_per_hour
    return figure.value or 0.5 / figure.n


# --------------------------------------------------------------------------------------- isolation


def confusion(counts: Mapping[tuple[str, str], int], order: Sequence[str], name: str, title: str) -> Json:
    """Plots a heat map of declared against true jet or jump: blue right, red wrong, gray not found.

    Args:
        counts: by true and declared name.
        order: of names, for both axes; others come behind.
        name, title: of the plot.
    """
    rows = _sort_names({true for true, _ in counts}, order)
    columns = _sort_names({named for _, named in counts}, order)
    place = {label: number for number, label in enumerate(columns)}
    kinds: dict[str, tuple[list[list[Any]], Any]] = {}
    empty = ("not found", "not tested")
    most = max(counts.values(), default=1)
    for kind, scale in (("right", _RIGHT), ("wrong", _WRONG), ("nothing", _NOTHING)):
        cells: list[list[Any]] = [[None] * len(columns) for _ in rows]
        for (true, named), count in counts.items():
            is_kind = "nothing" if named in empty else "right" if named in (true, "its cluster") else "wrong"
            if is_kind == kind:
                cells[rows.index(true)][place[named]] = count
        kinds[kind] = (cells, scale)
    traces = [
        {
            "type": "heatmap", "z": cells, "colorscale": scale, "zmin": 0, "zmax": most, "showscale": False,
            "x": list(range(len(columns))), "y": list(range(len(rows))), "hoverongaps": False,
            "text": [["" if cell is None else str(cell) for cell in line] for line in cells],
            "texttemplate": "%{text}", "textfont": {"size": 10}, "xgap": 1, "ygap": 1,
            "customdata": [[[escape_text(true), escape_text(named)] for named in columns] for true in rows],
            "hovertemplate": "%{customdata[0]} declared as %{customdata[1]}: %{z}<extra></extra>",
        }
        for cells, scale in kinds.values()
    ]  # fmt: skip
    layout = {
        "height": max(220, 90 + 17 * len(rows)),
        "margin": {**_MARGIN, "l": 70, "b": 70},
        "xaxis": _axis("", tickvals=list(range(len(columns))), ticktext=[escape_text(c) for c in columns],
                       tickfont={"size": 10}, tickangle=-90 if len(columns) > 8 else -30, showgrid=False,
                       range=[-0.5, len(columns) - 0.5], zeroline=False),
        "yaxis": _axis("", tickvals=list(range(len(rows))), ticktext=[escape_text(r) for r in rows],
                       tickfont={"size": 10}, showgrid=False, range=[len(rows) - 0.5, -0.5], zeroline=False),
    }  # fmt: skip
    note = (
        "From left: what failed; from below: what was declared. Blue: right; red: taken for something else; gray: not "
        "found, or not tested."
    )
    return _make_plot(name, title, traces, layout, note, wide=len(columns) > 14)


def _sort_names(names: set[str], order: Sequence[str]) -> list[str]:
    """Sorts names by a given order, and the others behind them alphabetically."""
    place = {name: number for number, name in enumerate(order)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), name))


# -------------------------------------------------------------------------------------------- sizes


def sizes(
    kind: str, failures: Sequence[InjectedEvent], curve: SizeCurve | None, bins: Sequence[Any], unit: str
) -> Json:
    """Plots the probability of detection over failure size: shares by bin of size, and the fitted curve."""
    traces: list[Json] = []
    if curve is not None:
        x = np.geomspace(curve.smallest, curve.largest, 80)
        middle, low, high = curve.at(x)
        traces += _band_traces(x, low, high, ESTIMATE_COLOR)
        traces.append(_line_trace(x, middle, ESTIMATE_COLOR, "logistic fit with 95 % band"))
    for right, y, label in ((True, 1.06, "found, one by one"), (False, -0.06, "not found")):
        x = np.array([failure_size(event) for event in failures if event.right == right])[:_MOST_POINTS]
        color = ESTIMATE_COLOR if right else FAILED_COLOR
        traces.append(
            {"type": "scatter", "mode": "markers", "x": rounded_numbers(x), "y": [y] * x.size, "name": label,
             "hoverinfo": "x",
             "marker": {"symbol": "line-ns-open", "size": 8, "color": color}}
        )  # fmt: skip
    centers = [math.sqrt(low * high) for low, high, _ in bins]
    shares = [figure for _, _, figure in bins]
    traces.append(
        {"type": "scatter", "mode": "markers", "x": centers, "y": _finite_values(shares), "name": "share by size, 95 %",
         "error_y": {**_error_bars(shares), "color": TRUTH_COLOR}, "marker": {"color": TRUTH_COLOR, "size": 7},
         "text": [f"{figure.n:g} failures" for figure in shares], "hoverinfo": "x+y+text"}
    )  # fmt: skip
    layout = {
        "xaxis": _log_axis(f"mean force too much or missing, {unit}", 0.85 * bins[0][0], 1.18 * bins[-1][1]),
        "yaxis": _axis("share found", range=[-0.12, 1.12], tickvals=[0, 0.25, 0.5, 0.75, 1]),
        "shapes": [_level_line(0.9, "x", "y")],
    }  # fmt: skip
    if curve is not None and math.isfinite(curve.size_90.value):
        note = f"Found with a probability of 0.9 (dashed) from {curve.size_90.value:.3g} {unit} on"
        note += f", 95 %: {curve.size_90.low:.3g} to " + (
            f"{curve.size_90.high:.3g} {unit}." if math.isfinite(curve.size_90.high) else "an unknown size."
        )
    elif curve is not None and curve.finds_all:
        note = "Every size from the smallest on is found with a probability above 0.9 (dashed)."
    elif curve is not None:
        note = "No size up to the largest is found with a probability of 0.9 (dashed)."
    else:
        note = "Too few failures, or too much alike in what became of them, for a curve. Dashed: 0.9."
    return _make_plot(f"sizes-{kind}", f"Probability of detection by size: {kind}", traces, layout, note)


def _level_line(y: float, x_axis: str, y_axis: str, color: str = TRUTH_COLOR) -> Json:
    """Makes a plotly shape of a dashed horizontal line across a panel."""
    return {
        "type": "line", "xref": f"{x_axis} domain", "yref": y_axis, "x0": 0, "x1": 1, "y0": y, "y1": y,
        "line": {"color": color, "width": 1, "dash": "dash"},
    }  # fmt: skip


def magnitudes(failures_by_group: Mapping[str, Sequence[InjectedEvent]], unit: str) -> Json:
    """Plots declared over true force of rightly declared failures, by group."""
    traces: list[Json] = []
    all_forces: list[float] = []
    for number, (kind, failures) in enumerate(failures_by_group.items()):
        pairs = [
            (record["force"], record["magnitude"], record["magnitude_std"] or 0.0)
            for record in (event.injected for event in failures if event.right)
            if None not in (record["force"], record["magnitude"])
        ][:_MOST_POINTS]
        if not pairs:
            continue
        true, declared, sigma = (np.array(part) for part in zip(*pairs, strict=True))
        all_forces += [*true.tolist(), *declared.tolist()]
        color, _ = _style(number)
        traces.append(
            {"type": "scatter", "mode": "markers", "x": rounded_numbers(true), "y": rounded_numbers(declared),
             "name": escape_text(kind),
             "error_y": {"type": "data", "array": rounded_numbers(2.0 * sigma), "thickness": 1, "width": 0,
                         "color": color},
             "marker": {"size": 6, "color": color}}
        )  # fmt: skip
    low, high = (min(all_forces), max(all_forces)) if all_forces else (0.0, 1.0)
    ends = np.array([low, high])
    traces.append(_line_trace(ends, ends, TRUTH_COLOR, "no error", line={"dash": "dash", "width": 1}))
    layout = {
        "xaxis": _axis(f"true mean force too much (+) or missing (-), {unit}"),
        "yaxis": _axis(f"declared, {unit}"),
    }
    note = "Failures declared as what they are; bars: 2-sigma as claimed."
    return _make_plot("magnitudes", "Magnitude, declared and true", traces, layout, note)


# ------------------------------------------------------------------------------------- consistency


def normal_histogram(values: Sequence[float], name: str, title: str, axis: str) -> Json:
    """Plots a histogram of errors over sigma, beside the expected numbers of a normal distribution."""
    traces, outside = _normal_bars(np.asarray(values, dtype=float), "", first=True)
    layout = {"xaxis": _axis(axis), "yaxis": _axis("number"), "bargap": 0.06}
    return _make_plot(name, title, traces, layout, _normal_note(outside, len(values)))


_EDGES = np.linspace(-6.0, 6.0, 25)


def _normal_bars(z: Array, axis: str, *, first: bool) -> tuple[list[Json], int]:
    """Makes plotly bars of errors over sigma with their normal expectation; also counts those beyond 6 sigma."""
    centers = 0.5 * (_EDGES[1:] + _EDGES[:-1])
    counts, _ = np.histogram(np.clip(z, -5.99, 5.99), _EDGES)
    expected = z.size * np.diff(stats.norm.cdf(_EDGES))
    place = {"xaxis": f"x{axis}", "yaxis": f"y{axis}"}
    bars = {
        "type": "bar", "x": rounded_numbers(centers), "y": counts.tolist(), "marker": {"color": ESTIMATE_COLOR},
        "name": "cases", "showlegend": first, "legendgroup": "cases", "hoverinfo": "x+y", **place,
    }  # fmt: skip
    style = {"line": {"shape": "hvh", "width": 1.2}, "legendgroup": "expected"}
    line = _line_trace(centers, expected, TRUTH_COLOR, "expected", **style, **place)
    return [bars, {**line, "showlegend": first}], int((np.abs(z) > 6.0).sum())


def _normal_note(n_outside: int, n: int) -> str:
    """Returns the note of a normal histogram, with the number of values beyond 6 sigma."""
    beyond = f"; {n_outside} of {n} values lie beyond 6 and are in the outermost bars" if n_outside else ""
    return f"Line: numbers expected of a consistent filter{beyond}."


def parameter_histograms(sigmas: Mapping[str, Sequence[float]]) -> Json:
    """Plots histograms of errors over claimed sigma, one panel per parameter."""
    traces: list[Json] = []
    layout: Json = {"height": 420, "bargap": 0.06, "annotations": [], "legend": {**_KEY, "x": 1.0, "xanchor": "right"}}
    outside = total = 0
    columns = 5
    for number, (name, values) in enumerate(sigmas.items()):
        axis = str(number + 1) if number else ""
        row, column = divmod(number, columns)
        z = np.asarray(values, dtype=float)
        bars, beyond = _normal_bars(z, axis, first=number == 0)
        traces += bars
        outside, total = outside + beyond, total + z.size
        left, top = column / columns, 1.0 - 0.54 * row
        x = [left + 0.022, left + 0.19]
        y = [top - 0.44, top - 0.05]
        layout[f"xaxis{axis}"] = {"domain": x, "anchor": f"y{axis}", "tickvals": [-6, -3, 0, 3, 6]}
        layout[f"yaxis{axis}"] = {"domain": y, "anchor": f"x{axis}", "nticks": 4, "automargin": False}
        layout["annotations"].append(
            {"xref": "paper", "yref": "paper", "x": x[0], "y": y[1] + 0.01, "text": PARAMETERS[name], "xanchor": "left",
             "yanchor": "bottom", "showarrow": False}
        )  # fmt: skip
    note = "Across: error / claimed 1-sigma at the end; up: number of cases. " + _normal_note(outside, total)
    layout["margin"] = {**_MARGIN, "l": 34, "b": 28, "t": 26}
    return _make_plot(
        "parameters", "Errors over claimed sigma, parameter by parameter", traces, layout, note, wide=True
    )


def chi_square(values: Sequence[float], degrees: int, texts: tuple[str, str, str], n: int = 1) -> Json:
    """Plots a histogram of a chi-square statistic on a logarithmic axis, with its 95 % band and expected numbers.

    Args:
        values: means of n chi-square statistics each.
        degrees: of freedom of one.
        texts: name and title of the plot, and what its axis shows.
        n: how many each value is the mean of.
    """
    x = np.asarray([value for value in values if value > 0.0], dtype=float)
    name, title, label = texts
    low, high = stats.chi2.ppf([0.025, 0.975], degrees * n) / n
    ends = math.log10(min(x.min(initial=low), 0.3 * low)), math.log10(max(x.max(initial=high), 3.0 * high))
    count = int(np.clip(round(3.0 * (ends[1] - ends[0]) / min(math.log10(high / low), 0.4)), 12, 90))
    edges = np.logspace(ends[0], ends[1], count + 1)
    edges[0], edges[-1] = edges[0] * (1.0 - 1e-9), edges[-1] * (1.0 + 1e-9)
    counts, _ = np.histogram(x, edges)
    expected = x.size * np.diff(stats.chi2.cdf(edges * n, degrees * n))
    centers = np.sqrt(edges[1:] * edges[:-1])
    traces: list[Json] = [
        _line_trace(edges, np.append(counts, counts[-1]), ESTIMATE_COLOR, "cases", line={"shape": "hv", "width": 1},
              fill="tozeroy", fillcolor=f"{ESTIMATE_COLOR}bb"),
        _line_trace(centers, expected, TRUTH_COLOR, "expected", line={"shape": "hvh", "width": 1.2}),
    ]  # fmt: skip
    layout = {
        "xaxis": _log_axis(label, float(edges[0]), float(edges[-1])),
        "yaxis": _axis("number of cases"),
        "shapes": [
            {"type": "rect", "xref": "x", "yref": "y domain", "x0": float(low), "x1": float(high), "y0": 0, "y1": 1,
             "fillcolor": BAND_COLOR, "opacity": 0.25, "line": {"width": 0}, "layer": "below"}
        ],
    }  # fmt: skip
    return _make_plot(name, title, traces, layout, f"Shaded: the band that holds 95 %, {low:.3g} to {high:.3g}.")


def coverage(shares: Mapping[str, Mapping[float, Figure]]) -> Json:
    """Plots shares of estimates within 1, 2 and 3 sigma, by parameter, beside the expected ones."""
    traces: list[Json] = []
    layout: Json = {
        "xaxis": _axis("", tickvals=list(range(len(shares))), ticktext=[PARAMETERS[name] for name in shares]),
        "yaxis": _axis("share of cases", range=[-0.02, 1.04], tickformat=".0%"),
        "shapes": [],
    }
    for number, sigma in enumerate((1.0, 2.0, 3.0)):
        color, _ = _style(number)
        figures = [by_sigma[sigma] for by_sigma in shares.values()]
        traces.append(
            {"type": "scatter", "mode": "markers", "x": [place + 0.16 * (number - 1) for place in range(len(shares))],
             "y": _finite_values(figures), "error_y": {**_error_bars(figures), "color": color},
             "name": f"within {sigma:g} sigma",
             "marker": {"color": color, "size": 7}, "hoverinfo": "y+name"}
        )  # fmt: skip
        layout["shapes"].append(_level_line(float(stats.chi2.cdf(sigma**2, 1)), "x", "y", color))
    note = "Bars: 95 %. Dashed: 68.3, 95.4 and 99.7 %, as of a consistent filter."
    return _make_plot("coverage", "Estimates within what they claim", traces, layout, note)


def coverage_over_time(shares: Mapping[float, Mapping[str, Figure]]) -> Json:
    """Plots shares within 3 sigma at chosen times, of the rotational parameters and of 1/m."""
    traces: list[Json] = []
    for number, label in enumerate(next(iter(shares.values()))):
        color, _ = _style(number)
        figures = [parts[label] for parts in shares.values()]
        traces.append(
            {"type": "scatter", "mode": "lines+markers", "x": list(shares), "y": _finite_values(figures), "name": label,
             "error_y": {**_error_bars(figures), "color": color}, "line": {"color": color, "width": 1.6}}
        )  # fmt: skip
    layout: Json = {
        "xaxis": _axis("time, s"),
        "yaxis": _axis("share within 3 sigma", range=[-0.02, 1.04], tickformat=".0%"),
        "shapes": [_level_line(0.9973, "x", "y")],
    }
    return _make_plot("over-time", "Estimates within 3 sigma, over time", traces, layout, "Bars: 95 %. Dashed: 99.7 %.")


# ------------------------------------------------------------------------------------- sensitivity


def correlations(coefficients: Mapping[str, Mapping[str, Figure]], name: str, title: str) -> Json:
    """Plots a heat map of rank correlations of errors with draws; bold where the interval excludes zero."""
    draws = list(dict.fromkeys(draw for by_draw in coefficients.values() for draw in by_draw))
    cells = [[by_draw.get(draw) for by_draw in coefficients.values()] for draw in draws]
    sure = sum(cell is not None and cell.low * cell.high > 0.0 for line in cells for cell in line)
    total = sum(cell is not None for line in cells for cell in line)
    note = (
        f"Spearman's rank correlation; bold: {sure} of {total} whose 95 % interval leaves out zero, of which about "
        f"{0.05 * total:.0f} would by chance alone. Draws that are no numbers, such as jets, are not in it."
    )
    text = [["" if cell is None else _correlation_text(cell) for cell in line] for line in cells]
    return _heat_map((name, title, note), [PARAMETERS[parameter] for parameter in coefficients], draws, cells, text)


def _correlation_text(correlation: Figure) -> str:
    """Formats a correlation, bold where its interval excludes zero."""
    text = f"{correlation.value:+.2f}"
    return f"<b>{text}</b>" if correlation.low * correlation.high > 0.0 else text


def sobol(indices: Sequence[Sequence[Figure]], names: Sequence[str], draws: Sequence[str], order: str) -> Json:
    """Plots a heat map of Sobol indices of each parameter's error, by draw."""
    cells = [[by_draw[number] for by_draw in indices] for number in range(len(draws))]
    text = [[f"{cell.value:.2f}" for cell in line] for line in cells]
    note = f"Share of the variance of the error that is due to a draw {order}; point at a cell for its 95 % interval."
    kind = ("sobol-total", "Sobol indices, total") if "with" in order else ("sobol-first", "Sobol indices, first order")
    return _heat_map((*kind, note), [PARAMETERS[name] for name in names], draws, cells, text)


def _heat_map(
    texts: tuple[str, str, str],
    columns: Sequence[str],
    rows: Sequence[str],
    cells: Sequence[Sequence[Figure | None]],
    text: Sequence[Sequence[str]],
) -> Json:
    """Plots a heat map of figures from -1 to 1, with cell texts; `texts` are name, title and note of the plot."""
    interval = [
        ["" if cell is None else f"{cell.low:.2f} to {cell.high:.2f} (n = {cell.n:g})" for cell in line]
        for line in cells
    ]
    trace = {
        "type": "heatmap", "z": [[None if cell is None else round(cell.value, 4) for cell in line] for line in cells],
        "x": list(range(len(columns))), "y": list(range(len(rows))), "zmin": -1, "zmax": 1,
        "colorscale": _DIVERGING, "text": text, "texttemplate": "%{text}", "customdata": interval,
        "textfont": {"size": 10}, "hovertemplate": "%{z}, 95 %: %{customdata}<extra></extra>", "xgap": 1, "ygap": 1,
        "colorbar": {"thickness": 10, "outlinewidth": 0},
    }  # fmt: skip
    layout = {
        "height": max(240, 80 + 22 * len(rows)),
        "xaxis": _axis("error of", tickvals=list(range(len(columns))), ticktext=[escape_text(c) for c in columns],
                       showgrid=False, zeroline=False),
        "yaxis": _axis("", tickvals=list(range(len(rows))), ticktext=[escape_text(r) for r in rows],
                       tickfont={"size": 10},
                       showgrid=False, zeroline=False, range=[len(rows) - 0.5, -0.5]),
    }  # fmt: skip
    return _make_plot(*texts[:2], [trace], layout, texts[2], wide=True)
