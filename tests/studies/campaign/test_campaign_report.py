"""The report of a campaign: its data, its page, and the page in a browser."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from campaign_rows import LENGTH_S, SWEPT, declaration, failure, folder, lost, many, recorded, row

from massprop_drake.errors import InputError
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.studies.campaign import campaign_report
from massprop_drake.studies.campaign.reading import Study, read, told_apart

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
    return campaign_report.contents(study)


@pytest.fixture(scope="module")
def html(swept: Path) -> str:
    return campaign_report.page(swept)


def said(contents: dict[str, Any], words: str) -> dict[str, Any]:
    (line,) = [line for line in contents["verdict"] if words in line["text"]]
    return line


# ----------------------------------------------------------------------------------------- reading


def test_rows_come_with_their_draws_by_cell(study: Study) -> None:
    assert [cell.settings for cell in study.cells] == [{"detector.margin": 4.0}, {"detector.margin": 6.0}]
    assert [(len(cell.rows), cell.planned) for cell in study.cells] == [(30, 30), (29, 30)]
    assert study.reference == 1  # six is the scenario's own margin
    first, second = (cell.rows[7] for cell in study.cells)
    assert (first["sample"], second["sample"], first["case_id"], second["case_id"]) == (7, 7, 14, 15)
    assert first["draw.plant.thrust_dispersion"] == second["draw.plant.thrust_dispersion"]
    assert 0.0 < first["draw.plant.thrust_dispersion"] < 0.02
    assert study.kept == {10: "cases/0010/", 12: "cases/0012/report.html"}


def test_cells_are_told_apart_by_what_differs_and_follows_from_nothing_else() -> None:
    starts = [
        {"estimation": {"start": "zero", "floors": False, "lag": "gate"}},
        {"estimation": {"start": "zero", "floors": True, "lag": "gate"}},
        {"estimation": {"start": "given", "lag": "gate", "given": {"sigma": [1e-8, 0.3]}}},
    ]
    keys, values = told_apart(starts)
    assert keys == ["estimation.start", "estimation.floors"]
    assert values == [("zero", "false"), ("zero", "true"), ("given", "-")]
    pairs = [{"a": 1.0, "b": [{"x": 0.5, "y": [1, 2]}]}, {"a": 1.0, "b": [{"x": 0.5, "y": [3, 4]}]}]
    assert told_apart(pairs) == (["b[0].y"], [("[1, 2]",), ("[3, 4]",)])
    assert told_apart([{}]) == ([], [()])


def test_a_folder_without_results_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no campaign"):
        campaign_report.summary(tmp_path)
    (tmp_path / "c.yaml").write_text(HEALTHY)
    path = folder(tmp_path / "one", HEALTHY, [row(0, **at_times())])
    next((path / "results").glob("*.parquet")).unlink()
    with pytest.raises(InputError, match="no case has been flown yet"):
        campaign_report.summary(path)


# -------------------------------------------------------------------------------------------- data


def test_the_summary_has_figures_with_bounds_and_gates_by_cell(swept: Path) -> None:
    found = campaign_report.summary(swept)
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


def test_a_summary_depends_on_rows_alone_and_not_on_when_they_were_flown(swept: Path, study: Study) -> None:
    other = [cell._replace(rows=[{**one, "wall_s": 99.0, "cpu_s": 98.0} for one in cell.rows]) for cell in study.cells]
    assert campaign_report.summarized(study._replace(cells=other, folder=Path("elsewhere"))) == campaign_report.summary(
        swept
    )


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


def test_a_worst_case_says_how_to_fly_it_again(contents: dict[str, Any], swept: Path) -> None:
    for line in contents["worst"]:
        assert line["rerun"] == f"massprop campaign run {swept} --only {int(line['case'])}"
        assert line["view"] == f"massprop run {swept}/cases/{line['case']} --view"
        assert line["why"]


def test_healthy_jets_are_told_apart_by_what_failed_beside_them(study: Study) -> None:
    vehicle = study.spec.base.vehicle_data
    clusters = {jet.designation: jet.cluster for jet in vehicle.jets}
    beside = next(name for name in clusters if name != "R4R" and clusters[name] == clusters["R4R"])
    rows = [
        row(0, [failure("R4R", "group")], healthy_jets_out=[beside]),
        row(1, [failure("R4R")], healthy_jets_out=["F2F"]),
    ]
    found = campaign_report._healthy_out(rows, clusters)
    assert {jet: rest for jet, *rest in found["jets"]} == {beside: [0, 1], "F2F": [1, 0]}
    assert found["share"].startswith("50.0 %")


def at_times() -> dict[str, float]:
    columns = ((f"{what}@{time}.{name}", value) for what, value in (("estimate", 3.0), ("error", 0.05), ("sigma", 0.1))
               for time in (10, 20) for name in NAMES)  # fmt: skip
    return dict(columns)


def test_a_healthy_campaign_has_no_failures_to_speak_of(tmp_path: Path) -> None:
    path = folder(tmp_path / "healthy", HEALTHY, [row(case, z=0.1 * case, **at_times()) for case in range(12)])
    found = campaign_report.summary(path)
    assert found["passed"] is True
    assert found["figures"]["false_declarations_per_hour"]["high"] == pytest.approx(3.0 / (12 / 60), rel=2e-3)
    assert found["figures"]["isolated"]["value"] is None
    shown = campaign_report.contents(read(path))
    assert shown["outcomes"] == []
    assert [plot["name"] for plot in shown["places_of"]["consistency"]][-1] == "over-time"
    assert not any("failures that acted" in line["text"] for line in shown["verdict"])
    html = campaign_report.page(path)
    assert 'id="detection"' not in html
    assert "No case is failing." in html


def test_records_are_reported_without_a_word_on_what_is_false(tmp_path: Path) -> None:
    rows = [{**recorded(case, [declaration()] * (case < 3)), **at_times()} for case in range(12)]
    path = folder(tmp_path / "records", HEALTHY, rows)
    assert campaign_report.summary(path)["passed"] is False  # the gates ask for what nobody knows
    shown = campaign_report.contents(read(path))
    assert any(line["text"].startswith("3 declarations in 0.2 hours of telemetry") for line in shown["verdict"])
    assert not any("false declarations in" in line["text"] for line in shown["verdict"])
    assert "3 declarations in 0.2 hours" in campaign_report.page(path)


def test_where_all_failed_to_run_there_is_a_page_all_the_same(tmp_path: Path) -> None:
    path = folder(tmp_path / "lost", HEALTHY, [lost(case, f"took more than {case % 2} s") for case in range(12)])
    found = campaign_report.summary(path)
    assert found["passed"] is False
    assert found["failed_to_run"] == {"took more than 0 s": 6, "took more than 1 s": 6}
    assert "12 of 12 cases failed to run" in campaign_report.page(path)


def test_figures_are_shown_with_what_is_known_of_them() -> None:
    figure = campaign_report.statistics.Figure
    assert campaign_report.shown(figure(0.125, 0.08, 0.18, 40), "%") == "12.5 % (8.0 to 18.0)"
    assert campaign_report.shown(figure(0.0, 0.0, 0.075, 40), "1/h") == "0 1/h (0 to 0.075)"
    assert campaign_report.shown(figure(math.nan, 0.4, 1.0, 40), "%") == "at least 40.0 %"
    assert campaign_report.shown(figure(23.0, 13.0, math.inf, 21), "s") == "23 s (from 13)"
    assert campaign_report.shown(figure(math.nan, math.nan, math.nan, 0), "s") == "-"


# -------------------------------------------------------------------------------------------- page


def test_the_page_begins_with_the_verdict_and_needs_no_network(html: str) -> None:
    assert html.index('id="verdict"') < html.index("Gate failed: NEES") < html.index('id="figures"')
    rest = re.sub(r"<script>/\*\*.*?</script>", "", html, count=1, flags=re.DOTALL)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", rest)
    assert len(html) < 2_000_000  # of which the part of plotly that it needs is 1.5, and the whole would be 4.8
    trace = re.compile(r'"type":"(scatter|bar|heatmap)"')
    assert {found[1] for found in trace.finditer(rest)} == {"scatter", "bar", "heatmap"}


def test_false_declarations_are_counted_by_their_cause(html: str) -> None:
    _, _, section = html.partition('<h2 id="false">')
    table = section.partition("</table>")[0]
    assert "later withdrawn" in table
    rows = re.findall(r'<tr><th scope="row".*?>(.*?)</th>', table)
    assert rows[-1] == "all"
    assert len(rows) > 1


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


def test_texts_of_files_do_no_harm(hostile: Path) -> None:
    html = campaign_report.page(hostile)
    assert EVIL not in html
    assert html.count("&lt;/script&gt;&lt;script&gt;window.pwned=1") >= 5
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL).group(1))  # type: ignore[union-attr]
    assert "<img" not in json.dumps(data)  # plotly takes some HTML in texts


# ------------------------------------------------------------------------------------ in a browser


def test_it_opens_from_disk_draws_every_plot_and_runs_nothing_else(opened: Any, hostile: Path, tmp_path: Path) -> None:
    path = tmp_path / "campaign.html"
    path.write_text(campaign_report.page(hostile), encoding="utf-8")
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
