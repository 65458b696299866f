"""Checks of a telemetry file, with a vehicle or by its structure alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.errors import InputError
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records.completeness import Loss, completeness
from massprop_drake.records.reader import EXACT, JITTER, ROUNDING, Reader, suggest_column
from massprop_drake.records.tables import open_table


def check(path: Path, vehicle: Vehicle | None = None, gyro: str | None = None) -> dict[str, Any]:
    """Reads a whole record and returns its rows, times, gaps and faults by name, without estimating.

    Args:
        path: of a CSV or Parquet file.
        vehicle: whose columns and period it must have; None: only that it is a table of numbers in
            time order.
        gyro: the package that must be there; default the vehicle's first.

    Returns:
        rows, first_s, last_s, period_s, gaps, jitter, late (rows left out because time did not go on),
        unknown columns, absent packages, notes (what may be meant otherwise, a sentence each), completeness,
        completeness_detail (what could not be read, a sentence each).

    Raises:
        InputError: when the record cannot be used.
    """
    if vehicle is None:
        return _check_structure(path)
    reader = Reader(path, vehicle, gyro=gyro or next((package.name for package in vehicle.gyros), None))
    for _ in reader:
        pass
    record = reader.record
    return {
        **{name: getattr(record, name) for name in ("rows", "first_s", "last_s", "period_s", "gaps", "jitter")},
        "late": record.duplicates + record.backward,
        "unknown": list(record.unknown),
        **{name: getattr(record, name) for name in ("absent", "notes")},
        **_completeness_keys(reader.losses),
    }


def _completeness_keys(losses: Sequence[Loss]) -> dict[str, Any]:
    """Returns completeness and losses of a record as keys of a check's result."""
    return {"completeness": completeness(losses), "completeness_detail": [one.text for one in losses]}


def _check_structure(path: Path) -> dict[str, Any]:
    """Returns rows, sample period, gaps, jitter and losses of a record by name, without a vehicle."""
    table = open_table(path)
    try:
        if "time_s" not in table.header:
            hint = suggest_column("time_s", table.header)
            raise InputError(f"{path}: no column time_s{hint}; telemetry has the time of each row, in seconds")
        time = table.header.index("time_s")
        columns = [time, *(index for index, name in enumerate(table.header) if name and index != time)]
        parts = [block.values[:, 0] for block in table.blocks(columns)]
    finally:
        table.close()
    times = np.concatenate([np.empty(0), *parts])
    times = times[np.isfinite(times)]
    if not times.size:
        raise InputError(f"{path}: has no usable row; expected a row per sample")
    steps = np.diff(times)
    forward = steps[steps > 0.0]
    period = float(np.median(forward)) if forward.size else None
    off = np.abs(forward - (period or 0.0))
    gaps = off > JITTER * (period or 0.0) * (1.0 + ROUNDING)
    return {
        "rows": int(times.size),
        "first_s": float(times[0]),
        "last_s": float(times[-1]),
        "period_s": period,
        "gaps": int(gaps.sum()),
        "jitter": int((off[~gaps] > EXACT * (period or 0.0)).sum()),
        "late": int((steps <= 0.0).sum()),
        **{name: [] for name in ("unknown", "absent", "notes")},
        **_completeness_keys(table.losses),
    }
