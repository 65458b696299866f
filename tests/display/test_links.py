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
from massprop_drake.display.run import Run
from massprop_drake.inputs.true_blocks import MultibodyBlock


def _story(page: str) -> dict[str, Any]:
    """Data of the flight in a page."""
    found = re.search(r'id="data"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert found is not None
    story: dict[str, Any] = json.loads(found[1])
    return story


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


def test_a_models_links_are_where_its_joints_put_them(arm_run: Run, stuck_run: Run) -> None:
    story, live = _story(replay_html(arm_run)), Live(arm_run.scenario, speed=float("inf"))
    column = story["columns"].index("links")
    for row in (0, 5, 10):
        poses = np.array(story["rows"][row][column]).reshape(-1, 7)
        assert poses.shape == (4, 7)
        np.testing.assert_allclose(poses[0], [0, 0, 0, 1, 0, 0, 0], atol=1e-6)
        for link, place in _arm_links(arm_run, row).items():
            np.testing.assert_allclose(poses[link, :3], place, atol=1e-6)
    simulate(arm_run.scenario.model_copy(update={"duration_s": 0.5}), watch=live)
    rows = [json.loads(line)["row"] for line in live.said(0)]
    assert rows[2][column] == story["rows"][3][column]  # the first that is watched is after one sample
    story = _story(replay_html(stuck_run))  # a rigid vehicle
    assert "links" not in story["columns"]
    assert len(story["rows"][0]) == len(story["columns"])


def test_what_drake_cannot_draw_is_left_out_quietly(capfd: pytest.CaptureFixture[str]) -> None:
    block = load_scenario("servicer_arm").plant
    assert isinstance(block, MultibodyBlock)
    more = "<visual name='dish'><geometry><cone><radius>1</radius><length>1</length></cone></geometry></visual>"
    odd = block.model.replace("</inertial>", f"</inertial>{more}", 1)
    assert Links(block.model_copy(update={"model": odd})).drawn
    assert capfd.readouterr().err == ""


def test_the_scene_moves_the_links(opened: Any, arm_run: Run, tmp_path: Path) -> None:
    page = opened(write_replay(arm_run, tmp_path / "replay.html")).page

    def shown(link: int, time_s: float) -> list[float]:
        path = f'"world", "body", "structure", "links", "{link}"'
        return page.evaluate(f"(massprop.seek({time_s}), massprop.node({path}).position.toArray())")

    for link, place in _arm_links(arm_run, 5).items():
        np.testing.assert_allclose(shown(link, arm_run.time_s[5]), place, atol=1e-5)
    mean = 0.5 * (np.array(_arm_links(arm_run, 5)[3]) + _arm_links(arm_run, 6)[3])
    np.testing.assert_allclose(shown(3, 0.5 * arm_run.time_s[5:7].sum()), mean, atol=1e-5)
