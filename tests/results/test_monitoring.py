"""Innovations while a flight goes on, against the whole flight looked back at, from reports made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from odds_probe import history, odds

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.estimation.faults.fault_report import History, hypothesis_report_row
from massprop_drake.results.consistency import Tally
from massprop_drake.results.monitoring import FlightMonitor, empty_recent
from massprop_drake.results.spool import Spool
from massprop_drake.results.summarize import exclude_explained
from massprop_drake.systems.layouts import HYPOTHESIS_REPORT, JOINT_REPORT, MASS_REPORT, ROTATION_REPORT

N = 44
PERIOD_S = 0.08
ROWS = 700  # more than are kept one by one
REPORTS = {one.name: one.sized(jets=N) for one in (ROTATION_REPORT, MASS_REPORT, JOINT_REPORT, HYPOTHESIS_REPORT)}
FORKS = {
    300: history(100.5 * PERIOD_S, (700.0, 500.0), (130.0, 120.0)),
    320: history(280.0 * PERIOD_S, (90.0, 88.0), (20.0, 30.0)),  # within the first
    330: history(300.0 * PERIOD_S, (60.0, 66.0), (15.0, 15.0)),  # begins in the one before
    690: history(650.0 * PERIOD_S, (800.0, 100.0), (0.0, 0.0)),  # of no accelerometer
}


def _packed(layout: Layout, **values: Any) -> np.ndarray:
    row = np.full(layout.size, np.nan)
    for name, value in values.items():
        row[layout.slice(name)] = value
    return row


def _rows(forks: dict[int, History]) -> list[dict[str, np.ndarray]]:
    """Reports sample by sample: readings that differ, some of which are not used."""
    random, found = np.random.default_rng(3), []
    for row in range(ROWS):
        now = {"rotation_nis": random.chisquare(3), "rotation_used": float(row % 5 != 0), "rotation_jump": 0.0}
        heavy = {"mass_nis": random.chisquare(3) * (50.0 if 150 <= row < 250 else 1.0), "mass_used": float(row % 2)}
        parts = {"gyro_components": 2.4, "accelerometer_components": random.uniform(0.3, 3.0)}
        reports = {
            "rotation_report": _packed(REPORTS["rotation_report"], **now),
            "mass_report": _packed(REPORTS["mass_report"], **heavy, mass_reciprocal=1.0, variance=1.0),
            "joint_report": _packed(REPORTS["joint_report"], **parts),
            "hypothesis_report": REPORTS["hypothesis_report"].pack(
                hypothesis_report_row((), odds(N, {3: 0.7}, 0.3), forks.get(row))
            ),
        }
        found.append(reports)
    return found


def _tallies(rows: list[dict[str, np.ndarray]]) -> list[Tally]:
    """As a run's summary has them: innovations of both filters as reported, and then as they are explained."""
    signals: dict[str, np.ndarray] = {"time_s": PERIOD_S * np.arange(len(rows))}
    for port, layout in REPORTS.items():
        signals |= layout.columns(np.vstack([row[port] for row in rows]))
    spool, found = Spool(index="time_s"), []
    spool.append(signals)
    for name, part in (("rotation", "gyro_components"), ("mass", "accelerometer_components")):
        tally, seen = Tally(), spool[f"{name}_used"][:, 0] != 0.0
        tally.add(spool[f"{name}_nis"][seen, 0], spool[part][seen, 0])
        found.append(exclude_explained(tally, spool, name, ()))
    return found


@pytest.mark.parametrize("forks", [{}, FORKS], ids=["one history", "four forks"])
def test_a_verdict_while_it_flies_is_that_of_the_flight_so_far(orbiter: Vehicle, forks: dict[int, History]) -> None:
    rows = _rows(forks)
    monitor = FlightMonitor(orbiter, ("gyro",), REPORTS)
    counts = monitor.counts
    for number, row in enumerate(rows):
        before = counts.copy()
        after = monitor.update_counts(counts, PERIOD_S * number, row)
        np.testing.assert_array_equal(counts, before)  # never changed
        counts = after
        if number in (299, 300, 319, 320, 330, ROWS - 1):
            now, (rotation, mass) = monitor.verdict(counts), _tallies(rows[: number + 1])
            assert now.samples == rotation.n
            said = (now.rotation_nis_mean, now.rotation_nis_beyond, now.rotation_nis_within)
            assert said == pytest.approx((rotation.mean, rotation.beyond, rotation.within), rel=1e-12)
            said = (now.translation_nis_mean, now.translation_nis_beyond)
            assert said == pytest.approx((mass.mean, mass.beyond), rel=1e-12)
            assert list(now.reasons) == [*rotation.faults("rotation"), *mass.faults("translation")]


def test_a_history_explains_what_was_heavy() -> None:
    """A payload that shows a hundred samples later: without its own sums the verdict would be another."""
    (_, reported), (_, judged_by) = (_tallies(_rows(forks)) for forks in ({}, FORKS))
    assert reported.faults("translation")
    assert not judged_by.faults("translation")
    assert (reported.mean or 0.0) > 5.0
    assert 0.0 < (judged_by.mean or 0.0) < 3.5


def test_of_a_fork_that_is_older_than_what_is_kept_its_share_counts() -> None:
    recent = empty_recent(10)
    for number in range(100):
        recent = recent.followed_on(float(number), 1.0, 6.0, 3.0)
    known = recent.replaced(39.0, 60.0 * 3.0, 60.0 * 3.0).tally  # of sixty samples the last ten
    assert known.n == 100
    assert known.mean == pytest.approx((90.0 * 6.0 + 10.0 * 3.0) / 100.0, rel=0.01)
    assert recent.tally.mean == pytest.approx(6.0)
