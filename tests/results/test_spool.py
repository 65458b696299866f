"""Signals on disk: what is put in comes out."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import InputError
from massprop_drake.results.spool import Spool, blocks, write_npz

RANDOM = np.random.default_rng(5)
SIGNALS = {
    "time_s": 0.1 * np.arange(5000.0),
    "gyro": RANDOM.normal(size=(5000, 3)),
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
    assert (list(indexed), "time_s" in indexed) == (["gyro", "likelihood"], False)
    for number, signals in enumerate((_spooled(*[50] * 100), SIGNALS, indexed)):
        write_npz(tmp_path / f"{number}.npz", signals, {"gyro": {"unit": "rad/s"}})
        with np.load(tmp_path / f"{number}.npz", allow_pickle=False) as one:
            assert one.files == [*SIGNALS, "_description"]
            for name, values in SIGNALS.items():
                np.testing.assert_array_equal(one[name], values)
            assert str(one["_description"]) == '{"gyro": {"unit": "rad/s"}}'
