"""Runs with the intervals that their readings guarantee: simulated, recorded, saved, and on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_probe import Massprop
from vehicle_flights import windows

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.results.allowed import Intervals
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.runners.guaranteed_intervals import add_guaranteed_intervals

INERTIA = [[905000.0, -30000.0, -240000.0], [-30000.0, 6690000.0, 21000.0], [-240000.0, 21000.0, 7100000.0]]
BODY = {"mass": 5800.0, "center_of_mass": [32.4, -0.2, 2.3], "inertia": INERTIA}
FLIGHT = [
    "duration_s=11",
    windows(("rhc", "+x", 0.5, 2.5), ("rhc", "+y", 3.5, 5.5), ("rhc", "+z", 6.5, 8.5)),
    "execution.engine=loop",
    "estimation.start=nominal",
    "detector.kind=off",
    "plant.lag_factor=1.05",
    f"plant.mass_properties={json.dumps(BODY)}",
]
LEAK = "failures=[{kind: leak, jet: R4R, force: 10, start_s: 9}]"


def flown(*overrides: str) -> Run:
    """A flight of the orbiter, whose body is not that of its file."""
    return simulate(load_scenario("orbiter_maneuver", [*FLIGHT, *overrides]), look_back=False)


def said(run: Run) -> Intervals:
    """The intervals of a run."""
    assert run.results.intervals is not None
    return run.results.intervals


def are_inside(found: Intervals, values: np.ndarray) -> bool:
    """Tests whether the ten parameters are in their intervals."""
    return all(pair is not None and pair[0] <= one <= pair[1] for pair, one in zip(found.pairs, values, strict=True))


@pytest.fixture(scope="module")
def healthy() -> Run:
    return add_guaranteed_intervals(flown())


@pytest.fixture(scope="module")
def leaking() -> Run:
    return flown(LEAK)


def test_the_truth_is_in_every_interval(healthy: Run) -> None:
    found, truth = said(healthy), healthy.results.truth
    assert are_inside(found, truth)
    assert (found.guaranteed, found.reason, found.contradicted, found.until_s) == (True, None, False, None)
    assert found.given == ("time constants within 4 sigma of what is stated",)
    assert found.in_words() == "guaranteed by the readings, given time constants within 4 sigma of what is stated"
    widths = [pair[1] - pair[0] for pair in found.pairs if pair is not None]
    assert (np.array(widths)[:3] < 2e-4 * truth[:3]).all()
    middle = [0.5 * (pair[0] + pair[1]) for pair in found.pairs if pair is not None]
    assert found.best["center_of_mass"] == middle[6:9]
    assert found.best["mass_reciprocal"] == middle[9]
    assert found.best["inverse_inertia"][1][2] == middle[3]


def test_a_failure_that_nobody_declared_contradicts_the_readings(leaking: Run) -> None:
    found = said(add_guaranteed_intervals(leaking))
    assert found.contradicted
    assert not found.guaranteed
    assert found.pairs == [None] * 10
    assert found.reason is not None
    assert found.reason.startswith("no vehicle explains all readings: some are at least ")


def test_readings_count_until_the_declared_failure_and_again_if_it_is_withdrawn(leaking: Run) -> None:
    one = DetectionRecord(
        onset_s=9.0,
        time_s=9.4,
        kind="jet_on",
        cluster=12,
        jet="R4R",
        isolated_to="jet",
        magnitude=10.0,
        magnitude_std=0.1,
        statistic=1.0e4,
        alarms=3,
    )

    def declared(entry: DetectionRecord) -> Intervals:
        results = replace(leaking.results, detections=(entry,))
        return said(add_guaranteed_intervals(Run(leaking.scenario, results, leaking.time_s, leaking.signals)))

    found = declared(one)
    before = leaking["truth"][np.searchsorted(leaking.time_s, 8.95) - 1]
    assert are_inside(found, before)
    assert found.until_s == 9.0
    assert found.in_words().startswith("guaranteed by the readings before 9.00 s, given")
    assert declared(one._replace(withdrawn_s=10.0)).contradicted


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("joint.rate_walk=1e-6", "joint.rate_walk"),
        ("joint.tank_fraction=null", "joint.tank_fraction=0 takes it for fixed"),
        ("duration_s=0.4", "so much open"),
    ],
)
def test_where_there_are_none_it_is_said_why(settings: str, words: str) -> None:
    found = said(add_guaranteed_intervals(flown("duration_s=2", settings)))
    assert words in (found.reason or "")
    assert (found.guaranteed, found.contradicted) == (False, False)
    assert found.best["mass_reciprocal"] is None


def test_the_command_line(massprop: Massprop, tmp_path: Path) -> None:
    settings = [word for one in FLIGHT for word in ("--set", one)]
    bare = ("--no-report", "--no-figures")
    done = massprop("run", "orbiter_maneuver", *settings, "--intervals", *bare, "--out", str(tmp_path / "one"))
    assert done.status == 0, done.err
    assert "what readings allow" in done.out
    assert "intervals:   guaranteed by the readings, given time constants" in done.out
    record = str(tmp_path / "one" / "telemetry.csv")
    like = ("--like", str(tmp_path / "one"), "--out", str(tmp_path / "two"))
    done = massprop("estimate", record, *like, "--intervals", "--json", *bare)
    assert done.status == 0, done.err
    assert json.loads(done.out)["intervals"]["guaranteed"]
