"""The report of a campaign: its data, its page, and the page in a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from campaign_rows import LENGTH_S, SWEPT, declaration, failure, folder, lost, many, row

from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.studies.campaign import campaign_report
from massprop_drake.studies.campaign.reading import Study, read

HEALTHY = """
name: healthy
base: sample_maneuver
cases: 12
draw: {plant.thrust_dispersion: {normal: {mean: 0.01, std: 0.001}}}
times_s: [10, 20]
gates: {ended_wrong: {max: 0}}
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty cases of all outcomes in two cells of a sweep, of which one failed to run and one is missing."""
    rows = many(2, 30)[:-1]
    rows[4] = lost(4, "Segmentation fault")
    path = folder(tmp_path_factory.mktemp("swept") / "made_up", SWEPT.format(cases=30), rows)
    (path / "cases" / "0010").mkdir(parents=True)
    (path / "cases" / "0012").mkdir()
    (path / "cases" / "0012" / "report.html").touch()
    return path


@pytest.fixture(scope="module")
def study(swept: Path) -> Study:
    return read(swept)


@pytest.fixture(scope="module")
def contents(study: Study) -> dict[str, Any]:
    return campaign_report.page_content(study)


@pytest.fixture(scope="module")
def html(swept: Path) -> str:
    return campaign_report.report_page(read(swept))


def said(contents: dict[str, Any], words: str) -> dict[str, Any]:
    (line,) = [line for line in contents["verdict"] if words in line["text"]]
    return line


# -------------------------------------------------------------------------------------------- data


def test_the_summary_has_figures_with_bounds_and_gates_by_cell(swept: Path) -> None:
    found = campaign_report.summary_data(read(swept))
    json.dumps(found, allow_nan=False)
    assert found["cases"] == {
        "planned": 60, "tried": 59, "flown": 58, "judged": 58, "failing": found["cases"]["failing"], "measured": 58,
        "ended_wrong": 0, "failed_to_run": 1,
    }  # fmt: skip
    assert found["failed_to_run"] == {"Segmentation fault": 1}
    assert found["figures"] == found["cells"][1]["figures"]
    assert found["hours"] == pytest.approx(58 * LENGTH_S / 3600.0)
    assert set(found["figures"]["isolated"]) == {"value", "low", "high", "n"}
    assert [(gate["cell"], gate["figure"], gate["passes"]) for gate in found["gates"]] == [
        (0, "false_declarations_per_hour", True), (0, "nees_in_band", False),
        (1, "false_declarations_per_hour", True), (1, "nees_in_band", False),
    ]  # fmt: skip
    assert found["passed"] is False
    assert found["injected"]["stuck_off"] == {"never_acted": 10}


def test_the_verdict_names_gates_bounds_and_what_is_missing(contents: dict[str, Any]) -> None:
    assert said(contents, "Gate passed: False declarations")["good"] is True
    gate = said(contents, "Gate failed: NEES")
    assert gate["good"] is False
    assert "with margin 4;" in gate["text"]
    assert said(contents, "1 of 59 cases failed to run")["good"] is False
    assert said(contents, "59 of 60 planned cases")["good"] is False
    assert said(contents, "are with margin 6, the base scenario's own settings")["good"] is None
    assert "5 failures never acted" in said(contents, "never acted")["text"]
    assert re.search(r"false declarations in 0.483 hours flown: [\d.]+ per hour \([\d.]+ to [\d.]+\)", str(contents))


def test_every_section_has_its_table_and_plots(contents: dict[str, Any]) -> None:
    json.dumps(contents["plots"], allow_nan=False)
    names = {section: [plot["name"] for plot in plots] for section, plots in contents["places_of"].items()}
    assert names == {
        "detection": ["delays", "delays-cells", "operating"],
        "isolation": ["confusion", "confusion-clusters"],
        "sizes": ["sizes-degraded", "sizes-leak"],
        "magnitudes": ["magnitudes", "magnitude-errors"],
        "consistency": ["nees", "nees-mass", "nis-rotation", "nis-translation", "coverage", "parameters"],
        "sensitivity": ["sensitivity", "sensitivity-size"],
    }
    assert "dotted curve" in contents["places_of"]["detection"][-1]["note"]
    assert [table["kind"] for table in contents["outcomes"]] == ["stuck off", "release", "degraded", "leak", "all"]
    assert contents["outcomes"][-1]["acted"] == 24
    assert [line["counts"] for line in contents["jumps"]][1] == [0, 0, 5, 0]
    assert len(contents["sweep"]["cells"]) == 2
    assert len(contents["worst"]) == 10
    assert contents["failed"] == [("Segmentation fault", 1)]
    figures = {line["name"]: line["value"] for line in contents["figures"]}
    assert contents["delays"][-1]["found"].startswith(figures["isolated"])
    assert contents["delays"][-1]["median"].startswith(figures["delay_50_percent_s"])
    assert contents["delays"][-1]["within"][1].startswith(figures["found_within_5_s"])
    assert f"{contents['falsely'][-1]['rate']} 1/h" == figures["false_declarations_per_hour"]
    assert sum(int(line["n"]) for line in contents["groups"]) == 29
    assert {line["n"] for line in contents["coverage"]} == {"29"}
    assert all(line["within"][1].startswith("100 %") for line in contents["magnitudes"])  # all are off by one sigma
    assert sum(int(line["found"].split(" of ")[1]) for line in contents["leaks"]["leak"]) == 14


def at_times() -> dict[str, float]:
    columns = ((f"{what}@{time}.{name}", value) for what, value in (("estimate", 3.0), ("error", 0.05), ("sigma", 0.1))
               for time in (10, 20) for name in NAMES)  # fmt: skip
    return dict(columns)


def test_a_healthy_campaign_has_no_failures_to_speak_of(tmp_path: Path) -> None:
    path = folder(tmp_path / "healthy", HEALTHY, [row(case, z=0.1 * case, **at_times()) for case in range(12)])
    found = campaign_report.summary_data(read(path))
    assert found["passed"] is True
    assert found["figures"]["false_declarations_per_hour"]["high"] == pytest.approx(3.0 / (12 / 60), rel=2e-3)
    assert found["figures"]["isolated"]["value"] is None
    shown = campaign_report.page_content(read(path))
    assert shown["outcomes"] == []
    assert [plot["name"] for plot in shown["places_of"]["consistency"]][-1] == "over-time"
    assert not any("failures that acted" in line["text"] for line in shown["verdict"])
    html = campaign_report.report_page(read(path))
    assert 'id="detection"' not in html
    assert "No case is failing." in html


# -------------------------------------------------------------------------------------------- page


def test_the_page_begins_with_the_verdict_and_needs_no_network(html: str) -> None:
    assert html.index('id="verdict"') < html.index("Gate failed: NEES") < html.index('id="figures"')
    rest = re.sub(r"<script>/\*\*.*?</script>", "", html, count=1, flags=re.DOTALL)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", rest)
    assert len(html) < 2_000_000  # of which the part of plotly that it needs is 1.5, and the whole would be 4.8
    trace = re.compile(r'"type":"(scatter|bar|heatmap)"')
    assert {found[1] for found in trace.finditer(rest)} == {"scatter", "bar", "heatmap"}


EVIL = "</script><script>window.pwned=1</script><img src=x onerror=window.pwned=1>"


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign in which every text that a row or file may hold is hostile somewhere."""
    text = SWEPT.format(cases=14).replace("Rows that nobody has flown", json.dumps(EVIL))
    sized = {"kind": "leak", "force": 20.0, "magnitude": 20.0}
    evil = [
        row(25, [failure(EVIL, "wrong", taken_for=EVIL, **sized)], [declaration(EVIL, 10.0, "healthy")],
            healthy_jets_out=[EVIL], jets_out_of_use=[EVIL]),
        row(26, [failure("R4R", "named", kind=EVIL)], [declaration("R4R")]),
        row(27, [failure(EVIL, "named", kind=EVIL)], [declaration(EVIL)]),
        lost(24, EVIL),
    ]  # fmt: skip
    return folder(tmp_path_factory.mktemp("hostile") / 'it\'s <b>"bad"', text, [*many(2, 12), *evil])


# ------------------------------------------------------------------------------------ in a browser


def test_it_opens_from_disk_draws_every_plot_and_runs_nothing_else(opened: Any, hostile: Path, tmp_path: Path) -> None:
    path = tmp_path / "campaign.html"
    path.write_text(campaign_report.report_page(read(hostile)), encoding="utf-8")
    page = opened(path)
    plots = page.page.locator("section.plot")
    assert plots.count() == page.page.locator("section.plot:has(.main-svg) h3").count() == 17
    assert "Gate failed: NEES of the nine rotational parameters" in page.page.inner_text("#verdict")
    assert EVIL in page.page.inner_text("header")
    assert page.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.page.click("#theme")
    assert page.page.evaluate("document.documentElement.dataset.theme") in ("dark", "light")
    assert page.page.evaluate("window.pwned === undefined")
    assert page.page.locator("img, [onerror]").count() == 0
    assert page.said == []
