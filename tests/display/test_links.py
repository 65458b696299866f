"""The replay of a model with joints."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import load_scenario, simulate
from massprop_drake.display import write_replay
from massprop_drake.display.flight3d import replay_html
from massprop_drake.display.links import Links
from massprop_drake.display.live import Live
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.results.run import Run


def _story(page: str) -> dict[str, Any]:
    """Data of the flight in a page."""
    found = re.search(r'id="data"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert found is not None
    story: dict[str, Any] = json.loads(found[1])
    return story


@pytest.fixture(scope="module")
def arm_run() -> Run:
    """The servicer whose arm moves at once."""
    moves = (
        "[{joint: shoulder, start_s: 0, end_s: 2, position: 0.5}, {joint: elbow, start_s: 0, end_s: 2, position: 0}]"
    )
    return simulate(load_scenario("servicer_arm", ["duration_s=2.5", f"plant.moves={moves}"]))


def _arm_links(run: Run, row: int) -> dict[int, list[float]]:
    """Places of upper arm, forearm and payload in the vehicle frame, by hand; see the bundled model."""
    shoulder, elbow = run["joint_positions"][row]
    there = np.array([0.6, -0.35]) + 0.7 * np.array([np.cos(shoulder), np.sin(shoulder)])
    end = there + 0.7 * np.array([np.cos(shoulder + elbow), np.sin(shoulder + elbow)])
    return {1: [0.6, -0.35, 0.0], 2: [*there, 0.0], 3: [*end, 0.0]}


def test_a_models_links_are_where_its_joints_put_them(arm_run: Run) -> None:
    page = replay_html(arm_run)
    story = _story(page)
    column = story["columns"].index("links")
    for row in (0, 12, 25):
        poses = np.array(story["rows"][row][column]).reshape(-1, 7)
        assert poses.shape == (4, 7)
        np.testing.assert_allclose(poses[0], [0, 0, 0, 1, 0, 0, 0], atol=1e-6)
        for link, place in _arm_links(arm_run, row).items():
            np.testing.assert_allclose(poses[link, :3], place, atol=1e-6)


def test_what_drake_cannot_draw_is_left_out_quietly(capfd: pytest.CaptureFixture[str]) -> None:
    block = load_scenario("servicer_arm").plant
    assert isinstance(block, MultibodyBlock)
    more = "<visual name='dish'><geometry><cone><radius>1</radius><length>1</length></cone></geometry></visual>"
    odd = block.model.replace("</inertial>", f"</inertial>{more}", 1)
    links = Links(block.model_copy(update={"model": odd}))
    assert links.drawn
    assert capfd.readouterr().err == ""


def test_a_rigid_vehicle_has_no_links(stuck_run: Run) -> None:
    story = _story(replay_html(stuck_run))
    assert "links" not in story["columns"]
    assert len(story["rows"][0]) == len(story["columns"])


def test_the_scene_moves_the_links(opened: Any, arm_run: Run, tmp_path: Path) -> None:
    page = opened(write_replay(arm_run, tmp_path / "replay.html")).page
    for row in (0, 10, 25):
        page.evaluate(f"massprop.seek({arm_run.time_s[row]})")
        for link, place in _arm_links(arm_run, row).items():
            path = f'"world", "body", "structure", "links", "{link}"'
            shown = page.evaluate(f"massprop.node({path}).position.toArray()")
            np.testing.assert_allclose(shown, place, atol=1e-5)
    halfway = 0.5 * (arm_run.time_s[10] + arm_run.time_s[11])
    page.evaluate(f"massprop.seek({halfway})")
    shown = page.evaluate('massprop.node("world", "body", "structure", "links", "3").position.toArray()')
    mean = 0.5 * (np.array(_arm_links(arm_run, 10)[3]) + _arm_links(arm_run, 11)[3])
    np.testing.assert_allclose(shown, mean, atol=1e-5)


def test_a_live_view_has_the_same_rows(arm_run: Run) -> None:
    live = Live(arm_run.scenario, speed=float("inf"))
    simulate(arm_run.scenario.model_copy(update={"duration_s": 0.5}), watch=live)
    rows = [json.loads(line)["row"] for line in live.said(0)]
    story = _story(replay_html(arm_run))
    column = story["columns"].index("links")
    assert rows[2][column] == story["rows"][3][column]  # the first that is watched is after one sample
