"""The replay in three dimensions."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from massprop_drake import load_scenario, simulate
from massprop_drake.display import events, write_replay
from massprop_drake.display.flight3d import replay_html
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.results.run import Run


def test_it_is_one_file_that_needs_no_network(stuck_run: Run, tmp_path: Path) -> None:
    html = write_replay(stuck_run, tmp_path / "replay.html").read_text(encoding="utf-8")
    assert '<script src="' not in html
    assert len(html) < 8_000_000


def test_the_failed_jet_and_the_one_found_are_marked(stuck_run: Run) -> None:
    (failed,), (found,) = events.failures(stuck_run), events.found(stuck_run)
    assert failed.jets == found.jets == (stuck_run.scenario.vehicle_data.jet_index("R4R"),)
    assert failed.start_s == 1.0
    assert 1.0 < found.start_s < 3.0
    assert found.text == "jet R4R: on"


def test_a_cluster_found_marks_all_its_jets(stuck_run: Run) -> None:
    entry = stuck_run.results.detections[0]._replace(jet=None, jets=(), isolated_to="cluster")
    results = replace(stuck_run.results, detections=(entry,))
    run = Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals)
    jets = run.scenario.vehicle_data.jets
    assert {jets[index].cluster for index in events.found(run)[0].jets} == {12}
    assert len(events.found(run)[0].jets) == 5


def test_what_is_commanded_is_said(stuck_run: Run) -> None:
    assert events.commanded(stuck_run.scenario, 0.5) == "RHC +x"
    assert events.commanded(stuck_run.scenario, 3.0) == "hold"


def test_a_script_in_a_name_stays_text(toy_data: dict[str, Any]) -> None:
    vehicle = Vehicle.model_validate({**toy_data, "name": "</script><script>alert(1)</script>"})
    scenario = load_scenario("jet_pulses").model_copy(
        update={"vehicle": vehicle, "jet_schedule": (), "duration_s": 1.0}
    )
    assert "<script>alert(1)" not in replay_html(simulate(scenario))


# ------------------------------------------------------------------------------------ in a browser


def picture(page: Any, time_s: float) -> np.ndarray:
    """The canvas at a time, as an array."""
    page.evaluate(f"massprop.seek({time_s})")
    page.wait_for_timeout(400)
    pixels: np.ndarray = imread(io.BytesIO(page.locator("#meshcat-pane canvas").screenshot()))
    return pixels


@pytest.fixture
def replay(opened: Any, stuck_run: Run, tmp_path: Path) -> Any:
    return opened(write_replay(stuck_run, tmp_path / "replay.html"))


def test_it_opens_from_disk_and_plays(replay: Any) -> None:
    page = replay.page
    assert replay.said == []
    page.click("#mp-play")
    replay.until("massprop.time() > 0.2")
    page.click("#mp-play")
    assert page.inner_text("#mp-play") == "Play"


def test_the_failed_jet_looks_different_after_its_onset(replay: Any) -> None:
    before, after = picture(replay.page, 0.96), picture(replay.page, 3.0)
    changed = np.abs(before[..., :3] - after[..., :3]).max(axis=2) > 0.15
    assert changed.sum() > 100
    assert "found: jet R4R: on" in replay.page.inner_text("#mp-now")
    assert "failed: jet R4R: stuck on" in replay.page.inner_text("#mp-now")


def test_a_plume_shows_while_a_jet_fires(replay: Any, stuck_run: Run) -> None:
    fires = (stuck_run["thrust"] > 0).any(axis=1)
    quiet = (stuck_run["truth"][:, 0] > 0) & ~fires
    firing_s = float(stuck_run.time_s[np.flatnonzero(fires & (stuck_run.time_s < 0.9))[0]]) + 0.02
    quiet_s = float(stuck_run.time_s[np.flatnonzero(quiet & (stuck_run.time_s < 0.9))[-1]]) + 0.02

    def orange(pixels: np.ndarray) -> int:
        red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
        return int(((red > 0.6) & (green > 0.35) & (blue < 0.35) & (red - blue > 0.4)).sum())

    assert orange(picture(replay.page, firing_s)) > orange(picture(replay.page, quiet_s)) + 50
