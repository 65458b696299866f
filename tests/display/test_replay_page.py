"""The replay in three dimensions."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contrast_probe import faint
from matplotlib.image import imread

from massprop_drake import load_scenario, simulate
from massprop_drake.display import event_marks, instruments, write_replay
from massprop_drake.display.flight3d import replay_html
from massprop_drake.display.live import Live
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results.run import Run


def test_it_is_one_file_that_needs_no_network(stuck_run: Run, tmp_path: Path) -> None:
    html = write_replay(stuck_run, tmp_path / "replay.html").read_text(encoding="utf-8")
    assert '<script src="' not in html
    assert len(html) < 8_000_000


def test_the_failed_jet_and_the_one_found_are_marked(stuck_run: Run) -> None:
    failed, found = *event_marks.failures(stuck_run.scenario, 6.0), *event_marks.found(stuck_run)
    assert failed.jets == found.jets == (stuck_run.scenario.vehicle_data.jet_index("R4R"),)
    assert failed.start_s == 1.0
    assert 1.0 < found.start_s < 3.0
    assert found.text == "jet R4R: stuck on"


def test_a_cluster_found_marks_all_its_jets(stuck_run: Run) -> None:
    entry = stuck_run.results.detections[0]._replace(jet=None, jets=(), isolated_to="cluster")
    results = replace(stuck_run.results, detections=(entry,))
    run = Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals)
    jets = run.scenario.vehicle_data.jets
    assert {jets[index].cluster for index in event_marks.found(run)[0].jets} == {12}
    assert len(event_marks.found(run)[0].jets) == 5


def test_what_is_commanded_is_said(stuck_run: Run) -> None:
    assert event_marks.commanded(stuck_run.scenario, 0.5) == "RHC +x"
    assert event_marks.commanded(stuck_run.scenario, 3.0) == "hold"


def test_a_script_in_a_name_stays_text(toy_data: dict[str, Any]) -> None:
    vehicle = Vehicle.model_validate({**toy_data, "name": "</script><script>alert(1)</script>"})
    scenario = load_scenario("jet_pulses").model_copy(
        update={"vehicle": vehicle, "jet_schedule": (), "duration_s": 1.0}
    )
    assert "<script>alert(1)" not in replay_html(simulate(scenario))


def test_a_long_run_plays_at_its_own_times(stuck_run: Run) -> None:
    rows = np.r_[0:20, 40 : stuck_run.time_s.size : 3]
    thinned = Run(
        stuck_run.scenario,
        stuck_run.results,
        stuck_run.time_s[rows],
        {name: values[rows] for name, values in stuck_run.signals.items()},
    )
    data = json.loads(re.search(r'id="data">(.*?)</script>', replay_html(thinned), re.DOTALL).group(1))  # type: ignore[union-attr]
    np.testing.assert_allclose([row[0] for row in data["rows"]], stuck_run.time_s[rows], rtol=1e-6)


def test_packages_that_disagree_are_told_apart(stuck_run: Run) -> None:
    before = instruments.apart(stuck_run.scenario, stuck_run.time_s, stuck_run.signals)
    quiet = before[1:]
    assert 0.0 < np.nanmax(quiet) < instruments.APART_LIMITS[0]
    vehicle = stuck_run.scenario.vehicle_data
    step = 8.0 * np.sqrt(2.0 * vehicle.accelerometers[1].variance)
    reading = stuck_run["acc2"] + np.where(stuck_run.time_s[:, None] >= 3.0, step, 0.0) * np.array([0.0, 1.0, 0.0])
    run = Run(stuck_run.scenario, stuck_run.results, stuck_run.time_s, {**stuck_run.signals, "acc2": reading})
    loud = instruments.apart(run.scenario, run.time_s, run.signals)
    assert loud[np.searchsorted(run.time_s, 3.0)] > instruments.APART_LIMITS[1]
    np.testing.assert_array_equal(
        loud[-10:], instruments.apart(stuck_run.scenario, stuck_run.time_s, stuck_run.signals)[-10:]
    )


# ------------------------------------------------------------------------------------ in a browser


@pytest.fixture(scope="module")
def docking_run() -> Run:
    """A payload docks at 4 s; the estimates move with it later."""
    return simulate(
        load_scenario(
            "payload_docking",
            [
                "duration_s=8",
                "maneuver=[{controller: rhc, axis: +x, start_s: 0.5, end_s: 1.5}, {controller: rhc, axis: +y, "
                "start_s: 4.5, end_s: 6}]",
                "jumps=[{kind: dock, time_s: 4, mass: 500, position: [60, 0, -3]}]",
            ],
        )
    )


@pytest.fixture(scope="module")
def once(opened_once: Any, stuck_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The replay, opened once."""
    return opened_once(write_replay(stuck_run, tmp_path_factory.mktemp("replay") / "replay.html"))


@pytest.fixture
def replay(once: Any) -> Any:
    """The same as it was opened: at its start, with the pointer on nothing."""
    once.page.mouse.move(0, 0)
    return once.as_opened("location.hash = ''; massprop.seek(0)")


def test_what_is_shown_is_what_the_log_says_at_that_time(opened: Any, docking_run: Run, tmp_path: Path) -> None:
    """Positions read back from the scene at 20 times, most of them between two samples."""
    page = opened(write_replay(docking_run, tmp_path / "replay.html")).page
    time_s = docking_run.time_s
    docked = np.flatnonzero(np.diff(docking_run["truth"][:, 6]) != 0.0)[0] + 1
    for at_s in [0.0, *np.linspace(0.03, 7.9, 16), time_s[docked - 1], time_s[docked] - 0.001, time_s[docked]]:
        page.evaluate(f"massprop.seek({at_s})")
        shown = page.evaluate(
            """() => {
                const place = (...path) => massprop.node("world", "body", "structure", ...path).position.toArray();
                return {center: place(), estimate: place("estimate"),
                        payload: massprop.node("world", "body", "structure", "payloads", "0").visible};
            }"""
        )
        row = int(np.searchsorted(time_s, at_s + 1e-9, side="right")) - 1  # never one that is still to come
        np.testing.assert_allclose(shown["center"], -docking_run["truth"][row, 6:9], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(shown["estimate"], docking_run["estimate"][row, 6:9], rtol=1e-6, atol=1e-9)
        assert shown["payload"] == (at_s >= 4.0 - 1e-9)


def test_the_body_turns_between_samples(replay: Any, stuck_run: Run) -> None:
    row = int(np.abs(stuck_run["rate"][:, 0]).argmax())
    middle_s = float(stuck_run.time_s[row : row + 2].mean())
    expected = stuck_run["attitude"][row] + stuck_run["attitude"][row + 1]
    shown = replay.page.evaluate(
        f"(massprop.seek({middle_s}), (q => [q.w, q.x, q.y, q.z])(massprop.node('world', 'body').quaternion))"
    )
    np.testing.assert_allclose(np.abs(shown @ expected / np.linalg.norm(expected)), 1.0, atol=1e-9)


def test_events_stand_on_the_slider_and_lead_to_their_time(replay: Any, stuck_run: Run) -> None:
    page, found_s = replay.page, stuck_run.results.detections[0].time_s
    ticks = page.eval_on_selector_all("#mp-events button", "all => all.map(one => one.title)")
    assert ticks == ["1.00 s: jet R4R: stuck on", f"{found_s:.2f} s: declared: jet R4R: stuck on"]
    page.locator("#mp-events button").last.click()
    assert page.inner_text("#mp-time") == f"{found_s:.2f} s"


def test_an_address_leads_to_a_time(replay: Any) -> None:
    replay.page.evaluate("location.hash = '#t=2.5'")
    replay.until("massprop.time() === 2.5")


def test_a_jet_names_itself_under_the_pointer(replay: Any, stuck_run: Run) -> None:
    page = replay.page
    page.evaluate("massprop.seek(3)")
    at = page.evaluate(
        f"massprop.onScreen(massprop.node('world', 'body', 'structure'), "
        f"...{list(stuck_run.scenario.vehicle_data.jets[stuck_run.scenario.vehicle_data.jet_index('R4R')].position)})"
    )
    page.mouse.move(*at)
    replay.until("!document.getElementById('mp-hover').hidden")
    assert "cluster 12" in page.inner_text("#mp-hover")


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
def test_every_jet_is_within_the_window(replay: Any, width: int, height: int) -> None:
    page = replay.page
    page.set_viewport_size({"width": width, "height": height})
    replay.until(f"innerWidth === {width}")
    replay.painted()
    places = page.evaluate(
        "JSON.parse(document.getElementById('data').textContent).scene.jets.map("
        "jet => massprop.onScreen(massprop.node('world', 'body', 'structure'), ...jet.place))"
    )
    assert all(0 < x < width and 0 < y < height for x, y in places)
    assert np.ptp([x for x, _ in places]) > 0.3 * width


def picture(replay: Any, time_s: float) -> np.ndarray:
    """The canvas at a time, as an array."""
    replay.page.evaluate(f"massprop.seek({time_s})")
    replay.painted()
    pixels: np.ndarray = imread(io.BytesIO(replay.page.locator("#meshcat-pane canvas").screenshot()))
    return pixels


# in the page's own time: a busy machine may hear of it when the run has ended, and a click then plays it again
PAUSED_AT_A_FIFTH = """() => new Promise(said => {
    const button = document.getElementById("mp-play");
    const look = () => {
        if (massprop.time() <= 0.2) { requestAnimationFrame(look); return; }
        button.click();
        said(button.innerText);
    };
    look();
})"""


def test_it_opens_from_disk_and_plays(replay: Any) -> None:
    page = replay.page
    assert replay.said == []
    page.click("#mp-play")
    assert page.evaluate(PAUSED_AT_A_FIFTH) == "Play"


def test_the_failed_jet_looks_different_after_its_onset(replay: Any) -> None:
    before, after = picture(replay, 0.96), picture(replay, 3.0)
    changed = np.abs(before[..., :3] - after[..., :3]).max(axis=2) > 0.15
    assert changed.sum() > 100
    assert "found: jet R4R: stuck on" in replay.page.inner_text("#mp-now")
    assert "failed: jet R4R: stuck on" in replay.page.inner_text("#mp-now")


def test_a_plume_shows_while_a_jet_fires(replay: Any, stuck_run: Run) -> None:
    fires = (stuck_run["thrust"] > 0).any(axis=1)
    quiet = (stuck_run["truth"][:, 0] > 0) & ~fires
    firing_s = float(stuck_run.time_s[np.flatnonzero(fires & (stuck_run.time_s < 0.9))[0]]) + 0.02
    quiet_s = float(stuck_run.time_s[np.flatnonzero(quiet & (stuck_run.time_s < 0.9))[-1]]) + 0.02

    def orange(pixels: np.ndarray) -> int:
        red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
        return int(((red > 0.6) & (green > 0.35) & (blue < 0.35) & (red - blue > 0.4)).sum())

    assert orange(picture(replay, firing_s)) > orange(picture(replay, quiet_s)) + 50


def test_a_live_view_shows_what_the_replay_shows(browser: Any, stuck_run: Run) -> None:
    """The page of a run that is being computed, read at its end: clock, rates, lights, marks and positions."""
    live = Live(stuck_run.scenario, float("inf"))
    page = browser.new_page()
    page.goto(live.address)
    run = simulate(stuck_run.scenario, watch=live)
    last = run.time_s.size - 2  # watched are the samples before the one at the end
    while page.evaluate("window.massprop ? massprop.time() : -1") < run.time_s[last] - 1e-6:
        page.wait_for_timeout(100)
    assert page.inner_text("#mp-time") == f"{page.evaluate('massprop.time()'):.2f} s"
    row = int(np.searchsorted(run.time_s, page.evaluate("massprop.time()") + 1e-9, side="right")) - 1
    assert row >= last
    shown = page.evaluate("massprop.node('world', 'body', 'structure', 'estimate').position.toArray()")
    np.testing.assert_allclose(shown, run["estimate"][row, 6:9], rtol=1e-6, atol=1e-9)
    assert "failed: jet R4R: stuck on" in page.inner_text("#mp-now")
    assert "found: jet R4R" in page.inner_text("#mp-now")
    assert "sigma apart" in page.inner_text("#mp-apart")
    ticks = page.locator("#mp-events button").evaluate_all("all => all.map(tick => tick.title)")
    assert [tick.partition(": ")[2] for tick in ticks] == ["fails: jet R4R", "taken out of use: jet R4R"]
    page.evaluate("massprop.seek(0.5)")  # and what has been seen can be played again
    assert page.inner_text("#mp-time") == "0.50 s"
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_beside_the_picture_stands_out_from_its_ground(replay: Any, scheme: str) -> None:
    page = replay.page
    page.emulate_media(color_scheme=scheme)
    page.evaluate("massprop.seek(3)")
    assert faint(page, 15) == []
