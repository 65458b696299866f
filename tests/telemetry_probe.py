"""A small vehicle's telemetry, made without simulating: a row per sample, and its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records.rows import telemetry_columns

PERIOD_S = 0.1  # of the toy vehicle


def toy_vehicle(data: dict[str, Any], **changes: Any) -> Vehicle:
    """The toy vehicle with some fields replaced."""
    return validate_data(Vehicle, {**data, **changes})


class Log:
    """Rows of text by column name, to be spoilt and written.

    The readings are those of the nominal vehicle but for quantization: jets fire for six samples, then rest
    for three, one after the other.
    """

    def __init__(self, vehicle: Vehicle, n_rows: int = 60, start_s: float = 0.0):
        self.header = telemetry_columns(vehicle)
        period = vehicle.sample_period_s
        n_jets = len(vehicle.jets)
        commands = np.zeros((n_rows, n_jets))
        for row in range(n_rows):
            if row % 9 < 6:
                commands[row, (row // 9) % n_jets] = 1.0
        impulses = commands @ vehicle.wrenches * period
        center = vehicle.nominal.center_of_mass
        turn = (impulses[:, :3] - np.cross(center, impulses[:, 3:])) @ np.linalg.inv(vehicle.nominal.inertia)
        readings = []
        for sensor in vehicle.sensors:
            steps = turn
            if sensor not in vehicle.gyros:
                steps = impulses[:, 3:] / vehicle.nominal.mass + np.cross(turn, np.array(sensor.position) - center)
            values = np.cumsum(np.vstack([np.zeros(3), steps]), axis=0)[:n_rows]
            readings.append(np.round(values / sensor.quantum) * sensor.quantum)
        times = start_s + period * np.arange(n_rows)
        table = np.column_stack([times, *readings, commands])
        self.rows = [[repr(value) for value in row] for row in table.tolist()]

    def column(self, name: str) -> int:
        return self.header.index(name)

    def set(self, row: int, name: str, text: str) -> None:
        self.rows[row][self.column(name)] = text

    def add(self, name: str, texts: list[str]) -> None:
        self.header.append(name)
        for row, text in zip(self.rows, texts, strict=True):
            row.append(text)

    def drop(self, name: str) -> None:
        column = self.column(name)
        del self.header[column]
        for row in self.rows:
            del row[column]

    def text(self) -> str:
        return "".join(",".join(row) + "\n" for row in [self.header, *self.rows])

    def write(self, path: Path) -> Path:
        path.write_text(self.text(), encoding="utf-8")
        return path
