"""Plotly's figures show what their descriptions say."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from massprop_drake.display import interactive, plots
from massprop_drake.display.spec import (
    Band,
    Bars,
    Level,
    Line,
    Mark,
    MomentLine,
    Over,
    Panel,
    Plot,
    Points,
    ShadedWindow,
    SymmetricLog,
    Whiskers,
    Zone,
)
from massprop_drake.results.run import Run

TIME = np.linspace(0.0, 10.0, 11)
BLUE = "#0072B2"


def only(mark: Mark, **about: Any) -> dict[str, Any]:
    return interactive.drawn(Plot("some", "Title", "caption", TIME, (Panel("label", "unit", (mark,), **about),)))


def test_a_line_over_the_sample_times_carries_its_values_alone() -> None:
    (trace,) = only(Line(TIME, TIME**2, BLUE, "square", steps=True))["traces"]
    assert "x" not in trace
    np.testing.assert_allclose(trace["y"], TIME**2)
    assert (trace["mode"], trace["line"]["shape"], trace["line"]["color"]) == ("lines", "hv", BLUE)
    assert (trace["name"], trace["showlegend"]) == ("square", True)


def test_values_that_are_missing_are_null() -> None:
    (trace,) = only(Line(TIME[:2], np.array([1.0, np.nan]), BLUE))["traces"]
    assert (trace["x"], trace["y"]) == ([0.0, 1.0], [1.0, None])


def test_points_are_markers() -> None:
    (trace,) = only(Points(TIME[2:4], TIME[2:4] * 2.0, BLUE))["traces"]
    assert (trace["mode"], trace["x"], trace["y"]) == ("markers", [2.0, 3.0], [4.0, 6.0])


def test_whiskers_are_lines_with_gaps_between() -> None:
    (trace,) = only(Whiskers(TIME[:2], TIME[:2] - 1.0, TIME[:2] + 1.0, BLUE))["traces"]
    assert trace["x"] == [0.0, 0.0, None, 1.0, 1.0, None]
    assert trace["y"] == [-1.0, 1.0, None, 0.0, 2.0, None]


def test_a_band_is_filled_from_its_lower_to_its_upper_edge() -> None:
    low, high = only(Band(TIME, -TIME, TIME, color=BLUE, label="band", opacity=1.0))["traces"]
    np.testing.assert_allclose(low["y"], -TIME)
    np.testing.assert_allclose(high["y"], TIME)
    assert (high["fill"], high["fillcolor"], high["name"]) == ("tonexty", f"{BLUE}ff", "band")


def test_bars_lie_in_named_rows_from_the_top_down() -> None:
    bars = Bars(np.array([1.0, 4.0]), np.array([2.0, 7.0]), np.array([0.0, 1.0]), BLUE)
    figure = only(bars, rows=("first", "second"))
    (trace,) = figure["traces"]
    assert trace["x"] == [1.0, 2.0, None, 4.0, 7.0, None]
    assert trace["text"] == ["first", "first", "", "second", "second", ""]
    axis = figure["layout"]["yaxis"]
    assert axis["ticktext"] == ["first", "second"]
    assert axis["range"][0] > axis["range"][1]


def test_levels_and_zones_span_the_times() -> None:
    (level,) = only(Level(6.0, label="six"))["layout"]["shapes"]
    assert (level["xref"], level["x0"], level["x1"], level["y0"], level["y1"]) == ("x domain", 0, 1, 6.0, 6.0)
    assert (level["name"], level["showlegend"]) == ("six", True)
    (zone,) = only(Zone(0.2, 9.0))["layout"]["shapes"]
    assert (zone["type"], zone["y0"], zone["y1"]) == ("rect", 0.2, 9.0)


def test_a_scale_is_that_of_its_panel() -> None:
    line = Line(TIME, TIME + 1.0, BLUE)
    assert only(line)["layout"]["yaxis"]["type"] == "linear"
    axis = only(line, scale="log", limits=(0.1, 100.0))["layout"]["yaxis"]
    assert axis["type"] == "log"
    np.testing.assert_allclose(axis["range"], [-1.0, 2.0])


def test_a_symmetric_logarithmic_panel_has_a_linear_view_and_one_of_magnitudes() -> None:
    line, band = Line(TIME, -TIME, BLUE, "error"), Band(TIME, -TIME - 1.0, TIME + 1.0, label="3-sigma")
    panel = Panel("label", "%", (band, line), scale=SymmetricLog(1.0, 10.0))
    figure = interactive.drawn(Plot("some", "Title", "caption", TIME, (panel,)))
    assert list(figure["views"]) == ["yaxis"]
    linear = [trace for trace in figure["traces"] if trace["view"] == "linear"]
    log = [trace for trace in figure["traces"] if trace["view"] == "log"]
    np.testing.assert_allclose(linear[-1]["y"], -TIME)
    assert len(linear) == 3  # two edges of the band
    np.testing.assert_allclose(log[0]["y"], TIME + 1.0)
    np.testing.assert_allclose(log[1]["y"], TIME)


def test_panels_stand_one_above_the_other_over_one_axis_of_time() -> None:
    panels = tuple(Panel(name, "", (Line(TIME, TIME, BLUE),)) for name in "abc")
    moments = (MomentLine(3.0, declared=False), MomentLine(4.0, declared=True))
    layout = interactive.drawn(Plot("some", "T", "c", TIME, panels, (ShadedWindow(1.0, 2.0, "w"),), moments))["layout"]
    domains = [layout[axis]["domain"] for axis in ("yaxis", "yaxis2", "yaxis3")]
    assert 1.0 > domains[0][1] > domains[0][0] > domains[1][1] > domains[1][0] > domains[2][1]
    assert domains[2][0] == pytest.approx(0.0, abs=1e-12)
    assert (layout["xaxis"]["anchor"], layout["xaxis"]["range"]) == ("y3", [0.0, 10.0])
    assert [shape["x0"] for shape in layout["shapes"]] == [1.0, 3.0, 4.0] * 3
    assert {shape["yref"] for shape in layout["shapes"]} == {"y domain", "y2 domain", "y3 domain"}


def test_panels_over_a_quantity_have_axes_of_their_own_and_a_path_to_read() -> None:
    over = [Over(f"error {letter}", "deg", (-2.0, 2.0)) for letter in "xy"]
    marks = (Line(TIME, TIME, BLUE, "path"), Line(TIME[:2], TIME[:2], BLUE, "wanted"))
    panels = tuple(Panel(f"rate {letter}", "deg/s", marks, over=each) for letter, each in zip("xy", over, strict=True))
    moments = (MomentLine(3.0, declared=False),)
    figure = interactive.drawn(Plot("some", "T", "c", TIME, panels, (), moments))
    assert [(trace["xaxis"], trace["yaxis"]) for trace in figure["traces"]] == [("x", "y")] * 2 + [("x2", "y2")] * 2
    assert [trace.get("meta") for trace in figure["traces"]] == [
        {"label": "rate x", "unit": "deg/s", "over": ["error x", "deg"]},
        None,
        {"label": "rate y", "unit": "deg/s", "over": ["error y", "deg"]},
        None,
    ]
    layout = figure["layout"]
    assert layout["shapes"] == []  # a moment in time has no place
    places = [(label["text"], label["xref"], label["yref"]) for label in layout["annotations"]]
    assert places == [("rate x, deg/s", "x domain", "y domain"), ("rate y, deg/s", "x2 domain", "y2 domain")]
    assert [layout[axis]["title"]["text"] for axis in ("xaxis", "xaxis2")] == ["error x, deg", "error y, deg"]
    assert layout["xaxis2"]["range"] == [-2.0, 2.0]


def test_every_plot_of_a_run_can_be_drawn(stuck_run: Run) -> None:
    source = plots.source(stuck_run)
    for name, plot in plots.available(source).items():
        figure = interactive.drawn(plot(source))
        assert figure["name"] == name
        assert figure["traces"]
        json.dumps(figure, allow_nan=False)


def test_the_numbers_are_those_of_the_run_to_six_digits(stuck_run: Run) -> None:
    figure = interactive.drawn(plots.rates(plots.source(stuck_run)))
    expected = np.degrees(stuck_run["rate"][:, 2])
    np.testing.assert_allclose(figure["traces"][2]["y"], expected, rtol=1e-5, atol=1e-12)
    assert figure["traces"][2]["yaxis"] == "y3"


def test_a_key_of_many_entries_has_room_above_its_panel() -> None:
    few, many = (
        tuple(Line(TIME, TIME, BLUE, f"label of mark {number}") for number in range(count)) for count in (1, 8)
    )
    heights = [
        interactive.drawn(Plot("some", "T", "c", TIME, (Panel("a", "", marks),)))["layout"]["height"]
        for marks in ((), few, many)
    ]
    assert heights[0] < heights[1] < heights[2]


def test_a_page_holds_every_list_of_numbers_once(stuck_run: Run) -> None:
    source = plots.source(stuck_run)
    figures = [interactive.drawn(plot(source)) for plot in plots.available(source).values()]
    whole = json.loads(json.dumps(figures))
    page = interactive.packed(figures)
    assert len(set(map(tuple, page["lists"]))) == len(page["lists"])
    for figure, expected in zip(page["plots"], whole, strict=True):
        assert [page["shapes"][shape] for shape in figure["layout"]["shapes"]] == expected["layout"]["shapes"]
        for trace, before in zip(figure["traces"], expected["traces"], strict=True):
            for key in {"x", "y"} & set(before):
                assert unfolded(page["lists"], trace[key]) == before[key]
    assert len(json.dumps(page)) < 0.85 * len(json.dumps(whole))


def unfolded(lists: list[list[float | None]], at: int | tuple[int, str]) -> list[float | None]:
    """As the page does it."""
    if isinstance(at, int):
        return lists[at]
    sign = {"minus": lambda value: -value, "abs": abs}[at[1]]
    return [None if value is None else sign(value) for value in lists[at[0]]]
