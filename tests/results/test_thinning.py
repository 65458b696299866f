"""Thinning keeps what a plot must show."""

from __future__ import annotations

import numpy as np

from massprop_drake.results.spool import Spool
from massprop_drake.results.thinning import outstanding_rows, picked

RANDOM = np.random.default_rng(5)
SIGNALS = {
    "time_s": 0.1 * np.arange(5000.0),
    "gyro": RANDOM.normal(size=(5000, 3)),
    "alarm": np.zeros((5000, 1)),
    "likelihood": np.where(RANDOM.random((5000, 4)) < 0.5, np.nan, 1.0),
}


def test_a_short_run_is_shown_whole() -> None:
    rows = outstanding_rows(SIGNALS, 5000, keys=("gyro",), events=("alarm",), buckets=1250)
    np.testing.assert_array_equal(rows, np.arange(5000))


def test_thinning_keeps_extremes_ends_and_events() -> None:
    alarm = SIGNALS["alarm"].copy()
    alarm[[77, 4000]] = 1.0
    signals = SIGNALS | {"alarm": alarm}
    rows = outstanding_rows(signals, 5000, keys=("gyro", "likelihood"), events=("alarm", "absent"), buckets=10)
    assert {0, 77, 4000, 4999} <= set(rows.tolist())
    assert len(rows) <= 2 + 2 + 10 * 2 * 7
    for stretch in np.split(np.arange(5000), 10):
        for axis in range(3):
            values = SIGNALS["gyro"][stretch, axis]
            assert stretch[np.argmax(values)] in rows
            assert stretch[np.argmin(values)] in rows
    spool = Spool(rows_per_piece=333)  # blocks that end elsewhere than the stretches
    for start in range(0, 5000, 111):
        spool.append({name: values[start : start + 111] for name, values in signals.items()})
    np.testing.assert_array_equal(
        outstanding_rows(spool, 5000, keys=("gyro", "likelihood"), events=("alarm",), buckets=10), rows
    )
    shown = picked(spool, rows)
    for name, values in signals.items():
        np.testing.assert_array_equal(shown[name], values[rows])  # every point is a recorded row


def test_of_peaks_the_greatest_are_kept() -> None:
    rows = outstanding_rows(SIGNALS, 5000, keys=(), peaks=("gyro",), events=(), buckets=10)
    assert len(rows) <= 2 + 10 * 3
    for stretch in np.split(np.arange(5000), 10):
        assert stretch[np.argmax(SIGNALS["gyro"][stretch, 1])] in rows


def test_events_do_not_crowd_out_everything() -> None:
    signals = SIGNALS | {"alarm": np.ones((5000, 1))}
    rows = outstanding_rows(signals, 5000, keys=(), events=("alarm",), buckets=10)
    assert len(rows) == 10 * 4 + 1  # four of each stretch, and the last row


def test_signals_that_are_not_wanted_are_left_out() -> None:
    rows = np.array([0, 7, 4999])
    shown = picked(SIGNALS, rows, leaving_out=("likelihood", "alarm"))
    assert set(shown) == {"time_s", "gyro"}
    np.testing.assert_array_equal(shown["gyro"], SIGNALS["gyro"][rows])
