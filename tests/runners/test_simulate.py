"""Simulating in bounded memory: where blocks end changes nothing, and no more than a block is held."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.results.spool import Spool
from massprop_drake.runners import logs
from massprop_drake.runners import simulate as module
from massprop_drake.runners.loop import Loop

FAILING = [
    "duration_s=12",
    "maneuver=[{controller: rhc, axis: +x, start_s: 0.2, end_s: 0.8}, "
    "{controller: thc, axis: +y, start_s: 8, end_s: 10}]",
    "failures=[{kind: stuck_on, jet: R4R, start_s: 3}]",
    "estimation={filter: thesis, start: nominal, std_fraction: 0.001}",
]


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    """With jets that fire at the last sample, a failure, and a detection long before the end."""
    return load_scenario("stuck_on_29", FAILING)


@pytest.fixture(scope="session")
def at_once(scenario: Scenario) -> Run:
    """A run of it in one block; do not change its arrays."""
    return simulate(scenario)


@pytest.fixture
def few_rows(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Blocks of about 20 rows, pieces of 16; the sizes of the blocks as they are taken in."""
    taken: list[int] = []

    class Watched(Spool):
        def append(self, rows: Any) -> None:
            taken.append(len(rows["time_s"]))
            super().append(rows)

    monkeypatch.setattr(module, "BLOCK_ROWS", 20)
    monkeypatch.setattr(module, "CHUNK_S", 0.5)
    monkeypatch.setattr(logs, "Spool", partial(Watched, rows_per_piece=16))
    return taken


def _assert_same(one: Run, other: Run) -> None:
    assert list(one.signals) == list(other.signals)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    for name in one.signals:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert one.state == other.state
    assert {**one.summary, "timing": None} == {**other.summary, "timing": None}


def test_many_blocks_give_the_run_of_one(scenario: Scenario, at_once: Run, few_rows: list[int], tmp_path: Path) -> None:
    run = simulate(scenario)
    assert isinstance(run.signals, Spool)
    assert not run.signals.in_memory
    assert len(run.summary["detections"]) == 1
    _assert_same(run, at_once)
    for name, which in (("blocks", run), ("once", at_once)):
        which.save(tmp_path / name, pictures=False, report=False)
    for name in ("scenario.yaml", "telemetry.csv", "history.npz", "filter_state.json"):
        assert (tmp_path / "blocks" / name).read_bytes() == (tmp_path / "once" / name).read_bytes(), name


def test_a_run_holds_no_more_rows_the_longer_it_is(scenario: Scenario, few_rows: list[int]) -> None:
    chunk = 7  # rows in half a second
    for duration_s in (4, 8):
        few_rows.clear()
        simulate(scenario.model_copy(update={"duration_s": float(duration_s)}))
        assert len(few_rows) == duration_s // 2
        assert max(few_rows[:-1]) < 20 + chunk
        assert 20 <= few_rows[-1] < 40 + chunk


def test_a_watched_run_is_the_same(scenario: Scenario, at_once: Run, few_rows: list[int]) -> None:
    seen: list[float] = []
    run = simulate(scenario, watch=lambda moment: seen.append(moment.time_s))
    assert set(few_rows[:-1]) == {20}
    assert len(seen) == 150
    _assert_same(run, at_once)
    assert len(run.summary["identifiability"]) == 10  # which a look back on the run tells
    assert simulate(scenario, look_back=False).summary["identifiability"] == []


# -------------------------------------------------------------------------------------- the plain loop


def test_logs_may_be_emptied_at_any_row() -> None:
    noise = "sensors.errors=[{sensor: gyro, noise_std: 2.0e-6}, {sensor: acc2, delay_samples: 1}]"
    case = load_scenario("sample_maneuver", ["duration_s=22", "execution.engine=loop", noise])
    whole, parts = Loop(case), Loop(case)
    whole.advance(22.0)
    pieces = []
    for reached_s in (0.0, 10.0, 20.41, 20.49, 22.0):  # row 255 is the last of a block, 256 the next one's first
        parts.advance(reached_s)
        assert 0.0 <= reached_s - parts.snapshot().time_s < 0.08
        pieces.append(parts.take_logs())
        assert parts.logged == 0
    assert whole.logged == 276
    for name, values in whole.take_logs().items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), values, err_msg=name)


def test_a_watcher_sees_the_same() -> None:
    seen: dict[str, list[object]] = {}
    for engine in ("diagram", "loop"):
        moments = seen.setdefault(engine, [])
        case = load_scenario("stuck_on_29", ["duration_s=1", f"execution.engine={engine}"])
        simulate(case, watch=lambda moment, moments=moments: moments.append(list(moment)))  # type: ignore[misc]
    assert len(seen["loop"]) == 12
    for one, other in zip(seen["diagram"], seen["loop"], strict=True):
        for left, right in zip(one, other, strict=True):  # type: ignore[call-overload]
            np.testing.assert_array_equal(left, right)
