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
from massprop_drake.display.links import Links
from massprop_drake.display.live import Live
from massprop_drake.display.run import Run
from massprop_drake.inputs.true_blocks import MultibodyBlock


def _story(page: str) -> dict[str, Any]:
    """Data of the flight in a page."""
    found = re.search(r'id="data"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert found is not None
    story: dict[str, Any] = json.loads(found[1])
    return story


def test_a_long_run_plays_at_its_own_times_from_one_file(stuck_run: Run) -> None:
    rows = np.r_[0:20, 40 : stuck_run.time_s.size : 3]
    signals = {name: values[rows] for name, values in stuck_run.signals.items()}
    html = replay_html(Run(stuck_run.scenario, stuck_run.results, stuck_run.time_s[rows], signals))
    data = _story(html)
    assert len(data["rows"][0]) == len(data["columns"])
    assert "links" not in data["columns"]  # of a rigid vehicle
    np.testing.assert_allclose([row[0] for row in data["rows"]], stuck_run.time_s[rows], rtol=1e-6)
    assert '<script src="' not in html
    assert len(html) < 8_000_000


def test_jets_that_failed_and_that_were_found_are_marked(stuck_run: Run) -> None:
    vehicle = stuck_run.scenario.vehicle_data
    failed, found = *event_marks.failure_marks(stuck_run.scenario, 6.0), *event_marks.detection_marks(stuck_run)
    assert failed.jets == found.jets == (vehicle.jet_index("R4R"),)
    assert (failed.start_s, found.text) == (1.0, "jet R4R: stuck on")
    assert 1.0 < found.start_s < 3.0
    entry = stuck_run.results.detections[0]._replace(jet=None, jets=(), isolated_to="cluster")
    results = replace(stuck_run.results, detections=(entry,))
    (mark,) = event_marks.detection_marks(Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals))
    assert [vehicle.jets[index].cluster for index in mark.jets] == [12] * 5
    assert [event_marks.describe_command(stuck_run.scenario, time_s) for time_s in (0.5, 3.0)] == ["RHC +x", "hold"]


def test_packages_that_disagree_are_told_apart(stuck_run: Run) -> None:
    scenario, time_s = stuck_run.scenario, stuck_run.time_s
    quiet = instruments.package_deviation(scenario, time_s, stuck_run.signals)
    assert 0.0 < np.nanmax(quiet[1:]) < instruments.APART_LIMITS[0]
    step = 8.0 * np.sqrt(2.0 * scenario.vehicle_data.accelerometers[1].variance)
    reading = stuck_run["acc2"] + np.where(time_s[:, None] >= 3.0, step, 0.0) * np.array([0.0, 1.0, 0.0])
    loud = instruments.package_deviation(scenario, time_s, {**stuck_run.signals, "acc2": reading})
    assert loud[np.searchsorted(time_s, 3.0)] > instruments.APART_LIMITS[1]
    np.testing.assert_array_equal(loud[-10:], quiet[-10:])


@pytest.fixture(scope="module")
def arm_run() -> Run:
    """The servicer whose arm moves at once."""
    shoulder, elbow = (
        f"{{joint: {joint}, start_s: 0, end_s: 1, position: {to}}}" for joint, to in (("shoulder", 0.5), ("elbow", 0))
    )
    return simulate(load_scenario("servicer_arm", ["duration_s=1", f"plant.moves=[{shoulder}, {elbow}]"]))


def _arm_links(run: Run, row: int) -> dict[int, list[float]]:
    """Places of upper arm, forearm and payload in the vehicle frame, by hand; see the bundled model."""
    shoulder, elbow = run["joint_positions"][row]
    there = np.array([0.6, -0.35]) + 0.7 * np.array([np.cos(shoulder), np.sin(shoulder)])
    end = there + 0.7 * np.array([np.cos(shoulder + elbow), np.sin(shoulder + elbow)])
    return {1: [0.6, -0.35, 0.0], 2: [*there, 0.0], 3: [*end, 0.0]}


@pytest.fixture(scope="module")
def arm_page(arm_run: Run) -> str:
    return replay_html(arm_run)


def test_a_models_links_are_where_its_joints_put_them(arm_run: Run, arm_page: str) -> None:
    story, live = _story(arm_page), Live(arm_run.scenario, speed=float("inf"))
    column = story["columns"].index("links")
    for row in (0, 5, 10):
        poses = np.array(story["rows"][row][column]).reshape(-1, 7)
        assert poses.shape == (4, 7)
        np.testing.assert_allclose(poses[0], [0, 0, 0, 1, 0, 0, 0], atol=1e-6)
        for link, place in _arm_links(arm_run, row).items():
            np.testing.assert_allclose(poses[link, :3], place, atol=1e-6)
    simulate(arm_run.scenario.model_copy(update={"duration_s": 0.5}), watch=live)
    rows = [json.loads(line)["row"] for line in live.wait_for_rows(0)]
    assert rows[2][column] == story["rows"][3][column]  # the first that is watched is after one sample


def test_what_drake_cannot_draw_is_left_out_quietly(capfd: pytest.CaptureFixture[str]) -> None:
    block = load_scenario("servicer_arm").plant
    assert isinstance(block, MultibodyBlock)
    more = "<visual name='dish'><geometry><cone><radius>1</radius><length>1</length></cone></geometry></visual>"
    odd = block.model.replace("</inertial>", f"</inertial>{more}", 1)
    assert Links(block.model_copy(update={"model": odd})).drawn
    assert capfd.readouterr().err == ""


# ------------------------------------------------------------------------------------ in a browser


DOCKED_S = 2.0


@pytest.fixture(scope="module")
def flight(stuck_run: Run) -> Run:
    """A payload docks at 2 s, and from 4.5 s on the failed jet gives a hundredth of its thrust."""
    jet, time_s = stuck_run.scenario.vehicle_data.jet_index("R4R"), stuck_run.time_s
    thrust, truth = stuck_run["thrust"].copy(), stuck_run["truth"].copy()
    thrust[time_s >= 4.5, jet] *= 0.01
    truth[time_s >= DOCKED_S, 6:9] += 2.0
    docks = load_scenario("payload_docking").jumps[0].model_copy(update={"time_s": DOCKED_S})
    scenario = stuck_run.scenario.model_copy(update={"jumps": (docks,)})
    return Run(scenario, stuck_run.results, time_s, {**stuck_run.signals, "thrust": thrust, "truth": truth})


@pytest.fixture(scope="module")
def once(opened_once: Any, flight: Run, tmp_path_factory: pytest.TempPathFactory) -> Any:
    return opened_once(write_replay(flight, tmp_path_factory.mktemp("replay") / "replay.html"))


@pytest.fixture
def replay(once: Any) -> Any:
    """The same as it was opened: at its start, with the pointer on nothing."""
    once.page.mouse.move(0, 0)
    yield once.as_opened("location.hash = ''; massprop.seek(0)")
    assert once.said == []


def test_what_is_shown_is_what_the_log_says_at_that_time(replay: Any, flight: Run) -> None:
    """Positions read back from the scene, most of them between two samples."""
    time_s = flight.time_s
    docked = int(np.searchsorted(time_s, DOCKED_S))
    for at_s in [0.0, *np.linspace(0.03, 5.9, 8), time_s[docked - 1], time_s[docked] - 0.001, time_s[docked]]:
        replay.page.evaluate(f"massprop.seek({at_s})")
        shown = replay.page.evaluate(
            """() => {
                const place = (...path) => massprop.node("world", "body", "structure", ...path).position.toArray();
                return {center: place(), estimate: place("estimate"),
                        payload: massprop.node("world", "body", "structure", "payloads", "0").visible};
            }"""
        )
        row = int(np.searchsorted(time_s, at_s + 1e-9, side="right")) - 1  # never one that is still to come
        np.testing.assert_allclose(shown["center"], -flight["truth"][row, 6:9], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(shown["estimate"], flight["estimate"][row, 6:9], rtol=1e-6, atol=1e-9)
        assert shown["payload"] == (at_s >= DOCKED_S - 1e-9)


def test_the_body_turns_between_samples(replay: Any, stuck_run: Run) -> None:
    row = int(np.abs(stuck_run["rate"][:, 0]).argmax())
    middle_s = float(stuck_run.time_s[row : row + 2].mean())
    expected = stuck_run["attitude"][row] + stuck_run["attitude"][row + 1]
    shown = replay.page.evaluate(
        f"(massprop.seek({middle_s}), (q => [q.w, q.x, q.y, q.z])(massprop.node('world', 'body').quaternion))"
    )
    np.testing.assert_allclose(np.abs(shown @ expected / np.linalg.norm(expected)), 1.0, atol=1e-9)


def test_a_leak_has_a_smaller_plume_and_the_flown_path_goes_by(replay: Any, stuck_run: Run) -> None:
    vehicle, page = stuck_run.scenario.vehicle_data, replay.page
    jet, strongest = vehicle.jet_index("R4R"), max(one.thrust for one in vehicle.jets)
    share = np.sqrt(stuck_run["thrust"][-2, jet] / strongest)
    expected = (0.05 + 0.11 * 0.1 * share) / (0.05 + 0.11 * np.sqrt(vehicle.jets[jet].thrust / strongest))
    plume = f"massprop.node('world', 'body', 'structure', 'jets', '{jet}', 'plume')"
    for at_s, length in ((3.0, 1.0), (5.0, expected)):
        assert page.evaluate(f"(massprop.seek({at_s}), {plume}.scale.x)") == pytest.approx(length, abs=0.002)
    row = int(np.searchsorted(stuck_run.time_s, 5.0, side="right")) - 1
    gone = page.evaluate(f"(massprop.seek({stuck_run.time_s[row]}), massprop.node('world', 'path').position.toArray())")
    np.testing.assert_allclose(gone, -stuck_run["position"][row], rtol=1e-6, atol=1e-9)
    drawn = "(n => { massprop.node('world', 'path').traverse(o => { if (o.geometry) n = o.geometry.drawRange.count; })"
    assert page.evaluate(f"{drawn}; return n; }})(0)") == row + 1  # not what is still to come
    turned = "massprop.node('world', 'stars').getWorldQuaternion(massprop.node('world').quaternion.clone()).toArray()"
    assert page.evaluate(turned) == page.evaluate(f"(massprop.seek(0), {turned})")  # they do not turn with the body


def test_events_addresses_and_the_pointer_lead_to_their_place(replay: Any, stuck_run: Run) -> None:
    page, found_s = replay.page, stuck_run.results.detections[0].time_s
    ticks = page.eval_on_selector_all("#mp-events button", "all => all.map(one => one.title)")
    declared = f"{found_s:.2f} s: declared: jet R4R: stuck on"
    assert ticks == ["1.00 s: jet R4R: stuck on", declared, "2.00 s: payload: dock"]
    page.locator("#mp-events button").nth(1).click()
    assert page.inner_text("#mp-time") == f"{found_s:.2f} s"
    page.evaluate("location.hash = '#t=2.5'")
    replay.until("massprop.time() === 2.5")
    vehicle = stuck_run.scenario.vehicle_data
    place = list(vehicle.jets[vehicle.jet_index("R4R")].position)
    page.mouse.move(*page.evaluate(f"massprop.onScreen(massprop.node('world', 'body', 'structure'), ...{place})"))
    replay.until("!document.getElementById('mp-hover').hidden")
    assert "cluster 12" in page.inner_text("#mp-hover")


def test_every_jet_is_within_the_window(replay: Any) -> None:
    page = replay.page
    for width, height in ((1400, 900), (390, 844)):
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


def orange(pixels: np.ndarray) -> int:
    red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    return int(((red > 0.6) & (green > 0.35) & (blue < 0.35) & (red - blue > 0.4)).sum())


def test_failed_jets_and_plumes_are_seen(replay: Any, stuck_run: Run) -> None:
    before, after = picture(replay, 0.96), picture(replay, 1.9)
    assert (np.abs(before[..., :3] - after[..., :3]).max(axis=2) > 0.15).sum() > 100
    for words in ("found: jet R4R: stuck on", "failed: jet R4R: stuck on"):
        assert words in replay.page.inner_text("#mp-now")
    fires, early = (stuck_run["thrust"] > 0).any(axis=1), stuck_run.time_s < 0.9
    firing_s = float(stuck_run.time_s[np.flatnonzero(fires & early)[0]]) + 0.02
    quiet_s = float(stuck_run.time_s[np.flatnonzero(~fires & early)[-1]]) + 0.02
    assert orange(picture(replay, firing_s)) > orange(picture(replay, quiet_s)) + 50
    for scheme in ("light", "dark"):
        replay.page.emulate_media(color_scheme=scheme)
        assert faint(replay.page, 15) == []


def test_it_plays(replay: Any) -> None:
    """Plays in the page's own time: a busy machine may hear of it after the end, and a click then plays it again."""
    replay.page.click("#mp-play")
    paused = replay.page.evaluate(
        """() => new Promise(said => {
            const button = document.getElementById("mp-play");
            const look = () => {
                if (massprop.time() <= 0.2) { requestAnimationFrame(look); return; }
                button.click();
                said(button.innerText);
            };
            look();
        })"""
    )
    assert paused == "Play"


def test_a_live_view_shows_what_the_replay_shows(browser: Any, stuck_run: Run) -> None:
    """The page of a run that is being computed, read at its end: clock, rates, lights, marks and positions."""
    scenario = stuck_run.scenario.model_copy(update={"duration_s": 2.0})
    live = Live(scenario, float("inf"))
    page = browser.new_page()
    page.goto(live.address)
    run = simulate(scenario, watch=live)
    last = run.time_s.size - 2  # watched are the samples before the one at the end
    while page.evaluate("window.massprop ? massprop.time() : -1") < run.time_s[last] - 1e-6:
        page.wait_for_timeout(100)
    assert page.inner_text("#mp-time") == f"{page.evaluate('massprop.time()'):.2f} s"
    row = int(np.searchsorted(run.time_s, page.evaluate("massprop.time()") + 1e-9, side="right")) - 1
    assert row >= last
    shown = page.evaluate("massprop.node('world', 'body', 'structure', 'estimate').position.toArray()")
    np.testing.assert_allclose(shown, run["estimate"][row, 6:9], rtol=1e-6, atol=1e-9)
    for words, place in (("failed: jet R4R: stuck on", "now"), ("found: jet R4R", "now"), ("sigma apart", "apart")):
        assert words in page.inner_text(f"#mp-{place}")
    ticks = page.locator("#mp-events button").evaluate_all("all => all.map(tick => tick.title)")
    assert [tick.partition(": ")[2] for tick in ticks] == ["fails: jet R4R", "taken out of use: jet R4R"]
    page.evaluate("massprop.seek(0.5)")  # and what has been seen can be played again
    assert page.inner_text("#mp-time") == "0.50 s"
    page.close()


def test_the_scene_moves_the_links(opened: Any, arm_run: Run, arm_page: str, tmp_path: Path) -> None:
    (tmp_path / "replay.html").write_text(arm_page, encoding="utf-8")
    page = opened(tmp_path / "replay.html").page

    def shown(link: int, time_s: float) -> list[float]:
        path = f'"world", "body", "structure", "links", "{link}"'
        return page.evaluate(f"(massprop.seek({time_s}), massprop.node({path}).position.toArray())")

    for link, place in _arm_links(arm_run, 5).items():
        np.testing.assert_allclose(shown(link, arm_run.time_s[5]), place, atol=1e-5)
    mean = 0.5 * (np.array(_arm_links(arm_run, 5)[3]) + _arm_links(arm_run, 6)[3])
    np.testing.assert_allclose(shown(3, 0.5 * arm_run.time_s[5:7].sum()), mean, atol=1e-5)
