"""Campaigns that are killed or interrupted, and go on: the same table, bit for bit, and nothing left running."""

from __future__ import annotations

import signal
from pathlib import Path

from campaign_probe import GOOD, Driver, are_gone, environment, fliers, outcome, study

from massprop_drake.studies.campaign.campaign import Campaign


def test_kills_of_everything_lose_at_most_what_is_under_way(flown: Path, tmp_path: Path) -> None:
    mark = f"kills-{tmp_path}"
    environ = {**environment(tmp_path / "slow", slow_s=0.2), "PROBE_MARK": mark}
    file, out = study(tmp_path, GOOD), tmp_path / "out"

    driver = Driver(file, out, environ, workers=2)
    assert driver.line().startswith("at")
    fliers(mark)[0].kill()  # it flies the next chunk
    driver.go_on()
    assert driver.line().startswith("at")
    before = Campaign.load(out).status().counts.tried
    assert 0 < before < GOOD
    driver.send(signal.SIGINT, group=True)  # as Ctrl-C in a terminal
    assert driver.line() == "interrupted"
    status, errors = driver.ended()
    assert (status, errors) == (0, "")
    assert are_gone(mark)
    assert Campaign.load(out).status().counts.tried == before

    driver = Driver(file, out, environ, workers=2, resume=True)
    assert driver.line().startswith("at")
    driver.send(signal.SIGKILL)
    driver.ended()
    assert are_gone(mark)
    assert before < Campaign.load(out).status().counts.tried < GOOD
    assert not list(out.glob("*.part"))

    driver = Driver(file, out, {**environ, "PROBE_SLOW_S": "0"}, workers=1, resume=True)
    assert driver.to_the_end() == "ended"
    assert driver.ended() == (0, "")
    assert are_gone(mark)
    assert outcome(out).equals(outcome(flown, GOOD))
    assert not list(out.rglob(".massprop-*"))
    assert not list(out.glob(".seen*"))
