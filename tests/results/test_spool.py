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
    "alarm": np.zeros((5000, 1)),
    "likelihood": np.where(RANDOM.random((5000, 4)) < 0.5, np.nan, 1.0),
}


def _spooled(*sizes: int, rows_per_piece: int = 64) -> Spool:
    spool = Spool(rows_per_piece=rows_per_piece)
    start = 0
    for size in sizes:
        spool.append({name: values[start : start + size] for name, values in SIGNALS.items()})
        start += size
    return spool


@pytest.mark.parametrize("sizes", [(5000,), (1,) * 130 + (4870,), (63, 1, 64, 65, 4807), (4999, 1)])
def test_what_is_put_in_comes_out(sizes: tuple[int, ...]) -> None:
    spool = _spooled(*sizes)
    assert spool.n_rows == 5000
    assert set(spool) == set(SIGNALS)
    assert "gyro" in spool
    assert "other" not in spool
    for name, values in SIGNALS.items():
        np.testing.assert_array_equal(spool[name], values)
    with pytest.raises(KeyError):
        spool["other"]


def test_it_can_be_read_while_it_grows() -> None:
    spool = _spooled(100, 10)
    np.testing.assert_array_equal(spool["gyro"], SIGNALS["gyro"][:110])
    spool.append({name: values[110:120] for name, values in SIGNALS.items()})
    np.testing.assert_array_equal(spool["gyro"], SIGNALS["gyro"][:120])


def test_the_signals_are_the_same_each_time() -> None:
    spool = _spooled(10)
    with pytest.raises(ValueError, match="the signals are"):
        spool.append({"gyro": np.zeros((1, 3))})


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: cannot be written"):
        Spool(tmp_path / "nowhere")


def test_the_archive_is_numpys_and_the_same_from_disk_and_from_memory(tmp_path: Path) -> None:
    write_npz(tmp_path / "spool.npz", _spooled(*[50] * 100), {"gyro": {"unit": "rad/s"}})
    write_npz(tmp_path / "arrays.npz", SIGNALS, {"gyro": {"unit": "rad/s"}})
    with np.load(tmp_path / "spool.npz", allow_pickle=False) as one, np.load(tmp_path / "arrays.npz") as other:
        assert one.files == other.files == [*SIGNALS, "_description"]
        for name, values in SIGNALS.items():
            np.testing.assert_array_equal(one[name], values)
            np.testing.assert_array_equal(other[name], values)
        assert str(one["_description"]) == '{"gyro": {"unit": "rad/s"}}'


def test_signals_in_memory_are_one_block() -> None:
    (block,) = blocks(SIGNALS, "gyro", "alarm")
    assert set(block) == {"gyro", "alarm"}
    assert block["gyro"] is SIGNALS["gyro"]


@pytest.mark.parametrize("sizes", [(5000,), (1,) * 130 + (4870,), (63, 1, 64, 65, 4807)])
def test_where_pieces_end_depends_on_the_number_of_rows_alone(sizes: tuple[int, ...]) -> None:
    assert [len(block["gyro"]) for block in _spooled(*sizes).blocks("gyro")] == [64] * 78 + [8]


def test_no_more_than_a_piece_is_held_in_memory() -> None:
    spool = Spool(rows_per_piece=64)
    for start in range(0, 5000, 50):
        spool.append({name: values[start : start + 50] for name, values in SIGNALS.items()})
        assert sum(len(block["gyro"]) for block in spool._waiting) < 64
    held = sum(values.nbytes for block in spool._waiting for values in block.values())
    assert held < 64 * 8 * 9  # of nine columns: no row that has been put away is held by a view on it


def test_what_fits_into_a_piece_stays_in_memory() -> None:
    spool = _spooled(30, 33)
    assert spool.in_memory
    assert spool["gyro"] is spool["gyro"]
    assert not _spooled(30, 34).in_memory


def test_the_last_row_is_at_hand() -> None:
    for sizes in ((10,), (60, 3), (60, 4), (60, 5)):
        np.testing.assert_array_equal(_spooled(*sizes).last("gyro"), SIGNALS["gyro"][sum(sizes) - 1])


def test_an_index_is_kept_but_is_no_signal(tmp_path: Path) -> None:
    spool = Spool(rows_per_piece=64, index="time_s")
    spool.append(SIGNALS)
    assert list(spool) == list(SIGNALS)[1:]
    assert "time_s" not in spool
    np.testing.assert_array_equal(spool["time_s"], SIGNALS["time_s"])
    write_npz(tmp_path / "spool.npz", spool, {})
    with np.load(tmp_path / "spool.npz", allow_pickle=False) as stored:
        assert stored.files == [*SIGNALS, "_description"]


@pytest.mark.parametrize("size", [10, 200])
def test_a_copy_has_all_of_it(size: int) -> None:
    spool = _spooled(size)
    other = pickle.loads(pickle.dumps(spool))
    spool.append({name: values[:1] for name, values in SIGNALS.items()})
    assert other.n_rows == size
    for name, values in SIGNALS.items():
        np.testing.assert_array_equal(other[name], values[:size])
