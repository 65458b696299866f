"""Figures, of matplotlib and of plotly, show what their descriptions say."""

from __future__ import annotations

import gc
import io
import json
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

from massprop_drake.display import figures, interactive, motion_plots, plots
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
from massprop_drake.inputs.vehicle_sensors import PoseSensor

TIME = np.linspace(0.0, 10.0, 11)
BLUE = "#0072B2"
LINE = Line(TIME, TIME + 1.0, BLUE)


def plot(*panels: Panel, windows: tuple[ShadedWindow, ...] = (), moments: tuple[MomentLine, ...] = ()) -> Plot:
    return Plot("some", "Title", "caption", TIME, panels, windows, moments, "note")


def only(mark: Mark, **about: object) -> Figure:
    return figures.draw_plot(plot(Panel("label", "unit", (mark,), **about)))  # type: ignore[arg-type]


def collections(figure: Figure, kind: type) -> list:
    return [found for found in figure.axes[0].collections if isinstance(found, kind)]


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text)]


def test_marks_have_the_data_and_the_look_of_their_descriptions() -> None:
    figure = only(Line(TIME, TIME**2, BLUE, "square", width=2.0, dashed=True, steps=True))
    (line,) = figure.axes[0].lines
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([TIME, TIME**2]))
    looks = line.get_color(), line.get_linewidth(), line.get_linestyle(), line.get_drawstyle()
    assert looks == (BLUE, 2.0, "--", "steps-post")
    assert {"label, unit", "Title   (caption)", "time, s   (note)", "square"} <= set(texts(figure))
    (line,) = only(Points(TIME, TIME, BLUE, size=3.0)).axes[0].lines
    np.testing.assert_array_equal(line.get_ydata(), TIME)
    assert (line.get_linestyle(), line.get_marker(), line.get_markersize()) == ("None", ".", 3.0)
    (ticks,) = only(Points(TIME, TIME, BLUE, symbol="tick")).axes[0].lines
    assert ticks.get_marker() == "|"
    (whiskers,) = collections(only(Whiskers(TIME, TIME - 1.0, TIME + 1.0, BLUE)), LineCollection)
    np.testing.assert_array_equal(np.array(whiskers.get_segments())[:, :, 1], np.stack([TIME - 1, TIME + 1], axis=1))
    (band,) = only(Band(TIME, -TIME, TIME, opacity=0.5)).axes[0].collections
    assert band.get_alpha() == 0.5
    edges = {tuple(vertex) for vertex in band.get_paths()[0].vertices.tolist()}
    assert {(x, sign * x) for x in TIME for sign in (-1.0, 1.0)} <= edges
    (level,) = only(Level(6.0)).axes[0].lines
    assert list(level.get_ydata()) == [6.0, 6.0]
    (zone,) = only(Zone(0.2, 9.0)).axes[0].patches
    assert (zone.get_y(), zone.get_y() + zone.get_height()) == (0.2, pytest.approx(9.0))


def test_bars_lie_in_named_rows_from_the_top_down() -> None:
    bars = Bars(np.array([1.0, 4.0]), np.array([2.0, 7.0]), np.array([0.0, 1.0]), BLUE)
    figure = only(bars, rows=("first", "second"))
    (drawn,) = collections(figure, PolyCollection)
    boxes = [path.get_extents() for path in drawn.get_paths()]
    assert [(box.x0, box.x1, 0.5 * (box.y0 + box.y1)) for box in boxes] == [(1.0, 2.0, 0.0), (4.0, 7.0, 1.0)]
    assert figure.axes[0].get_ylim()[0] > figure.axes[0].get_ylim()[1]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["first", "second"]


@pytest.mark.parametrize("name", [r"$\frac$ and $", 300 * "long"])
def test_names_are_shown_as_they_are(name: str) -> None:
    """Dollars are no mathematics, and a name longer than the figure is cut."""
    bars = Bars(np.zeros(1), np.ones(1), np.zeros(1), BLUE)
    panel = Panel(name, "", (bars, Line(TIME, TIME, BLUE, name)), rows=(name,))
    figure = figures.draw_plot(plot(panel)._replace(caption=name))
    figure.savefig(io.BytesIO())
    assert {name, f"Title   ({name})"} <= set(texts(figure))
    assert not any(text.get_parse_math() for text in figure.findobj(Text) if name in text.get_text())


def test_a_scale_is_that_of_its_panel() -> None:
    assert [only(LINE, scale=scale).axes[0].get_yscale() for scale in ("linear", "log")] == ["linear", "log"]
    symmetric = only(LINE, scale=SymmetricLog(0.03, 200.0)).axes[0]
    assert symmetric.get_yscale() == "symlog"
    np.testing.assert_allclose(symmetric.get_yticks(), [-100, -10, -1, -0.1, 0, 0.1, 1, 10, 100])
    assert only(LINE, limits=(-1.0, 50.0)).axes[0].get_ylim() == (-1.0, 50.0)


def test_panels_share_time_windows_and_moments() -> None:
    moments = (MomentLine(3.0, declared=False), MomentLine(4.0, declared=True))
    windows = tuple(ShadedWindow(start, start + 0.2, "RHC +x") for start in (1.0, 1.0, 1.2, 6.0))
    figure = figures.draw_plot(plot(Panel("a", "", (LINE,)), Panel("b", "", (LINE,)), windows=windows, moments=moments))
    upper, lower = figure.axes
    assert upper.get_position().y0 > lower.get_position().y1
    assert upper.get_xlim() == lower.get_xlim() == (0.0, 10.0)
    assert (upper.xaxis.get_visible(), lower.xaxis.get_visible()) == (False, True)
    for axes in figure.axes:
        shade = next(found for found in axes.collections if isinstance(found, PolyCollection)).get_paths()[0]
        assert (shade.get_extents().x0, shade.get_extents().x1) == (1.0, 1.2)
        rules = [found for found in axes.collections if isinstance(found, LineCollection)]
        assert {3.0, 4.0} <= {segment[0][0] for found in rules for segment in found.get_segments()}
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in figure.findobj(Text) if text.get_text() == "RHC +x"]
    assert not any(box.overlaps(other) for index, box in enumerate(boxes) for other in boxes[:index])
    assert boxes[3].y0 == boxes[0].y0


def test_all_text_lies_apart_and_inside_the_picture(stuck_run: Run) -> None:
    source, drawn = plots.source(stuck_run), stuck_run.plot.all()
    assert list(drawn) == list(plots.available_plots(source))
    for panel, axes in zip(motion_plots.rates(source).panels, drawn["rates"].axes, strict=True):
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), panel.marks[0].y)  # type: ignore[union-attr]
    for name, figure in drawn.items():
        figure.canvas.draw()
        shown = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
        ours = [text for text in shown if text in figure.texts or text in figure.axes[0].texts]
        whole = figure.bbox
        for text in [*ours, *(axes.yaxis.label for axes in figure.axes), figure.axes[-1].xaxis.label]:
            box = text.get_window_extent()
            assert box.width == 0.0 or (whole.x0 <= box.x0 and box.x1 <= whole.x1), (name, text)
            assert box.width == 0.0 or (whole.y0 <= box.y0 and box.y1 <= whole.y1), (name, text)
        boxes = [text.get_window_extent() for text in ours]
        for index, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:index]), (name, ours[index])


DRAWN = sorted(name for name in vars(figures.Plots) if not name.startswith("_") and name not in ("all", "save"))


def test_a_method_draws_the_plot_of_its_name(stuck_run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "draw_plot", lambda described: described)
    rate, position = stuck_run["rate"], stuck_run["position"]
    more = {f"against.{sensor}": stuck_run[sensor] for sensor in stuck_run.scenario.vehicle_data.sensor_names()}
    more |= {"rate_estimate": rate, "position_estimate": position, "mine.doubled": 2.0 * rate}
    for what in ("", "_std"):  # as of a vehicle that is followed in a fixed frame
        more |= {f"{name}{what}": rate for name in ("command_delay", "drag_rate", "heading_turn")}
        more |= {f"thrust_factor{what}": np.ones_like(stuck_run["command"])}
    more |= {"fault_probability": np.full_like(stuck_run["command"], 0.5)}
    more |= {f"{name}_probability": stuck_run["alarm"] for name in ("none", "unknown")}
    more |= dict.fromkeys(("camera", "against.camera"), np.hstack((position, np.full((len(rate), 4), 0.5))))
    pose = PoseSensor(name="camera", position_std=1.0, attitude_std=1.0)
    vehicle = stuck_run.scenario.vehicle_data.model_copy(update={"poses": (pose,)})
    scenario = stuck_run.scenario.model_copy(update={"vehicle": vehicle})
    run = Run(scenario, stuck_run.results, stuck_run.time_s, {**stuck_run.signals, **more})
    for name in DRAWN:
        assert getattr(run.plot, name)().name == name


def test_figures_are_saved_by_name_each_freed_before_the_next(
    stuck_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[weakref.ref[Figure]] = []
    alive: list[int] = []
    draw = figures.draw_plot

    def watched(described: Plot) -> Figure:
        alive.append(sum(figure() is not None for figure in made))
        figure = draw(described)
        made.append(weakref.ref(figure))
        return figure

    monkeypatch.setattr(figures, "draw_plot", watched)
    every = dict(list(plots.available_plots(plots.source(stuck_run)).items())[:2])
    monkeypatch.setattr(plots, "available_plots", lambda _: every)
    gc.disable()  # none is freed by chance
    try:
        stuck_run.plot.save(tmp_path)
    finally:
        gc.enable()
    assert alive == [0, 0]
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.png" for name in every}
    for path in tmp_path.iterdir():
        assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82")


# ------------------------------------------------------------------------------------- in a page


def traced(*marks: Mark, **about: Any) -> dict[str, Any]:
    return interactive.plotly_figure(Plot("some", "Title", "caption", TIME, (Panel("label", "unit", marks, **about),)))


def test_marks_become_traces_of_their_data_and_look() -> None:
    (trace,) = traced(Line(TIME, TIME**2, BLUE, "square", steps=True))["traces"]
    assert "x" not in trace  # over the sample times
    np.testing.assert_allclose(trace["y"], TIME**2)
    assert (trace["mode"], trace["line"]["shape"], trace["line"]["color"]) == ("lines", "hv", BLUE)
    assert (trace["name"], trace["showlegend"]) == ("square", True)
    (trace,) = traced(Line(TIME[:2], np.array([1.0, np.nan]), BLUE))["traces"]
    assert (trace["x"], trace["y"]) == ([0.0, 1.0], [1.0, None])
    (trace,) = traced(Points(TIME[2:4], TIME[2:4] * 2.0, BLUE))["traces"]
    assert (trace["mode"], trace["x"], trace["y"]) == ("markers", [2.0, 3.0], [4.0, 6.0])
    (trace,) = traced(Whiskers(TIME[:2], TIME[:2] - 1.0, TIME[:2] + 1.0, BLUE))["traces"]
    assert (trace["x"], trace["y"]) == ([0.0, 0.0, None, 1.0, 1.0, None], [-1.0, 1.0, None, 0.0, 2.0, None])
    low, high = traced(Band(TIME, -TIME, 2.0 * TIME, color=BLUE, label="band", opacity=1.0))["traces"]
    np.testing.assert_allclose(low["y"], -TIME)
    np.testing.assert_allclose(high["y"], 2.0 * TIME)
    assert (high["fill"], high["fillcolor"], high["name"]) == ("tonexty", f"{BLUE}ff", "band")
    assert high["meta"]["half"]  # read as half of what lies between
    (level,) = traced(Level(6.0, label="six"))["layout"]["shapes"]
    assert (level["xref"], level["x0"], level["x1"], level["y0"], level["y1"]) == ("x domain", 0, 1, 6.0, 6.0)
    assert (level["name"], level["showlegend"]) == ("six", True)
    (zone,) = traced(Zone(0.2, 9.0))["layout"]["shapes"]
    assert (zone["type"], zone["y0"], zone["y1"]) == ("rect", 0.2, 9.0)


def test_in_a_page_bars_lie_in_named_rows_from_the_top_down() -> None:
    figure = traced(
        Bars(np.array([1.0, 4.0]), np.array([2.0, 7.0]), np.array([0.0, 1.0]), BLUE), rows=("first", "second")
    )
    (trace,) = figure["traces"]
    assert trace["x"] == [1.0, 2.0, None, 4.0, 7.0, None]
    assert trace["text"] == ["first", "first", "", "second", "second", ""]
    axis = figure["layout"]["yaxis"]
    assert (axis["ticktext"], axis["range"][0] > axis["range"][1]) == (["first", "second"], True)


def test_in_a_page_a_scale_is_that_of_its_panel() -> None:
    line, band = Line(TIME, -TIME - 1.0, BLUE, "error"), Band(TIME, -TIME - 1.0, TIME + 1.0, label="3-sigma")
    assert traced(line)["layout"]["yaxis"]["type"] == "linear"
    axis = traced(line, scale="log", limits=(0.1, 100.0))["layout"]["yaxis"]
    assert axis["type"] == "log"
    np.testing.assert_allclose(axis["range"], [-1.0, 2.0])
    figure = traced(band, line, scale=SymmetricLog(1.0, 10.0))  # plotly has none: a linear view, and one of magnitudes
    assert list(figure["views"]) == ["yaxis"]
    linear, log = ([trace for trace in figure["traces"] if trace["view"] == view] for view in ("linear", "log"))
    assert len(linear) == 3  # two edges of the band
    for trace, values in ((linear[-1], -TIME - 1.0), (log[0], TIME + 1.0), (log[1], TIME + 1.0)):
        np.testing.assert_allclose(trace["y"], values)
    keys = tuple(Line(TIME, TIME, BLUE, f"label of mark {number}") for number in range(8))
    heights = [traced(*keys[:count])["layout"]["height"] for count in (0, 1, 8)]
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
    """Unfolds a list of values as the page does."""
    if isinstance(at, int):
        return lists[at]
    sign = {"minus": lambda value: -value, "abs": abs}[at[1]]
    return [None if value is None else sign(value) for value in lists[at[0]]]
