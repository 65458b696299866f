"""Campaigns that are killed or interrupted, and go on: the same table, bit for bit, and nothing left running.

MASSPROP_CAMPAIGN_KILLS says how many kills at random moments are tried besides.
"""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import psutil
import pytest
from campaign_probe import GOOD, Driver, are_gone, environment, fliers, offspring, outcome, row, study

from massprop_drake.studies.campaign.campaign import Campaign

KILLS = int(os.environ.get("MASSPROP_CAMPAIGN_KILLS", "0"))


def parent(process: psutil.Process) -> psutil.Process:
    found = process.parent()
    assert found is not None
    return found


def test_kills_of_everything_lose_at_most_what_is_under_way(flown: Path, tmp_path: Path) -> None:
    mark = f"kills-{tmp_path}"
    environ = {**environment(tmp_path / "slow", slow_s=0.2), "PROBE_MARK": mark}
    file, out = study(tmp_path, GOOD), tmp_path / "out"

    driver = Driver(file, out, environ, workers=2)
    assert driver.line().startswith("at")
    fliers(mark)[0].kill()  # it flies the next chunk
    driver.go_on()
    assert driver.line().startswith("at")
    parent(fliers(mark)[0]).kill()  # a worker
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


@pytest.mark.skipif(not KILLS, reason="MASSPROP_CAMPAIGN_KILLS is not set: it waits for a minute")
def test_a_case_that_hangs_among_others_is_a_row_and_no_other_is_lost(flown: Path, tmp_path: Path) -> None:
    mark = f"hang-{tmp_path}"
    environ = {**environment(tmp_path / "faulty", bad={5: "hang"}), "PROBE_MARK": mark}
    file, out = study(tmp_path, GOOD), tmp_path / "out"
    file.write_text(file.read_text().replace("time_s: 600", "time_s: 60"))
    driver = Driver(file, out, environ, workers=2)
    assert driver.to_the_end() == "ended"
    assert driver.ended() == (0, "")
    assert are_gone(mark)
    assert row(out, 5)["reason"] == "took longer than 60 s"
    rest, expected = outcome(out), outcome(flown, GOOD)
    for part in (slice(0, 5), slice(6, GOOD)):
        length = part.stop - part.start
        assert rest.slice(part.start, length).equals(expected.slice(part.start, length))


@pytest.mark.parametrize("number", range(KILLS))
def test_a_kill_at_a_random_moment_loses_nothing(flown: Path, tmp_path: Path, number: int) -> None:
    mark = f"random-{tmp_path}"
    chance = random.Random(number)
    victim = ("driver", "worker", "flier")[number % 3]
    environ = {**environment(tmp_path / "slow", slow_s=0.2), "PROBE_MARK": mark}
    file, out = study(tmp_path, GOOD), tmp_path / "out"
    driver = Driver(file, out, environ, workers=2)
    assert driver.line().startswith("at")
    for _ in range(chance.randrange(3)):
        driver.go_on()
        assert driver.line().startswith("at")
    driver.go_on()
    time.sleep(chance.uniform(0.0, 1.0))
    if victim == "driver":
        driver.send(signal.SIGKILL)
        driver.ended()
        assert are_gone(mark)
        driver = Driver(file, out, environ, workers=2, resume=True)
    else:
        flying = chance.choice(fliers(mark) or offspring(mark)[1:])
        (flying if victim == "flier" else parent(flying)).kill()
    assert driver.to_the_end() == "ended"
    assert driver.ended() == (0, "")
    assert are_gone(mark)
    assert outcome(out).equals(outcome(flown, GOOD))
