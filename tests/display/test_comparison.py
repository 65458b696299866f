"""The page of runs side by side."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contrast_probe import faint

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.display import plots
from massprop_drake.display.comparison import comparison_html, overlay_plots
from massprop_drake.display.run import Run
from massprop_drake.display.spec import Band, Line


@pytest.fixture(scope="module")
def healthy(stuck_run: Run) -> Run:
    """The same flight without its failure, and shorter."""
    return simulate(stuck_run.scenario.model_copy(update={"failures": (), "duration_s": 4.0}))


@pytest.fixture(scope="module")
def page(stuck_run: Run, healthy: Run) -> str:
    return comparison_html([("runs/stuck", stuck_run), ("runs/healthy", healthy)])


def test_a_run_has_one_color_and_what_is_common_is_shown_once(stuck_run: Run, healthy: Run) -> None:
    drawn = {plot.name: plot for plot in overlay_plots([(str(run), plots.source(run)) for run in (healthy, stuck_run)])}
    first, second = (mark for mark in drawn["rates"].panels[1].marks if isinstance(mark, Line))
    np.testing.assert_allclose(second.y, np.degrees(stuck_run["rate"][:, 1]))
    assert first.color != second.color
    assert drawn["rates"].time_s[-1] == stuck_run.time_s[-1]
    assert [window.text for window in drawn["rates"].windows] == ["RHC +x"]
    errors = drawn["center_of_mass"]
    assert {mark.color for mark in errors.panels[0].marks if isinstance(mark, Band)} == {first.color, second.color}
    assert ("3 sigma" in errors.meaning, drawn["rates"].meaning) == (True, "")


def test_beside_a_record_both_show_their_estimates_from_their_first_sample_on(healthy: Run, tmp_path: Path) -> None:
    healthy.save(tmp_path / "run", pictures=False, report=False)
    heading, *rows = (tmp_path / "run" / "telemetry.csv").read_text(encoding="utf-8").splitlines()
    later = [f"{500.0 + float(row.partition(',')[0]):.2f},{row.partition(',')[2]}" for row in rows]
    (tmp_path / "later.csv").write_text("\n".join([heading, *later]), encoding="utf-8")
    record = estimate(tmp_path / "later.csv", load_scenario(tmp_path / "run"))
    said = comparison_html([("run", healthy), ("record", record)])
    assert "each is drawn from its first sample on" in said
    assert "1/m, 1/slug" in said  # the estimate, not its error
    assert "first sample on" not in comparison_html([("run", healthy), ("again", healthy)])


def test_the_table_has_the_numbers_of_both(page: str, stuck_run: Run) -> None:
    def cells(html: str, symbol: str = "x_cm") -> list[str]:
        (row,) = re.findall(rf"<tr><th scope=\"row\">{symbol}</th>(.*?)</tr>", html)
        return re.findall(r"<td[^>]*>(.*?)</td>", row)

    one = stuck_run.results.parameters[6]
    percent = [f"{one.percent_error:+.4f} %", f"{one.percent_deviation:.4f} %"]
    assert cells(page)[1:4] == [f"{one.estimate:.6g}", *percent]
    rows = re.findall(r"<tr><th scope=\"row\">runs/(\w+)</th><td>(.*?)</td><td>.*?</td><td.*?>(.*?)</td></tr>", page)
    assert rows == [("stuck", "6 s", "jet R4R: stuck on"), ("healthy", "4 s", "nothing")]
    known, nan = stuck_run.results, float("nan")
    for numbers, expected in {
        (-0.0005, 0.0042, 0.0, nan): ["-0.0005", "-0.0005 ft", "0.0042 ft"],  # about zero: in its unit
        (0.0, nan, 0.0, nan): ["0", "fixed", ""],
        (nan, nan, 0.1, nan): ["not observable", "", ""],
    }.items():
        columns = [known.estimates, known.standard_deviations, known.truth, known.percent_error]
        columns = [np.where(np.arange(10) == 6, number, old) for number, old in zip(numbers, columns, strict=True)]
        names = ("estimates", "standard_deviations", "truth", "percent_error")
        results = replace(known, **dict(zip(names, columns, strict=True)))
        run = Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals)
        assert cells(comparison_html([("one", run), ("other", stuck_run)]))[1:4] == expected


NO_HOVER = """const asked = matchMedia;
window.matchMedia = what => what === "(hover: none)" ? { matches: true } : asked(what);"""
BAR_AND_KEY = """[...document.querySelectorAll(".js-plotly-plot")].map(plot => [
  plot.querySelector(".modebar").getBoundingClientRect().bottom,
  Math.min(...[...plot.querySelectorAll(".legend")].map(key => key.getBoundingClientRect().top)),
])"""


def test_its_text_stands_out_fits_the_window_and_lies_below_the_buttons(opened: Any, page: str, tmp_path: Path) -> None:
    (tmp_path / "comparison.html").write_text(page, encoding="utf-8")
    shown = opened(tmp_path / "comparison.html", NO_HOVER)
    ink = "getComputedStyle(document.body).color"
    found = [(bar, key) for bar, key in shown.page.evaluate(BAR_AND_KEY) if key is not None]
    assert len(found) > 3
    assert all(bar <= key for bar, key in found)  # where nothing hovers they are always there
    for scheme, width in (("light", 1400), ("dark", 390)):
        shown.page.emulate_media(color_scheme=scheme)
        shown.page.set_viewport_size({"width": width, "height": 800})
        shown.until("document.documentElement.scrollWidth <= innerWidth")
        shown.until(f"getComputedStyle(document.querySelector('#plot-consistency .xtick text')).fill === {ink}")
        assert faint(shown.page, 100) == []
        assert shown.page.evaluate("innerWidth") == width
    read = shown.page.evaluate("massprop.reading(massprop.figures.find(f => f.name === 'consistency'), 3)")
    filters = ["rotation filter runs/stuck: NIS", "rotation filter runs/healthy: NIS"]
    assert [label for label, _, _ in read][:2] == filters
    assert shown.said == []
