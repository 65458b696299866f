"""Recorded telemetry: what a vehicle's sensors read and what its jets were told, a row per sample."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from massprop_drake.signals import AXES
from massprop_drake.vehicle import Vehicle

Array = NDArray[np.float64]


def columns(vehicle: Vehicle) -> list[str]:
    """Names of the columns in order: time, each sensor's three axes, each jet."""
    sensors = [f"{name}_{axis}" for name in vehicle.sensor_names() for axis in AXES]
    return ["time_s", *sensors, *(f"jet_{designation}" for designation in vehicle.designations)]


def write_csv(path: Path, vehicle: Vehicle, time_s: Array, readings: Mapping[str, Array], commands: Array) -> None:
    """Writes telemetry; every number reads back exactly, and NaN becomes an empty cell.

    Args:
        path: of the file.
        vehicle: whose packages and jets name the columns.
        time_s: sample times, s, shape (n,).
        readings: of each sensor package, shape (n, 3).
        commands: fraction commanded over the interval that starts at the row's time, shape (n, n_jets).
    """
    table = np.column_stack([time_s, *(readings[name] for name in vehicle.sensor_names()), commands])
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns(vehicle))
        writer.writerows([_cell(value) for value in row] for row in table.tolist())


def _cell(value: float) -> str:
    if math.isnan(value):  # not measured, or not commanded
        return ""
    return str(int(value)) if value in (0.0, 1.0) else repr(value)
