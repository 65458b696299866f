"""Plotly's figures show what their descriptions say."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from massprop_drake.display import interactive, plots
from massprop_drake.display.run import Run
from massprop_drake.display.spec import (
    Band,
    Bars,
    Level,
    Line,
    Mark,
    MomentLine,
    Panel,
    Plot,
    Points,
    ShadedWindow,
    SymmetricLog,
    Whiskers,
    Zone,
)

TIME = np.linspace(0.0, 10.0, 11)
BLUE = "#0072B2"


def only(*marks: Mark, **about: Any) -> dict[str, Any]:
    return interactive.plotly_figure(Plot("some", "Title", "caption", TIME, (Panel("label", "unit", marks, **about),)))


def test_marks_become_traces_of_their_data_and_look() -> None:
    (trace,) = only(Line(TIME, TIME**2, BLUE, "square", steps=True))["traces"]
    assert "x" not in trace  # over the sample times
    np.testing.assert_allclose(trace["y"], TIME**2)
    assert (trace["mode"], trace["line"]["shape"], trace["line"]["color"]) == ("lines", "hv", BLUE)
    assert (trace["name"], trace["showlegend"]) == ("square", True)
    (trace,) = only(Line(TIME[:2], np.array([1.0, np.nan]), BLUE))["traces"]
    assert (trace["x"], trace["y"]) == ([0.0, 1.0], [1.0, None])
    (trace,) = only(Points(TIME[2:4], TIME[2:4] * 2.0, BLUE))["traces"]
    assert (trace["mode"], trace["x"], trace["y"]) == ("markers", [2.0, 3.0], [4.0, 6.0])
    (trace,) = only(Whiskers(TIME[:2], TIME[:2] - 1.0, TIME[:2] + 1.0, BLUE))["traces"]
    assert (trace["x"], trace["y"]) == ([0.0, 0.0, None, 1.0, 1.0, None], [-1.0, 1.0, None, 0.0, 2.0, None])
    low, high = only(Band(TIME, -TIME, 2.0 * TIME, color=BLUE, label="band", opacity=1.0))["traces"]
    np.testing.assert_allclose(low["y"], -TIME)
    np.testing.assert_allclose(high["y"], 2.0 * TIME)
    assert (high["fill"], high["fillcolor"], high["name"]) == ("tonexty", f"{BLUE}ff", "band")
    assert high["meta"]["half"]  # read as half of what lies between
    (level,) = only(Level(6.0, label="six"))["layout"]["shapes"]
    assert (level["xref"], level["x0"], level["x1"], level["y0"], level["y1"]) == ("x domain", 0, 1, 6.0, 6.0)
    assert (level["name"], level["showlegend"]) == ("six", True)
    (zone,) = only(Zone(0.2, 9.0))["layout"]["shapes"]
    assert (zone["type"], zone["y0"], zone["y1"]) == ("rect", 0.2, 9.0)


def test_bars_lie_in_named_rows_from_the_top_down() -> None:
    figure = only(
        Bars(np.array([1.0, 4.0]), np.array([2.0, 7.0]), np.array([0.0, 1.0]), BLUE), rows=("first", "second")
    )
    (trace,) = figure["traces"]
    assert trace["x"] == [1.0, 2.0, None, 4.0, 7.0, None]
    assert trace["text"] == ["first", "first", "", "second", "second", ""]
    axis = figure["layout"]["yaxis"]
    assert (axis["ticktext"], axis["range"][0] > axis["range"][1]) == (["first", "second"], True)


def test_a_scale_is_that_of_its_panel() -> None:
    line, band = Line(TIME, -TIME - 1.0, BLUE, "error"), Band(TIME, -TIME - 1.0, TIME + 1.0, label="3-sigma")
    assert only(line)["layout"]["yaxis"]["type"] == "linear"
    axis = only(line, scale="log", limits=(0.1, 100.0))["layout"]["yaxis"]
    assert axis["type"] == "log"
    np.testing.assert_allclose(axis["range"], [-1.0, 2.0])
    figure = only(band, line, scale=SymmetricLog(1.0, 10.0))  # plotly has none: a linear view, and one of magnitudes
    assert list(figure["views"]) == ["yaxis"]
    linear, log = ([trace for trace in figure["traces"] if trace["view"] == view] for view in ("linear", "log"))
    assert len(linear) == 3  # two edges of the band
    for trace, values in ((linear[-1], -TIME - 1.0), (log[0], TIME + 1.0), (log[1], TIME + 1.0)):
        np.testing.assert_allclose(trace["y"], values)
    keys = tuple(Line(TIME, TIME, BLUE, f"label of mark {number}") for number in range(8))
    heights = [only(*keys[:count])["layout"]["height"] for count in (0, 1, 8)]
    assert heights == sorted(set(heights))  # a key has room above its panel


def test_panels_stand_one_above_the_other_over_one_axis_of_time() -> None:
    panels = tuple(Panel(name, "", (Line(TIME, TIME, BLUE),)) for name in "abc")
    moments = (MomentLine(3.0, declared=False), MomentLine(4.0, declared=True))
    layout = interactive.plotly_figure(Plot("some", "T", "c", TIME, panels, (ShadedWindow(1.0, 2.0, "w"),), moments))[
        "layout"
    ]
    domains = [layout[axis]["domain"] for axis in ("yaxis", "yaxis2", "yaxis3")]
    edges = [edge for low, high in domains for edge in (high, low)]
    assert edges == sorted(edges, reverse=True)
    assert edges[-1] == pytest.approx(0.0, abs=1e-12)
    assert (layout["xaxis"]["anchor"], layout["xaxis"]["range"]) == ("y3", [0.0, 10.0])
    assert [shape["x0"] for shape in layout["shapes"]] == [1.0, 3.0, 4.0] * 3
    assert {shape["yref"] for shape in layout["shapes"]} == {"y domain", "y2 domain", "y3 domain"}


def test_a_page_holds_every_list_of_numbers_of_a_run_once(stuck_run: Run) -> None:
    source = plots.source(stuck_run)
    figures = {name: interactive.plotly_figure(plot(source)) for name, plot in plots.available_plots(source).items()}
    assert [figure["name"] for figure in figures.values()] == list(figures)
    expected = np.degrees(stuck_run["rate"][:, 2])  # to six digits
    np.testing.assert_allclose(figures["rates"]["traces"][2]["y"], expected, rtol=1e-5, atol=1e-12)
    whole = json.loads(json.dumps(list(figures.values()), allow_nan=False))
    page = interactive.pack_figures(list(figures.values()))
    assert len(set(map(tuple, page["lists"]))) == len(page["lists"])
    for figure, before in zip(page["plots"], whole, strict=True):
        assert [page["shapes"][shape] for shape in figure["layout"]["shapes"]] == before["layout"]["shapes"]
        for trace, was in zip(figure["traces"], before["traces"], strict=True):
            for key in {"x", "y"} & set(was):
                assert unfolded(page["lists"], trace[key]) == was[key]
    assert len(json.dumps(page)) < 0.85 * len(json.dumps(whole))


def unfolded(lists: list[list[float | None]], at: int | tuple[int, str]) -> list[float | None]:
    """As the page does it."""
    if isinstance(at, int):
        return lists[at]
    sign = {"minus": lambda value: -value, "abs": abs}[at[1]]
    return [None if value is None else sign(value) for value in lists[at[0]]]
