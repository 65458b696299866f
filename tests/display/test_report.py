"""The report page."""

from __future__ import annotations

import copy
import dataclasses
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from contrast_probe import faint

from massprop_drake import load_scenario, simulate
from massprop_drake.cli import show
from massprop_drake.display import interactive, page, plots, write_report
from massprop_drake.display.page import report_html, summary_html
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results import table
from massprop_drake.results.allowed import Intervals
from massprop_drake.results.detections import size
from massprop_drake.results.fault_probabilities import FaultProbabilities, JetProbability
from massprop_drake.results.run import Run
from massprop_drake.signals import SYMBOLS


@pytest.fixture(scope="module")
def html(stuck_run: Run) -> str:
    return report_html(stuck_run)


def without_plotly(html: str) -> str:
    return re.sub(r"<script>/\*\*.*?</script>", "", html, count=1, flags=re.DOTALL)


def test_the_verdict_comes_first_and_names_the_failed_jet(html: str) -> None:
    found = re.search(r"Found: jet R4R \(cluster 12\): stuck on, .* lbf; since .* s, declared at .* s\.", html)
    assert found
    assert (
        found.start()
        < html.index('id="failing"')
        < html.index("Mass, center of mass, inertia")
        < html.index('id="plots"')
    )


def test_an_inconsistent_flight_is_said_in_the_verdict(stuck_run: Run) -> None:
    judged = stuck_run.results.consistency._replace(verdict="inconsistent", reasons=["the lag is off", "so is a jet"])
    run = copy.copy(stuck_run)
    run.results = dataclasses.replace(stuck_run.results, consistency=judged)
    said = summary_html(run)
    assert "Inconsistent, so that a 1-sigma may say too little: the lag is off and 1 more, below." in said


def test_what_is_probable_at_the_end_is_said(html: str, stuck_run: Run) -> None:
    told = FaultProbabilities({"F1U": JetProbability(0.25, "loss", -10.0, 2.5)}, 0.7, 0.0)
    run = copy.copy(stuck_run)
    run.results = dataclasses.replace(stuck_run.results, fault_probability=told)
    assert "<p>At the end: failed with probability: F1U 0.25 (loss, -10.0 ± 2.5 lbf).</p>" in report_html(run)
    assert "with probability" not in html


def test_what_readings_allow_is_a_table_and_a_contradiction_stands_out(html: str, stuck_run: Run) -> None:
    one, found = stuck_run.results.parameters[0].estimate, (1.0, 2.0)
    inertia = (((one - 1.0, one + 1.0), found, found), (found, found, found), (found, found, None))
    told = Intervals(inertia, (found, found, found), found, {}, guaranteed=True, given=("this", "that"))
    run = copy.copy(stuck_run)
    run.results = dataclasses.replace(stuck_run.results, intervals=told)
    page = report_html(run)
    rows = page[page.index('id="intervals"') :].split("<tr>")[2:12]
    assert [SYMBOLS[index] in row for index, row in enumerate(rows)] == [True] * 10
    assert "✓ yes" in rows[0]
    assert "✗ no" in rows[1]
    assert '<p class="soft">Guaranteed by the readings, given this and that.</p>' in page
    told = told._replace(guaranteed=False, reason="no vehicle explains all", contradicted=True)
    run.results = dataclasses.replace(stuck_run.results, intervals=told)
    page = report_html(run)
    assert '<p class="bad">None: no vehicle explains all.</p>' in page
    assert "estimate inside" not in page
    assert 'id="intervals"' not in html


def test_every_parameter_has_its_row(html: str, stuck_run: Run) -> None:
    for symbol in ("Ixx⁻¹", "Iyz⁻¹", "x_cm", "1/m"):
        assert f'<th scope="row">{symbol}</th>' in html
    row = table.parameters(stuck_run.results, stuck_run.scenario.vehicle_data.unit_names)[0]
    assert f'<td class="number">{row.estimate}</td>' in html
    assert 1e-6 * float(row.estimate) == pytest.approx(stuck_run["estimate"][-1, 0], rel=1e-3)


def test_terminal_and_page_say_the_same_numbers(html: str, stuck_run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    show.simulated(stuck_run.results, stuck_run.scenario.vehicle_data, Path("there"))
    printed = {line.split("│")[1].strip(): line for line in capsys.readouterr().out.splitlines() if line[:1] == "│"}
    vehicle = stuck_run.scenario.vehicle_data
    rows = [row for block in table.blocks(stuck_run.results, vehicle.unit_names) for row in block]
    assert [row.symbol for row in rows] == list(printed)
    for row in rows:
        on_page = html[html.index(f'<th scope="row">{row.symbol}</th>') :].split("</tr>", maxsplit=1)[0]
        for cell in row[1:7]:
            assert f" {cell} " in printed[row.symbol]
            assert f">{cell}</td>" in on_page


def test_a_parameter_has_its_warrant_beside_its_error(html: str, stuck_run: Run) -> None:
    for symbol, entry in zip(SYMBOLS, stuck_run.results.identifiability, strict=True):
        row = html[html.index(f'<th scope="row">{symbol}</th>') :].split("</tr>", maxsplit=1)[0]
        assert f">{entry.flag.replace('_', ' ')}</td>" in row


def test_of_failures_found_at_the_same_time_each_has_its_own_size(stuck_run: Run) -> None:
    results, units = stuck_run.results, stuck_run.scenario.vehicle_data.unit_names
    assert results.injected is not None
    (first, *_), (found, *_) = results.injected, results.detections
    second = found._replace(magnitude=2.0 * found.magnitude)
    both = (first, first._replace(magnitude=second.magnitude))
    run: Any = SimpleNamespace(
        results=replace(results, injected=both, detections=(found, second)), scenario=stuck_run.scenario
    )
    sizes = [page._injected(run, number, {})["found"] for number in (0, 1)]
    assert sizes == [size(found, units), size(second, units)]


def test_what_was_injected_is_told_from_its_onset_to_its_declaration(html: str, stuck_run: Run) -> None:
    (one,) = stuck_run.results.injected or ()
    assert one.declared_s is not None
    row = html[html.index('<th scope="row">R4R stuck on</th>') :].split("</tr>", maxsplit=1)[0]
    for time_s in (one.start_s, one.first_acted_s, one.first_alarm_s, one.declared_s):
        assert f"{time_s:.2f} s" in row
    assert f"{one.force:+.2f} lbf" in row
    assert 'good">named</td>' in row
    assert f'<td class="number">{one.declared_s - (one.first_acted_s or 0.0):.2f} s</td>' in row


def test_what_acts_again_after_it_was_declared_is_said_to_be_known(stuck_run: Run) -> None:
    (one,) = stuck_run.results.injected or ()
    again = one._replace(start_s=3.0, first_acted_s=3.0, declared_s=3.0, magnitude=None)
    run: Any = SimpleNamespace(results=replace(stuck_run.results, injected=(one, again)), scenario=stuck_run.scenario)
    said = page._injected(run, 1, {})
    assert (said["times"][3], said["delay"]) == (None, "known before")
    assert page._injected(run, 0, {})["times"][3] == one.declared_s


def test_a_failure_that_is_not_found_is_red(stuck_run: Run) -> None:
    (one,) = stuck_run.results.injected or ()
    missed = one._replace(declared_s=None, outcome="missed", magnitude=None, magnitude_std=None)
    results = replace(stuck_run.results, injected=(missed,), detections=())
    html = report_html(Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals))
    row = html[html.index('<th scope="row">R4R stuck on</th>') :].split("</tr>", maxsplit=1)[0]
    assert 'bad">not found</td>' in row
    assert "Not found as what it is: R4R stuck on; see below." in html


def test_times_lead_to_the_replay(stuck_run: Run) -> None:
    declared_s = stuck_run.results.detections[0].time_s
    assert f'href="replay.html#t={declared_s:.3f}"' in report_html(stuck_run, replay="replay.html")


def test_a_detector_that_was_not_armed_is_said_and_shaded(stuck_run: Run) -> None:
    late = np.where(stuck_run.time_s[:, None] >= 3.0, stuck_run["tested"], 0.0)
    run = Run(stuck_run.scenario, stuck_run.results, stuck_run.time_s, {**stuck_run.signals, "tested": late})
    first_s = float(run.time_s[np.flatnonzero(late[:, 0])[0]])
    assert f"The detector was armed from {first_s:.2f} s on; 1 failure acted before." in report_html(run)
    unarmed = [window for window in plots.rates(plots.source(run)).windows if not window.armed]
    assert [(window.start_s, window.end_s) for window in unarmed] == [(0.0, first_s)]
    never = {**stuck_run.signals, "tested": np.zeros_like(late)}
    assert "The detector was never armed" in report_html(
        Run(stuck_run.scenario, stuck_run.results, stuck_run.time_s, never)
    )


def test_a_payload_has_its_size(tmp_path: Path) -> None:
    run = simulate(
        load_scenario(
            "payload_docking",
            ["duration_s=3", "maneuver=[]", "jumps=[{kind: dock, time_s: 1, mass: 500, position: [60, 0, -3]}]"],
        )
    )
    row = report_html(run)
    row = row[row.index('<th scope="row">payload dock</th>') :].split("</tr>", maxsplit=1)[0]
    assert "+500 slug" in row


def test_a_detection_says_when_what_how_much_and_how_sure(html: str, stuck_run: Run) -> None:
    entry = stuck_run.summary["detections"][0]
    row = html[html.index("<td>jet R4R: stuck on</td>") :].split("</tr>", maxsplit=1)[0]
    assert f"{entry['time_s']:.2f} s" in row
    assert f"{entry['magnitude']:+.1f}" in row
    assert f"after {entry['alarms']} alarms" in row


def test_hypotheses_have_no_count_of_alarms(stuck_run: Run) -> None:
    """What the first sample decides is declared at once, not after no alarm."""
    scenario = load_scenario("leak_named", ["duration_s=6", "failures=[]"])
    entry = stuck_run.results.detections[0]
    for samples, words in ((0, "17 at once"), (1, "17 after 1 sample<"), (3, "17 after 3 samples")):
        results = replace(stuck_run.results, detections=[entry._replace(statistic=17.0, alarms=samples)], injected=())
        assert words in report_html(Run(scenario, results, stuck_run.time_s, stuck_run.signals))


def test_it_needs_no_network(html: str) -> None:
    rest = without_plotly(html)
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", rest)
    assert len(html) < 8_000_000


def test_it_is_small_for_a_minute(sample_run: Run) -> None:
    assert len(report_html(sample_run).encode()) < 8_000_000


def test_it_is_small_for_five_minutes() -> None:
    run = simulate(load_scenario("healthy_long", ["duration_s=300", "execution.engine=loop"]))
    assert not run.shown().thinned  # the most that a page shows is not much more
    assert len(report_html(run).encode()) < 8_000_000


def test_the_page_has_the_plots_of_the_run(html: str, stuck_run: Run) -> None:
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL).group(1))  # type: ignore[union-attr]
    source = plots.source(stuck_run)
    assert [figure["name"] for figure in data["plots"]] == list(plots.available(source))
    expected = interactive.packed([interactive.drawn(plot(source)) for plot in plots.available(source).values()])
    assert {part: data[part] for part in expected} == expected
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


@pytest.fixture(scope="module")
def once(opened_once: Any, html: str, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The report, opened once; its console has said nothing."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(html, encoding="utf-8")
    return opened_once(path)


@pytest.fixture
def report(once: Any, stuck_run: Run) -> Any:
    """The same as it was opened: the whole run, the cursor at its start."""
    inked(once.as_opened(f"massprop.zoom(0, {stuck_run.time_s[-1]}).then(() => massprop.cursor(0))"))
    return once


def inked(report: Any) -> None:
    """Waits until the plots are in the colors of the page."""
    ink = "getComputedStyle(document.body).color"
    report.until(f"getComputedStyle(document.querySelector('#plot-detection_timeline .xtick text')).fill === {ink}")


def test_a_failure_is_a_button_away_and_values_fill_their_panels(report: Any, stuck_run: Run) -> None:
    page, (one,) = report.page, stuck_run.results.injected or ()
    assert [button.inner_text() for button in page.locator("#jumps button").all()] == ["Whole run", "failure 1"]
    plot = "document.querySelector('#plot-rates .js-plotly-plot')._fullLayout"
    whole = page.evaluate(f"{plot}.yaxis.range")
    page.locator("#jumps button").last.click()
    end_s = min(float(stuck_run.time_s[-1]), (one.declared_s or 0.0) + 5.0)
    report.until(f"Math.abs({plot}.xaxis.range[1] - {end_s}) < 1e-6")
    assert page.evaluate(f"{plot}.xaxis.range[0]") == 0.0  # 2 s before it acts is before the run
    page.evaluate("massprop.zoom(4, 5)")
    report.until(f"Math.abs({plot}.xaxis.range[0] - 4) < 1e-6")
    low, high = page.evaluate(f"{plot}.yaxis.range")
    first, last = np.searchsorted(stuck_run.time_s, [4.0 + 1e-9, 5.0 + 1e-9], side="right")
    within = np.degrees(stuck_run["rate"][first - 1 : last, 0])
    assert low < within.min()
    assert within.max() < high
    assert high - low < 1.5 * np.ptp(within) + 1e-3
    page.click("#zoom-out")
    report.until(f"Math.abs({plot}.xaxis.range[1] - {stuck_run.time_s[-1]}) < 1e-3")
    np.testing.assert_allclose(page.evaluate(f"{plot}.yaxis.range"), whole, rtol=1e-6)


def test_the_cursor_reads_every_signal_with_its_unit(report: Any, stuck_run: Run) -> None:
    page, row = report.page, 40
    page.evaluate(f"massprop.cursor({stuck_run.time_s[row] + 0.01})")
    rates = np.degrees(stuck_run["rate"][row])
    read = page.locator("#plot-rates .readout").inner_text().replace("\n", "")
    for axis, rate, said in zip("xyz", rates, re.findall(r"([xyz]) (\S+) deg/s", read), strict=True):
        assert said[0] == axis
        assert float(said[1]) == pytest.approx(rate, rel=1e-4, abs=1e-9)
    assert "thrust untold jet R4R" in page.locator("#plot-clusters .readout").inner_text().replace("\n", " ")
    largest = page.evaluate("massprop.reading(massprop.figures.find(f => f.name === 'likelihoods'), 1.5)")
    of_jets = [float(value) for label, value, _ in largest if label.startswith("of the jets ")]
    assert largest[0][0] == "of the jets R4R"
    assert len(of_jets) == 5
    assert of_jets == sorted(of_jets, reverse=True)
    tested = np.flatnonzero((stuck_run["tested"][:, 0] > 0) & (stuck_run.time_s <= 1.5 + 1e-9))[-1]
    assert of_jets[0] == pytest.approx(stuck_run["likelihood"][tested].max(), rel=1e-3)


@pytest.fixture
def fresh(opened: Any, stuck_run: Run, tmp_path: Path) -> Any:
    """A report of one's own, for what cannot be taken back."""
    return opened(write_report(stuck_run, tmp_path / "report.html"))


def test_jets_one_by_one_open_when_they_are_asked_for(fresh: Any) -> None:
    page = fresh.page
    assert page.locator("#plot-jets .main-svg").count() == 0
    page.click("#plot-jets summary")
    page.wait_for_selector("#plot-jets .main-svg")


def test_the_phase_plane_follows_cursor_and_zoom(report: Any, stuck_run: Run) -> None:
    page = report.page
    figure = "massprop.figures.find(f => f.name === 'phase_plane')"
    error, rate = (np.degrees(stuck_run[name][:, 0]) for name in ("attitude_error", "gyro"))
    row = int(np.flatnonzero(error)[-5])
    page.evaluate(f"massprop.cursor({stuck_run.time_s[row] + 0.01})")
    read = page.evaluate(f"massprop.reading({figure}, {stuck_run.time_s[row] + 0.01})")
    assert [label for label, _, _ in read[:2]] == ["attitude error x", "rate x"]
    np.testing.assert_allclose([float(value) for _, value, _ in read[:2]], [error[row], rate[row]], rtol=1e-4)
    plot = "document.querySelector('#plot-phase_plane .js-plotly-plot')"
    report.until(f"Math.abs({plot}.data[{plot}.data.length - 3].x[0] - {error[row]}) < 1e-4 * {abs(error[row])}")
    start, end = stuck_run.time_s[row - 10], stuck_run.time_s[row]
    page.evaluate(f"massprop.zoom({start}, {end})")
    report.until(f"{plot}.data[0].x.filter(value => value !== null).length <= 11")
    low, high = page.evaluate(f"{plot}._fullLayout.xaxis.range")
    assert low < np.nanmin(error[row - 10 : row + 1])
    assert np.nanmax(error[row - 10 : row + 1]) < high
    assert page.evaluate("document.querySelector('#plot-rates .js-plotly-plot')._fullLayout.xaxis.range[0]") == start
    assert report.said == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(report: Any, scheme: str) -> None:
    page = report.page
    page.emulate_media(color_scheme=scheme)
    inked(report)
    assert faint(page, 100) == []


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_wider_than_the_window(report: Any, width: int) -> None:
    report.page.set_viewport_size({"width": width, "height": 800})
    report.until("document.documentElement.scrollWidth <= innerWidth")  # plots follow soon after
    assert report.page.evaluate("innerWidth") == width


def test_on_a_phone_a_row_of_a_table_is_a_card(report: Any) -> None:
    """Nothing is to be scrolled to sideways, and each value stands beside what it is."""
    page = report.page
    page.set_viewport_size({"width": 390, "height": 800})
    cut = "[...document.querySelectorAll('.wide')].filter(one => one.scrollWidth > one.clientWidth).length"
    report.until(f"{cut} === 0")
    said = (
        "[...document.querySelectorAll('#injected + .wide td')].map(one => getComputedStyle(one, '::before').content)"
    )
    labels = [label.strip('" ') for label in page.evaluate(said) if label != "none"]
    times = ["begins", "first acted", "first alarm", "declared", "delay"]
    assert labels == [*times, "true size", "found size", "outcome"]
    places = "[...document.querySelectorAll('.wide td, .wide th')].map(one => one.getBoundingClientRect())"
    assert page.evaluate(f"{places}.every(box => box.left >= 0 && box.right <= innerWidth)")


NO_HOVER = """const asked = matchMedia;
window.matchMedia = what => what === "(hover: none)" ? { matches: true } : asked(what);"""
BAR_AND_KEY = """[...document.querySelectorAll(".js-plotly-plot")].map(plot => [
  plot.querySelector(".modebar").getBoundingClientRect().bottom,
  Math.min(...[...plot.querySelectorAll(".legend")].map(key => key.getBoundingClientRect().top)),
])"""


def test_where_nothing_hovers_the_bar_of_buttons_lies_over_no_key(opened: Any, stuck_run: Run, tmp_path: Path) -> None:
    page = opened(write_report(stuck_run, tmp_path / "report.html"), NO_HOVER).page
    found = [(bar, key) for bar, key in page.evaluate(BAR_AND_KEY) if key is not None]
    assert len(found) > 3
    assert all(bar <= key for bar, key in found)


def test_innovations_show_most_of_the_window_and_mark_the_rest(report: Any, stuck_run: Run) -> None:
    page = report.page
    plot = "document.querySelector('#plot-innovations .js-plotly-plot')"
    panel = plots.innovations(plots.source(stuck_run)).panels[0]
    assert panel.limits is not None
    np.testing.assert_allclose(page.evaluate(f"{plot}._fullLayout.yaxis.range"), panel.limits, rtol=1e-5)
    used = np.flatnonzero(stuck_run["rotation_used"][:, 0])
    value = np.degrees(stuck_run["rotation_innovation"][used, 0])
    band = 3.0 * np.degrees(stuck_run["rotation_innovation_std"][used, 0])
    time_s = stuck_run.time_s[used]
    for start_s, end_s in ((0.5, 3.0), (0.9, 1.3)):
        page.evaluate(f"massprop.zoom({start_s}, {end_s})")
        within = (time_s >= start_s) & (time_s <= end_s)
        limit = plots._reach(value[within], band[within])
        report.until(f"Math.abs({plot}._fullLayout.yaxis.range[1] / {limit} - 1) < 1e-5")
        beyond = time_s[within & (np.abs(value) > limit)]
        of_it = "/^triangle/.test(trace.marker && trace.marker.symbol) && (trace.yaxis || 'y') === 'y'"
        edges = f"{plot}.data.filter(trace => {of_it})"
        marked = sorted(page.evaluate(f"{edges}.flatMap(trace => trace.x)"))
        np.testing.assert_allclose(marked, beyond, rtol=1e-5)
        names = page.evaluate(f"{edges}.filter(trace => trace.showlegend).map(trace => trace.name)")
        assert names == ([f"{beyond.size} beyond the axis"] if beyond.size else [])


IDLE_NEVER = "window.requestIdleCallback = () => 0;"
DRAWN = (
    "[...document.querySelectorAll('.plot:not(.folded)')].map(card => card.querySelectorAll('.main-svg').length > 0)"
)


def test_what_is_in_the_window_is_drawn_without_waiting_for_the_rest(
    opened: Any, stuck_run: Run, tmp_path: Path
) -> None:
    path = write_report(stuck_run, tmp_path / "report.html")
    drawn = opened(path, IDLE_NEVER, ready="body[data-shown=yes]")
    drawn.until(f"{DRAWN}.includes(true)")
    assert drawn.page.evaluate(f"{DRAWN}.includes(false)")
    drawn.page.evaluate("dispatchEvent(new Event('beforeprint'))")  # paper shows every plot
    drawn.until(f"!{DRAWN}.includes(false)")
    assert drawn.said == []


def test_on_paper_it_has_four_pages_at_the_most(fresh: Any) -> None:
    page = fresh.page
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    fresh.until(f"!{DRAWN}.includes(false)")
    fresh.painted()
    shown = "[...document.querySelectorAll('#plot-inverse_inertia_diagonal .legendtext')].map(one => one.textContent)"
    assert [
        name for name in page.evaluate(shown) if name.startswith("3-sigma")
    ] == []  # no room: it is in the key above
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))) <= 4


def test_it_opens_from_disk_without_a_word_on_the_console(report: Any) -> None:
    assert report.said == []
    assert "jet R4R (cluster 12): stuck on" in report.page.inner_text("#verdict")
    assert report.page.locator("#failing .legendtext").count() > 0  # about the failure
    assert report.page.locator(".plot .main-svg").count() > 10


def test_what_is_in_the_window_is_drawn_first(opened: Any, stuck_run: Run, tmp_path: Path) -> None:
    """It is there to be read before the other plots are."""
    count = """
        new MutationObserver(() => {
            if (document.body && document.body.dataset.shown && window.drawnThen === undefined)
                window.drawnThen = document.querySelectorAll(".main-svg").length;
        }).observe(document, { attributes: true, subtree: true });
        window.scrolled = setInterval(() => {
            const last = document.querySelector("#plot-detection_timeline");
            if (last) { last.scrollIntoView(); clearInterval(window.scrolled); }
        }, 1);
    """
    page = opened(write_report(stuck_run, tmp_path / "report.html"), before=count).page
    whole = page.evaluate("document.querySelectorAll('.main-svg').length")
    assert 0 < page.evaluate("window.drawnThen") < 0.5 * whole


def test_one_cursor_moves_all_plots(report: Any) -> None:
    page = report.page

    def places() -> list[float]:
        return page.evaluate("[...document.querySelectorAll('.cursor')].map(e => parseFloat(e.style.left))")

    slider = page.locator("#cursor-slider")
    slider.fill("1")
    before = places()
    slider.fill("4")
    after = places()
    assert len(before) == page.locator(".plot:not(.folded)").count() - 1  # of the phase plane, which is not over time
    assert all(b - a > 50 for a, b in zip(before, after, strict=True))
    assert "4.00 s" in page.inner_text("#cursor-time")


def test_a_zoom_in_one_plot_is_a_zoom_in_all(report: Any) -> None:
    zoom = "{'xaxis.range[0]': 1, 'xaxis.range[1]': 2}"
    report.page.evaluate(f"Plotly.relayout(document.querySelector('#plot-rates .js-plotly-plot'), {zoom})")
    zoomed = "p => Math.abs(p._fullLayout.xaxis.range[1] - 2) < 1e-6"
    report.until(f"[...document.querySelectorAll('.plot:not(.broad) .js-plotly-plot')].every({zoomed})")
