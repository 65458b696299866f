"""Several files of telemetry as one record, each with its own times."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import InputError
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.merging import MergedTable


def written(path: Path, names: Sequence[str], rows: Sequence[Sequence[float]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(rows)
    return path


def sensor(folder: Path, name: str, times: Array) -> Path:
    return written(folder / f"{name}.csv", ["time_s", name], [(float(time), float(time)) for time in times])


def values(table: MergedTable) -> Array:
    return np.concatenate([block.values for block in table.blocks(list(range(len(table.header))))])


def test_rows_are_those_of_all_files_by_time(tmp_path: Path) -> None:
    fast, slow = (
        sensor(tmp_path, "fast", np.arange(0.0, 2.0, 0.02)),
        sensor(tmp_path, "slow", np.arange(0.0, 2.0, 0.25)),
    )
    table = MergedTable([fast, slow])
    found = values(table)
    assert table.header == ["time_s", "fast", "slow"]
    assert found.shape[0] == 104  # 4 of the 8 slow times lie between the fast ones
    assert (np.diff(found[:, 0]) > 0.0).all()
    for column, count in ((1, 100), (2, 8)):
        there = ~np.isnan(found[:, column])
        assert there.sum() == count
        np.testing.assert_allclose(found[there, 0], found[there, column], rtol=0.0, atol=1e-6)


def test_commands_that_are_written_when_they_change_hold(tmp_path: Path) -> None:
    fast = sensor(tmp_path, "fast", np.arange(0.0, 4.0, 0.1))
    changes = [(0.0, 0.0), (0.5, 1.0), (0.6, 0.0), (0.7, 1.0), (1.0, 0.0), (1.1, 1.0), (3.0, 0.0)]
    table = MergedTable([fast, written(tmp_path / "jets.csv", ["time_s", "jet_A"], changes)])
    found = values(table)
    place = np.searchsorted([time for time, _ in changes], found[:, 0] + 1e-6) - 1
    np.testing.assert_array_equal(found[:, 2], np.array([level for _, level in changes])[place])
    assert any("whenever a command changes" in note for note in table.notes)


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (np.arange(0.0, 12.0, 0.25) + 5.0, r"slow\.csv: its clock is 5 s ahead: it runs from 5 to 16\.75 s"),
        (np.arange(0.0, 12.0, 0.25) + 1.7e9, r"slow\.csv: its clock is 1\.7e\+09 s ahead"),
        (np.arange(0.0, 12.0, 0.25) - 3.0, r"slow\.csv: its clock is 3 s behind"),
        (1e3 * np.arange(0.0, 12.0, 0.25), r"slow\.csv: its clock runs .* times as fast: .*; ms in place of s\?"),
    ],
)
def test_clocks_that_disagree_are_refused(times: Array, says: str, tmp_path: Path) -> None:
    fast = sensor(tmp_path, "fast", np.arange(0.0, 12.0, 0.02))
    with pytest.raises(InputError, match=says):
        MergedTable([fast, sensor(tmp_path, "slow", times)])


def test_a_column_of_two_files_is_refused(tmp_path: Path) -> None:
    fast = sensor(tmp_path, "fast", np.arange(0.0, 2.0, 0.1))
    twin = written(tmp_path / "twin.csv", ["time_s", "fast"], [(0.0, 1.0), (1.9, 1.0)])
    with pytest.raises(InputError, match=r"twin\.csv: has column 'fast', as .*fast\.csv has"):
        MergedTable([fast, twin])
    with pytest.raises(InputError, match=r"fast\.csv: is given twice"):
        MergedTable([fast, fast])
