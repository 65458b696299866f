"""The report page."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contrast_probe import faint

from massprop_drake import load_scenario
from massprop_drake.cli import show
from massprop_drake.display import plots, write_report
from massprop_drake.display.page import report_html, summary_html
from massprop_drake.display.run import Run
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.results import table
from massprop_drake.results.allowed import Intervals
from massprop_drake.results.detections import size_in_words
from massprop_drake.results.fault_probabilities import FaultProbabilities, JetProbability

FAILURE = '<th scope="row">R4R stuck on</th>'


@pytest.fixture(scope="module")
def html(stuck_run: Run) -> str:
    return report_html(stuck_run)


def altered(run: Run, signals: Any = None, **results: Any) -> Run:
    """The run with other results."""
    return Run(run.scenario, replace(run.results, **results), run.time_s, signals or run.signals)


def rows(html: str, heading: str) -> list[str]:
    """Rows of tables that begin so."""
    return [part.split("</tr>", maxsplit=1)[0] for part in html.split(heading)[1:]]


def test_the_verdict_comes_first_and_names_the_failed_jet(html: str) -> None:
    found = re.search(r"Found: jet R4R \(cluster 12\): stuck on, .* lbf; since .* s, declared at .* s\.", html)
    assert found
    places = [html.index(words) for words in ('id="failing"', "Mass, center of mass, inertia", 'id="plots"')]
    assert [found.start(), *places] == sorted([found.start(), *places])


def test_what_a_run_may_say_is_said_where_it_is_so(html: str, stuck_run: Run) -> None:
    known, (one,) = stuck_run.results, stuck_run.results.injected or ()
    judged = known.consistency._replace(verdict="inconsistent", reasons=["the lag is off", "so is a jet"])
    told = FaultProbabilities({"F1U": JetProbability(0.25, "loss", -10.0, 2.5)}, 0.7, 0.0)
    missed = one._replace(declared_s=None, outcome="missed", magnitude=None, magnitude_std=None)
    unknown = np.full(10, np.nan)
    rest = {name: values for name, values in stuck_run.signals.items() if name not in ("truth", "thrust", "rate")}
    late = np.where(stuck_run.time_s[:, None] >= 3.0, stuck_run["tested"], 0.0)
    first_s = float(stuck_run.time_s[np.flatnonzero(late[:, 0])[0]])
    never = {**stuck_run.signals, "tested": np.zeros_like(late)}
    said = {
        "so that a 1-sigma may say too little: the lag is off and 1 more, below.": {"consistency": judged},
        "Too few samples to judge": {"consistency": known.consistency._replace(verdict="not enough data")},
        "<p>At the end: failed with probability: F1U 0.25 (loss, -10.0 ± 2.5 lbf).</p>": {"fault_probability": told},
        "Not found as what it is: R4R stuck on; see below.": {"injected": (missed,), "detections": ()},
        'bad">not found</td>': {"injected": (missed,), "detections": ()},
        "The truth is unknown": {"truth": unknown, "percent_error": unknown, "signals": rest},
        "Angular rate, as read": {"truth": unknown, "percent_error": unknown, "signals": rest},
        f"The detector was armed from {first_s:.2f} s on; 1 failure acted before.": {
            "signals": {**stuck_run.signals, "tested": late}
        },
        "The detector was never armed": {"signals": never},
    }
    for words, changes in said.items():
        assert words in report_html(altered(stuck_run, **changes))
        assert words not in html
    assert "Consistent: the readings contradict none of the stated uncertainties." in html
    assert "0.25" not in summary_html(stuck_run)
    declared_s = known.detections[0].time_s
    assert f'href="replay.html#t={declared_s:.3f}"' in report_html(stuck_run, replay="replay.html")


def test_what_readings_allow_is_a_table_and_a_contradiction_stands_out(html: str, stuck_run: Run) -> None:
    one, found = stuck_run.results.parameters[0].estimate, (1.0, 2.0)
    inertia = (((one - 1.0, one + 1.0), found, found), (found, found, found), (found, found, None))
    told = Intervals(inertia, (found, found, found), found, {}, guaranteed=True, given=("this", "that"))
    page = report_html(altered(stuck_run, intervals=told))
    cells = page[page.index('id="intervals"') :].split("<tr>")[2:12]
    assert [SYMBOLS[index] in row for index, row in enumerate(cells)] == [True] * 10
    assert ("✓ yes" in cells[0], "✗ no" in cells[1]) == (True, True)
    assert '<p class="soft">Guaranteed by the readings, given this and that.</p>' in page
    told = told._replace(guaranteed=False, reason="no vehicle explains all", contradicted=True)
    page = report_html(altered(stuck_run, intervals=told))
    assert '<p class="bad">None: no vehicle explains all.</p>' in page
    assert "estimate inside" not in page
    assert 'id="intervals"' not in html


def test_terminal_and_page_say_the_same_numbers(html: str, stuck_run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    vehicle, results = stuck_run.scenario.vehicle_data, stuck_run.results
    show.print_simulation(results, vehicle, Path("there"))
    printed = {line.split("│")[1].strip(): line for line in capsys.readouterr().out.splitlines() if line[:1] == "│"}
    told = [row for block in table.property_rows(results, vehicle.unit_names) for row in block]
    assert [row.symbol for row in told] == list(printed)
    for row in told:
        (on_page,) = rows(html, f'<th scope="row">{row.symbol}</th>')
        for cell in row[1:7]:
            assert f" {cell} " in printed[row.symbol]
            assert f">{cell}</td>" in on_page
    for symbol, entry in zip(SYMBOLS, results.identifiability, strict=True):
        assert f">{entry.flag.replace('_', ' ')}</td>" in rows(html, f'<th scope="row">{symbol}</th>')[0]


def test_what_was_injected_is_told_from_its_onset_to_its_declaration(html: str, stuck_run: Run) -> None:
    results, units = stuck_run.results, stuck_run.scenario.vehicle_data.unit_names
    (one,), (found,) = results.injected or (), results.detections
    assert one.declared_s is not None
    (row,) = rows(html, FAILURE)
    times = (one.start_s, one.first_acted_s, one.first_alarm_s, one.declared_s)
    assert all(f"{time_s:.2f} s" in row for time_s in times)
    assert f"{one.force:+.4g} lbf" in row
    assert 'good">named</td>' in row
    assert f'<td class="number">{one.declared_s - (one.first_acted_s or 0.0):.2f} s</td>' in row
    # two at the same time each have their own size; what acts again after it was declared is known
    second = found._replace(magnitude=2.0 * (found.magnitude or 0.0))
    again = one._replace(start_s=3.0, first_acted_s=3.0, declared_s=3.0, magnitude=None)
    both = (one, one._replace(magnitude=second.magnitude), again)
    told = rows(report_html(altered(stuck_run, injected=both, detections=(found, second))), FAILURE)
    assert [size_in_words(each, units) in row for each, row in zip((found, second), told, strict=False)] == [True, True]
    assert "known before" in told[2]
    jumps = load_scenario("payload_docking").jumps
    docked = altered(stuck_run, injected=(one._replace(kind="dock", jet=None, magnitude=None),))
    docked.scenario = stuck_run.scenario.model_copy(update={"jumps": jumps})
    assert f"{jumps[0].mass:+g} slug" in rows(report_html(docked), '<th scope="row">payload dock</th>')[0]


def test_a_detection_says_when_what_how_much_and_how_sure(html: str, stuck_run: Run) -> None:
    entry = stuck_run.results.detections[0]
    (row,) = rows(html, "<td>jet R4R: stuck on</td>")
    for words in (f"{entry.time_s:.2f} s", f"{entry.magnitude:+.1f}", f"after {entry.alarms} alarms"):
        assert words in row
    scenario = load_scenario("leak_named", ["duration_s=6", "failures=[]"])  # hypotheses have probabilities
    results = replace(stuck_run.results, detections=[entry._replace(probability=0.99931)], injected=())
    page = report_html(Run(scenario, results, stuck_run.time_s, stuck_run.signals))
    assert ">probability</th>" in page
    assert "<td>0.9993</td>" in page


def test_the_page_has_the_plots_of_the_run_and_needs_no_network(html: str, stuck_run: Run) -> None:
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL).group(1))  # type: ignore[union-attr]
    assert [figure["name"] for figure in data["plots"]] == list(plots.available_plots(plots.source(stuck_run)))
    np.testing.assert_allclose(data["time"], stuck_run.time_s, rtol=1e-8)
    own = re.sub(r"<script>/\*\*.*?</script>", "", html, count=1, flags=re.DOTALL)  # without plotly
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", own)
    assert len(html) < 3_000_000


# ------------------------------------------------------------------------------------ in a browser

INK = "getComputedStyle(document.querySelector('#plot-detection_timeline .xtick text')).fill"
INKED = f"{INK} === getComputedStyle(document.body).color"
DRAWN = (
    "[...document.querySelectorAll('.plot:not(.folded)')].map(card => card.querySelectorAll('.main-svg').length > 0)"
)


IDLE_NEVER = "window.requestIdleCallback = () => 0;"
KEY = "[...document.querySelectorAll('#plot-inverse_inertia_diagonal .legendtext')].map(one => one.textContent)"


@pytest.fixture(scope="module")
def printed(opened_once: Any, stuck_run: Run, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, dict[str, Any]]:
    """The report, opened once, of a run of whose jets a dozen fail probably, and what it was when it was printed.

    What is beyond the window is not drawn before that.
    """
    of_jets = np.zeros_like(stuck_run["command"])
    of_jets[40:] = np.where(np.arange(44) < 12, 0.4 - 0.02 * np.arange(44), 0.0)
    none, unknown = 1.0 - of_jets[:, :1], np.full_like(of_jets[:, :1], 0.01)
    more = {"fault_probability": of_jets, "none_probability": none, "unknown_probability": unknown}
    path = write_report(
        altered(stuck_run, {**stuck_run.signals, **more}), tmp_path_factory.mktemp("report") / "report.html"
    )
    opened = opened_once(path, IDLE_NEVER, ready="body[data-shown=yes]")
    page, before = opened.page, {}
    opened.until(f"{DRAWN}.includes(true)")
    before["all"] = not page.evaluate(f"{DRAWN}.includes(false)")
    before["folded"] = page.locator("#plot-jets .main-svg").count()
    page.evaluate("dispatchEvent(new Event('beforeprint'))")  # paper shows every plot
    opened.until(f"!{DRAWN}.includes(false)")
    opened.painted()
    before["key"] = page.evaluate(KEY)
    before["sheets"] = len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4")))
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    return opened, before


@pytest.fixture
def report(printed: Any, stuck_run: Run) -> Any:
    """The same as it was opened: the whole run, the cursor at its start."""
    once, _ = printed
    once.as_opened(f"massprop.zoom(0, {stuck_run.time_s[-1]}).then(() => massprop.cursor(0))").until(INKED)
    yield once
    assert once.said == []


def test_what_is_in_the_window_is_drawn_without_waiting_for_the_rest_and_all_on_four_sheets(
    report: Any, printed: Any
) -> None:
    _, before = printed
    assert (before["all"], before["folded"]) == (False, 0)
    assert before["key"]
    assert not any(name.startswith("3-sigma") for name in before["key"])  # no room: it is in the key above
    assert 1 <= before["sheets"] <= 4
    report.page.click("#plot-jets summary")  # jets one by one, when they are asked for
    report.page.wait_for_selector("#plot-jets .main-svg")


def test_a_failure_is_a_button_away_and_values_fill_their_panels(report: Any, stuck_run: Run) -> None:
    page, (one,) = report.page, stuck_run.results.injected or ()
    assert "jet R4R (cluster 12): stuck on" in page.inner_text("#verdict")
    assert page.locator("#failing .legendtext").count() > 0  # about the failure
    assert [button.inner_text() for button in page.locator("#jumps button").all()] == ["Whole run", "failure 1"]
    plot = "document.querySelector('#plot-rates .js-plotly-plot')._fullLayout"
    whole = page.evaluate(f"{plot}.yaxis.range")
    page.locator("#jumps button").last.click()
    end_s = min(float(stuck_run.time_s[-1]), (one.declared_s or 0.0) + 5.0)
    report.until(f"Math.abs({plot}.xaxis.range[1] - {end_s}) < 1e-6")
    assert page.evaluate(f"{plot}.xaxis.range[0]") == 0.0  # 2 s before it acts is before the run
    zoom = "{'xaxis.range[0]': 4, 'xaxis.range[1]': 5}"  # in one plot is a zoom in all
    page.evaluate(f"Plotly.relayout(document.querySelector('#plot-velocities .js-plotly-plot'), {zoom})")
    zoomed = "p => Math.abs(p._fullLayout.xaxis.range[0] - 4) < 1e-6"
    report.until(f"[...document.querySelectorAll('.plot:not(.broad) .js-plotly-plot')].every({zoomed})")
    low, high = page.evaluate(f"{plot}.yaxis.range")
    first, last = np.searchsorted(stuck_run.time_s, [4.0 + 1e-9, 5.0 + 1e-9], side="right")
    within = np.degrees(stuck_run["rate"][first - 1 : last, 0])
    assert low < within.min() <= within.max() < high
    assert high - low < 1.5 * np.ptp(within) + 1e-3
    page.click("#zoom-out")
    report.until(f"Math.abs({plot}.xaxis.range[1] - {stuck_run.time_s[-1]}) < 1e-3")
    np.testing.assert_allclose(page.evaluate(f"{plot}.yaxis.range"), whole, rtol=1e-6)


def test_one_cursor_reads_every_signal_with_its_unit(report: Any, stuck_run: Run) -> None:
    page, row = report.page, 40
    slider, lefts = page.locator("#cursor-slider"), "[...document.querySelectorAll('.cursor')]"
    slider.fill("1")
    before = page.evaluate(f"{lefts}.map(e => parseFloat(e.style.left))")
    slider.fill("4")
    after = page.evaluate(f"{lefts}.map(e => parseFloat(e.style.left))")
    assert len(before) == page.locator(".plot:not(.broad) .js-plotly-plot").count()  # all that are over the time
    assert all(b - a > 50 for a, b in zip(before, after, strict=True))
    assert "4.00 s" in page.inner_text("#cursor-time")
    page.evaluate(f"massprop.cursor({stuck_run.time_s[row] + 0.01})")
    read = page.locator("#plot-rates .readout").inner_text().replace("\n", "")
    said = re.findall(r"([xyz]) (\S+) deg/s", read)
    assert [axis for axis, _ in said] == list("xyz")
    assert [float(value) for _, value in said] == pytest.approx(np.degrees(stuck_run["rate"][row]), rel=1e-4, abs=1e-9)
    assert "thrust untold jet R4R" in page.locator("#plot-clusters .readout").inner_text().replace("\n", " ")
    read = page.evaluate("massprop.reading(massprop.figures.find(f => f.name === 'fault_probabilities'), 5)")
    expected = [0.4 - 0.02 * number for number in range(5)]  # each of the likeliest, and five of the others
    assert [float(value) for label, value, _ in read if label[:14] == "jet has failed"] == pytest.approx(
        [*expected, *(one - 0.1 for one in expected)]
    )


def test_text_stands_out_from_its_ground(report: Any) -> None:
    for scheme in ("light", "dark"):
        report.page.emulate_media(color_scheme=scheme)
        report.until(INKED)
        assert faint(report.page, 100) == []


PLOTS = ".failing .js-plotly-plot, .plot:not(.broad) .js-plotly-plot"
CROWDED = """PLOTS => [...document.querySelectorAll(PLOTS)].filter(plot => {
  const { left, top } = plot.getBoundingClientRect(), full = plot._fullLayout, time = full.xaxis;
  const axes = Object.keys(full).filter(key => /^yaxis/.test(key)).map(key => full[key]);
  const panels = axes.map(axis => new DOMRect(left + time._offset, top + axis._offset, time._length, axis._length));
  const texts = [...plot.querySelectorAll(".legend, .annotation-text-g")].map(one => one.getBoundingClientRect());
  const apart = (one, other) => one.right < other.left + 1 || other.right < one.left + 1
    || one.bottom < other.top + 1 || other.bottom < one.top + 1;
  return texts.some((one, number) => [...texts.slice(number + 1), ...panels].some(other => !apart(one, other)));
}).map(plot => plot.parentElement.textContent.slice(0, 40))"""  # plots in which a key or a label overlaps anything


def test_on_a_phone_a_row_of_a_table_is_a_card(report: Any) -> None:
    """Nothing is wider than the window or to be scrolled to sideways, and each value stands beside what it is."""
    page = report.page
    for width in (1400, 390):
        page.set_viewport_size({"width": width, "height": 800})
        report.until("document.documentElement.scrollWidth <= innerWidth")  # plots follow soon after
        assert page.evaluate("innerWidth") == width
        assert page.evaluate(CROWDED, PLOTS) == []
        assert page.locator("#failing .annotation-text-g").count() == 2
    report.until("[...document.querySelectorAll('.wide')].every(one => one.scrollWidth <= one.clientWidth)")
    cells = "[...document.querySelectorAll('#injected + .wide td')]"
    said = page.evaluate(f"{cells}.map(one => getComputedStyle(one, '::before').content)")
    times = ["begins", "first acted", "first alarm", "declared", "delay"]
    assert [label.strip('" ') for label in said if label != "none"] == [*times, "true size", "found size", "outcome"]
    places = "[...document.querySelectorAll('.wide td, .wide th')].map(one => one.getBoundingClientRect())"
    assert page.evaluate(f"{places}.every(box => box.left >= 0 && box.right <= innerWidth)")
