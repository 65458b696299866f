"""The report page."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import load_scenario, simulate
from massprop_drake.display import interactive, plots, write_report
from massprop_drake.display.page import report_html
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.results.run import Run


@pytest.fixture(scope="module")
def html(stuck_run: Run) -> str:
    return report_html(stuck_run)


def without_plotly(html: str) -> str:
    return re.sub(r"<script>/\*\*.*?</script>", "", html, count=1, flags=re.DOTALL)


def test_the_verdict_comes_first_and_names_the_failed_jet(html: str) -> None:
    assert html.index("Found: jet R4R: on.") < html.index("What was learned") < html.index('id="plots"')


def test_every_parameter_has_its_row(html: str, stuck_run: Run) -> None:
    for symbol in ("Ixx⁻¹", "Iyz⁻¹", "x_cm", "1/m"):
        assert f'<th scope="row">{symbol}</th>' in html
    assert f"{stuck_run['estimate'][-1, 0]:.6g}" in html


def test_a_detection_says_when_what_how_much_and_how_sure(html: str, stuck_run: Run) -> None:
    entry = stuck_run.summary["detections"][0]
    row = html[html.index("<td>jet R4R: on</td>") :].split("</tr>", maxsplit=1)[0]
    assert f"{entry['time_s']:.2f} s" in row
    assert f"{entry['magnitude']:+.1f}" in row
    assert f"after {entry['alarms']} alarms" in row


def test_it_needs_no_network(html: str) -> None:
    rest = without_plotly(html)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", rest)
    assert len(html) < 8_000_000


def test_it_is_small_for_a_minute(sample_run: Run) -> None:
    assert len(report_html(sample_run).encode()) < 8_000_000


def test_the_page_has_the_plots_of_the_run(html: str, stuck_run: Run) -> None:
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL).group(1))  # type: ignore[union-attr]
    source = plots.source(stuck_run)
    assert [figure["name"] for figure in data["plots"]] == list(plots.available(source))
    assert data["plots"][0] == interactive.drawn(plots.rates(source))
    np.testing.assert_allclose(data["time"], stuck_run.time_s, rtol=1e-8)


def test_nothing_is_said_of_a_truth_that_is_unknown(stuck_run: Run) -> None:
    signals = {name: value for name, value in stuck_run.signals.items() if name not in ("truth", "thrust", "rate")}
    unknown = np.full(10, np.nan)
    results = replace(stuck_run.results, truth=unknown, percent_error=unknown)
    run = Run(stuck_run.scenario, results, stuck_run.time_s, signals)
    html = report_html(run)
    assert "The truth is unknown" in html
    assert "within 3 sigma of the truth" not in html
    assert "Angular rate, as read" in html


def test_names_from_files_do_no_harm(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    evil = "<script>alert(1)</script>"
    vehicle = Vehicle.model_validate({**toy_data, "name": evil, "description": evil})
    scenario = load_scenario("jet_pulses").model_copy(
        update={"vehicle": vehicle, "jet_schedule": (), "duration_s": 1.0, "description": f"'{evil}\""}
    )
    folder = tmp_path / 'it\'s "quoted" & <b>'
    folder.mkdir()
    html = write_report(simulate(scenario), folder / "report.html").read_text(encoding="utf-8")
    assert evil not in html
    assert "&lt;script&gt;alert(1)" in html
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL).group(1))  # type: ignore[union-attr]
    assert data["plots"]


# ------------------------------------------------------------------------------------ in a browser


def test_it_opens_from_disk_without_a_word_on_the_console(opened: Any, stuck_run: Run, tmp_path: Path) -> None:
    page = opened(write_report(stuck_run, tmp_path / "report.html"))
    assert page.said == []
    assert "jet R4R: on" in page.page.inner_text("#verdict")
    assert page.page.locator(".plot .main-svg").count() > 10


def test_one_cursor_moves_all_plots(opened: Any, stuck_run: Run, tmp_path: Path) -> None:
    page = opened(write_report(stuck_run, tmp_path / "report.html")).page

    def places() -> list[float]:
        return page.evaluate("[...document.querySelectorAll('.cursor')].map(e => parseFloat(e.style.left))")

    slider = page.locator("#cursor-slider")
    slider.fill("1")
    before = places()
    slider.fill("4")
    after = places()
    assert len(before) == page.locator(".plot").count()
    assert all(b - a > 50 for a, b in zip(before, after, strict=True))
    assert "4.00 s" in page.inner_text("#cursor-time")


def test_a_zoom_in_one_plot_is_a_zoom_in_all(opened: Any, stuck_run: Run, tmp_path: Path) -> None:
    opening = opened(write_report(stuck_run, tmp_path / "report.html"))
    zoom = "{'xaxis.range[0]': 1, 'xaxis.range[1]': 2}"
    opening.page.evaluate(f"Plotly.relayout(document.querySelector('#plot-rates .js-plotly-plot'), {zoom})")
    zoomed = "p => Math.abs(p._fullLayout.xaxis.range[1] - 2) < 1e-6"
    opening.until(f"[...document.querySelectorAll('.js-plotly-plot')].every({zoomed})")
