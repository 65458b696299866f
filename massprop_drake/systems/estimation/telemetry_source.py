"""Plays back recorded telemetry."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

Array = NDArray[np.float64]


class TelemetrySource(LeafSystem):
    """Serves the rows of a record, one per sample period, whatever times the rows have.

    Ports:
        <sensor> (out, 3), one per package, or (out, its size), one per sensor in a fixed frame: reading of row k, NaN
            where missing.
        jet_commands (out, n_jets): fraction commanded over the interval that ends now, the command of row
            k - 1, NaN where it is not known.
        command (out, n_jets): of row k.
        outside_wrench (out, 6): known outside torque about the vehicle origin (3), lbf-ft or N-m, and force
            (3), lbf or N, body axes, mean over the interval that ends now.
        record_time (out, 1): time of row k in the record, s.

    State: none. Row k is a pure function of k, k = round(t/T): what is served at a time never changes,
    though only a window of the rows is kept, which the caller moves on with `extend` before the
    simulator gets there.

    Timing: at t_k the readings are those of row k, and the command that of the interval that ended, so
    that what follows sees what it saw when the record was made. Before the first row all jets are off,
    as in `JetSchedule`, unless `before` says otherwise.

    Args:
        sensors: names of the packages.
        n_jets: number of jets.
        period_s: sample period T, s.
        first_row: number of the record's first row.
        tracked: sensors in a fixed frame, and sizes of their readings; None: there are none.
    """

    def __init__(
        self,
        sensors: Sequence[str],
        *,
        n_jets: int,
        period_s: float,
        first_row: int = 0,
        tracked: Mapping[str, int] | None = None,
    ):
        super().__init__()
        self.set_name("telemetry_source")
        self._period_s = period_s
        # the window: rows first - 1 (its command alone is known) to the last
        self._first = self._next = first_row
        self._time_s = np.full(1, np.nan)
        sizes = dict.fromkeys(sensors, 3) | dict(tracked or {})
        self._readings = {name: np.full((1, size), np.nan) for name, size in sizes.items()}
        self._commands = np.zeros((1, n_jets))
        self._wrench = np.zeros((1, 6))
        for name, size in sizes.items():
            self._declare(name, size, lambda row, name=name: self._readings[name][row])  # type: ignore[misc]
        self._declare("jet_commands", n_jets, lambda row: self._held(row - 1))
        self._declare("command", n_jets, lambda row: self._commands[row])
        self._declare("outside_wrench", 6, lambda row: self._wrench[row - 1])
        self._declare("record_time", 1, lambda row: self._time_s[row : row + 1])

    def _declare(self, name: str, size: int, served: Callable[[int], Array]) -> None:
        def calc(context: Any, output: Any) -> None:
            output.SetFromVector(served(self._place(context)))

        self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self.time_ticket()})

    def _held(self, row: int) -> Array:
        return self._commands[row]

    def begin(self, command: Array, outside_wrench: Array) -> None:
        """Sets what the row before the first one commanded; before any row has been given.

        Args:
            command: shape (n_jets,).
            outside_wrench: shape (6,).
        """
        self._commands[-1], self._wrench[-1] = command, outside_wrench

    def extend(
        self, time_s: Array, readings: Mapping[str, Array], commands: Array, outside_wrench: Array | None
    ) -> int:
        """Adds rows, and drops those before them but for the last.

        Args:
            time_s: in the record, s, shape (n,).
            readings: by sensor, shape (n, its size).
            commands: of the interval that starts at each row, shape (n, n_jets).
            outside_wrench: of that interval, shape (n, 6); None: zero.

        Returns:
            The number of the last row.
        """
        if outside_wrench is None:
            outside_wrench = np.zeros((time_s.size, 6))
        self._time_s = np.concatenate([self._time_s[-1:], time_s])
        self._readings = {name: np.vstack([kept[-1:], readings[name]]) for name, kept in self._readings.items()}
        self._commands = np.vstack([self._commands[-1:], commands])
        self._wrench = np.vstack([self._wrench[-1:], outside_wrench])
        self._first, self._next = self._next, self._next + time_s.size
        return self._next - 1

    def _place(self, context: Any) -> int:
        row = round(context.get_time() / self._period_s)
        if not self._first <= row < self._next:
            raise IndexError(
                f"telemetry_source: row {row} is not in the window of rows {self._first} to {self._next - 1}"
            )
        return row - self._first + 1
