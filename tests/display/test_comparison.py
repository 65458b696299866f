"""The page of runs side by side."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contrast_probe import faint

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.display import plots
from massprop_drake.display.comparison import _alike, _cells, comparison_html, overlaid
from massprop_drake.display.spec import Band, Line
from massprop_drake.results.run import Run
from massprop_drake.results.summary import Parameter


@pytest.fixture(scope="module")
def healthy(stuck_run: Run) -> Run:
    """The same flight without its failure, and shorter."""
    scenario = stuck_run.scenario.model_copy(update={"failures": (), "duration_s": 4.0})
    return simulate(scenario)


@pytest.fixture(scope="module")
def page(stuck_run: Run, healthy: Run) -> str:
    return comparison_html([("runs/stuck", stuck_run), ("runs/healthy", healthy)])


def test_a_run_has_one_color_and_what_is_common_is_shown_once(stuck_run: Run, healthy: Run) -> None:
    drawn = {
        plot.name: plot for plot in overlaid([(run.scenario.name, plots.source(run)) for run in (healthy, stuck_run)])
    }
    first, second = drawn["rates"].panels[1].marks
    assert isinstance(first, Line)
    assert isinstance(second, Line)
    np.testing.assert_allclose(second.y, np.degrees(stuck_run["rate"][:, 1]))
    assert first.color != second.color
    assert drawn["rates"].time_s[-1] == stuck_run.time_s[-1]
    assert [window.text for window in drawn["rates"].windows] == ["RHC +x"]
    errors = drawn["center_of_mass"]
    assert {mark.color for mark in errors.panels[0].marks if isinstance(mark, Band)} == {first.color, second.color}
    assert "3 sigma" in errors.meaning
    assert drawn["rates"].meaning == ""


def test_beside_a_record_both_show_their_estimates_from_their_first_sample_on(healthy: Run, tmp_path: Path) -> None:
    healthy.save(tmp_path / "run", pictures=False, report=False)
    rows = (tmp_path / "run" / "telemetry.csv").read_text(encoding="utf-8").splitlines()
    later = [f"{500.0 + float(row.partition(',')[0]):.2f},{row.partition(',')[2]}" for row in rows[1:]]
    (tmp_path / "later.csv").write_text("\n".join([rows[0], *later]), encoding="utf-8")
    record = estimate(tmp_path / "later.csv", load_scenario(tmp_path / "run"))
    shown = _alike([("run", plots.source(healthy)), ("record", plots.source(record))])
    assert [source.time_s[0] for _, source in shown] == [0.0, 0.0]
    (panel,) = {plot.name: plot for plot in overlaid(shown)}["mass_reciprocal"].panels
    first, second = [mark for mark in panel.marks if isinstance(mark, Line)]
    np.testing.assert_allclose(first.y, second.y)
    assert panel.unit == "1/slug"
    assert "each is drawn from its first sample on" in comparison_html([("run", healthy), ("record", record)])
    assert "first sample on" not in comparison_html([("run", healthy), ("again", healthy)])


def test_the_table_has_the_numbers_of_both(page: str, stuck_run: Run) -> None:
    (row,) = re.findall(r"<tr><th scope=\"row\">x_cm</th>(.*?)</tr>", page)
    assert f"{stuck_run.results.parameters[6].percent_error:+.4f} %" in row
    assert row.count("<td") == 1 + 2 * 3


def test_how_long_each_is_and_what_it_found(page: str) -> None:
    rows = re.findall(r"<tr><th scope=\"row\">runs/(\w+)</th><td>(.*?)</td><td>.*?</td><td.*?>(.*?)</td></tr>", page)
    assert rows == [("stuck", "6 s", "jet R4R: stuck on"), ("healthy", "4 s", "nothing")]


@pytest.fixture(scope="module")
def once(page: str, opened_once: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("comparison") / "comparison.html"
    path.write_text(page, encoding="utf-8")
    return opened_once(path)


@pytest.fixture
def shown(once: Any) -> Any:
    return once.as_opened("0")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_its_text_stands_out_from_its_ground(shown: Any, scheme: str) -> None:
    shown.page.emulate_media(color_scheme=scheme)
    ink = "getComputedStyle(document.body).color"
    shown.until(f"getComputedStyle(document.querySelector('#plot-consistency .xtick text')).fill === {ink}")
    assert faint(shown.page, 100) == []


@pytest.mark.parametrize("width", [1400, 390])
def test_it_fits_the_window_and_says_nothing_on_the_console(shown: Any, width: int) -> None:
    shown.page.set_viewport_size({"width": width, "height": 800})
    shown.until("document.documentElement.scrollWidth <= innerWidth")
    assert shown.page.evaluate("innerWidth") == width
    read = shown.page.evaluate("massprop.reading(massprop.figures.find(f => f.name === 'consistency'), 3)")
    assert [label for label, _, _ in read][:2] == [
        "rotation filter runs/stuck: NIS",
        "rotation filter runs/healthy: NIS",
    ]
    assert shown.said == []


def test_what_is_about_zero_has_its_error_in_its_unit() -> None:
    def cells(*numbers: float) -> tuple[str, ...]:
        return _cells(Parameter("x_cm", *numbers), "m")

    nan = float("nan")
    assert cells(-0.0005, 0.0042, 0.0, nan) == ("-0.0005", "-0.0005 m", "0.0042 m")
    assert cells(2.0, 0.5, 1.0, 100.0)[1:] == ("+100.0000 %", "25.0000 %")
    assert cells(0.0, nan, 0.0, nan) == ("0", "fixed", "")
    assert cells(nan, nan, 0.1, nan) == ("not observable", "", "")
