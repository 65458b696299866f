"""Signals on disk: what is put in comes out, and of a long run what a plot must show."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import InputError, Run
from massprop_drake.results.spool import Spool, blocks, write_npz
from massprop_drake.results.thinning import outstanding_rows, pick_rows

RANDOM = np.random.default_rng(5)
SIGNALS = {
    "time_s": 0.1 * np.arange(5000.0),
    "gyro": RANDOM.normal(size=(5000, 3)),
    "alarm": np.zeros((5000, 1)),
    "likelihood": np.where(RANDOM.random((5000, 4)) < 0.5, np.nan, 1.0),
}


def _spooled(*sizes: int) -> Spool:
    spool, start = Spool(rows_per_piece=64), 0
    for size in sizes:
        spool.append({name: values[start : start + size] for name, values in SIGNALS.items()})
        start += size
    return spool


@pytest.mark.parametrize(
    "sizes", [(10,), (30, 34), (100, 10, 10), (5000,), (1,) * 130 + (4870,), (63, 1, 64, 65, 4807), (4999, 1)]
)
def test_what_is_put_in_comes_out(sizes: tuple[int, ...]) -> None:
    spool, total = _spooled(*sizes), sum(sizes)
    other = pickle.loads(pickle.dumps(spool))
    assert spool.n_rows == other.n_rows == total
    assert set(spool) == set(SIGNALS)
    assert ("gyro" in spool, "other" in spool) == (True, False)
    assert spool.in_memory == (total < 64)
    for name, values in SIGNALS.items():
        np.testing.assert_array_equal(spool[name], values[:total])
        np.testing.assert_array_equal(other[name], values[:total])
        np.testing.assert_array_equal(spool.last(name), values[total - 1])
    # pieces end where the number of rows says, however many came at a time
    lengths = [len(block["gyro"]) for block in spool.blocks("gyro")]
    assert lengths == [64] * (total // 64) + [total % 64] * (total % 64 > 0)
    spool.append({name: values[:1] for name, values in SIGNALS.items()})
    assert other.n_rows == total


def test_wrong_signals_and_places_are_told(tmp_path: Path) -> None:
    spool = _spooled(10)
    with pytest.raises(ValueError, match="the signals are"):
        spool.append({"gyro": np.zeros((1, 3))})
    with pytest.raises(KeyError):
        spool["other"]
    with pytest.raises(InputError, match="nowhere: cannot be written"):
        Spool(tmp_path / "nowhere")


def test_the_archive_is_numpys_and_the_same_from_disk_and_from_memory(tmp_path: Path) -> None:
    (block,) = blocks(SIGNALS, "gyro", "likelihood")
    assert set(block) == {"gyro", "likelihood"}
    indexed = Spool(rows_per_piece=64, index="time_s")
    indexed.append(SIGNALS)
    assert (list(indexed), "time_s" in indexed) == (["gyro", "alarm", "likelihood"], False)
    for number, signals in enumerate((_spooled(*[50] * 100), SIGNALS, indexed)):
        write_npz(tmp_path / f"{number}.npz", signals, {"gyro": {"unit": "rad/s"}})
        with np.load(tmp_path / f"{number}.npz", allow_pickle=False) as one:
            assert one.files == [*SIGNALS, "_description"]
            for name, values in SIGNALS.items():
                np.testing.assert_array_equal(one[name], values)
            assert str(one["_description"]) == '{"gyro": {"unit": "rad/s"}}'


def test_thinning_keeps_extremes_ends_and_events_alike_from_disk() -> None:
    alarm = SIGNALS["alarm"].copy()
    alarm[[77, 4000]] = 1.0
    signals = SIGNALS | {"alarm": alarm}
    rows = outstanding_rows(signals, 5000, keys=("gyro", "likelihood"), events=("alarm", "absent"), buckets=10)
    assert {0, 77, 4000, 4999} <= set(rows.tolist())
    assert len(rows) <= 2 + 2 + 10 * 2 * 7
    peaks = outstanding_rows(SIGNALS, 5000, keys=(), peaks=("gyro",), events=(), buckets=10)
    assert len(peaks) <= 2 + 10 * 3
    for stretch in np.split(np.arange(5000), 10):
        values = SIGNALS["gyro"][stretch]
        assert {*stretch[np.argmax(values, axis=0)], *stretch[np.argmin(values, axis=0)]} <= set(rows.tolist())
        assert set(stretch[np.argmax(values, axis=0)]) <= set(peaks.tolist())
    spool = Spool(rows_per_piece=333)  # blocks that end elsewhere than the stretches
    for start in range(0, 5000, 111):
        spool.append({name: values[start : start + 111] for name, values in signals.items()})
    again = outstanding_rows(spool, 5000, keys=("gyro", "likelihood"), events=("alarm",), buckets=10)
    np.testing.assert_array_equal(again, rows)
    shown = pick_rows(spool, rows, excluded=("likelihood",))
    assert set(shown) == set(SIGNALS) - {"likelihood"}
    for name, values in shown.items():
        np.testing.assert_array_equal(values, signals[name][rows])  # every point is a recorded row


def test_few_rows_are_all_shown_and_events_do_not_crowd_out_everything() -> None:
    rows = outstanding_rows(SIGNALS, 5000, keys=("gyro",), events=("alarm",), buckets=1250)
    np.testing.assert_array_equal(rows, np.arange(5000))
    signals = SIGNALS | {"alarm": np.ones((5000, 1))}
    rows = outstanding_rows(signals, 5000, keys=(), events=("alarm",), buckets=10)
    assert len(rows) == 10 * 4 + 1  # four of each stretch, and the last row


def test_a_long_run_is_thinned_to_rows_as_recorded(short_run: Run) -> None:
    assert short_run.thin_for_plots() is short_run
    time_s = np.arange(70 * short_run.time_s.size) * 0.08
    signals = {name: np.tile(values, (70, 1)) for name, values in short_run.signals.items()}
    signals["rate"][4321, 1] = signals["gyro"][4321, 1] = 0.5
    shown = Run(short_run.scenario, short_run.results, time_s, signals).thin_for_plots()
    assert shown.time_s.size < time_s.size
    assert shown.thin_for_plots() is shown
    rows = np.searchsorted(time_s, shown.time_s)
    assert 4321 in rows
    for name in ("gyro", "estimate", "command"):
        np.testing.assert_array_equal(shown[name], signals[name][rows])
