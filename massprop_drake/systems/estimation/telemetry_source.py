"""Playback of recorded telemetry."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.systems.caching import declare_output


class ServedRows(NamedTuple):
    """Rows that a source serves, and the row before them, whose command and outside wrench alone are used.

    Never changed; other rows are another one.

    Attributes:
        first: number of the first row that is served; each array begins with the row before it.
        time_s: in the record, s, shape (n + 1,).
        readings: by sensor, shape (n + 1, its size).
        commands: of the interval that starts at each row, shape (n + 1, n_jets).
        outside_wrench: of that interval, shape (n + 1, 6).
        onsets_s: of the commands, see `maths.vehicle.on_times`, NaN: levels, shape (n + 1, n_jets).
    """

    first: int
    time_s: Array
    readings: Mapping[str, Array]
    commands: Array
    outside_wrench: Array
    onsets_s: Array

    @property
    def next(self) -> int:
        """Number in the record of the row after the last one."""
        return self.first + self.time_s.size - 1

    def __deepcopy__(self, _memo: Any) -> ServedRows:
        """Returns itself: a clone of a context shares what is never changed."""
        return self


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
        held_command_onset (out, n_jets), command_onset (out, n_jets), where jets open within a sample: how long after
            the beginning of its interval each jet opens, s, for the command of row k - 1 and of row k.

    State: none. Row k is a pure function of k, k = round(t/T): what is served at a time never changes, though a
    context holds some rows alone.

    Parameters: abstract, `ServedRows`: the rows of a context, at first none. Whoever runs the diagram moves them on
    with `extend` before the simulator gets there, and runs a little beyond the last row, which is used up then:

        source = diagram.GetSubsystemByName("telemetry_source")
        last = source.extend(source.GetMyMutableContextFromRoot(root), time_s, readings, commands, None)
        simulator.AdvanceTo((last + 0.25) * period_s)

    Timing: at t_k the readings are those of row k, and the command that of the interval that ended, so
    that what follows sees what it saw when the record was made. Before the first row all jets are off,
    as in `JetSchedule`, unless `begin` says otherwise.

    Args:
        sensors: names of the packages.
        n_jets: number of jets.
        period_s: sample period T, s.
        first_row: number of the record's first row.
        tracked: sensors in a fixed frame, and sizes of their readings; None: there are none.
        within: whether jets open within a sample.
    """

    def __init__(
        self,
        sensors: Sequence[str],
        *,
        n_jets: int,
        period_s: float,
        first_row: int = 0,
        tracked: Mapping[str, int] | None = None,
        within: bool = False,
    ):
        super().__init__()
        self.set_name("telemetry_source")
        self._period_s = period_s
        sizes = dict.fromkeys(sensors, 3) | dict(tracked or {})
        before = {name: np.full((1, size), np.nan) for name, size in sizes.items()}
        off, levels = np.zeros((1, n_jets)), level_onsets((1, n_jets))
        none = ServedRows(first_row, np.full(1, np.nan), before, off, np.zeros((1, 6)), levels)
        self._rows = self.DeclareAbstractParameter(Value[object](none))
        for name, size in sizes.items():
            self._declare(name, size, lambda rows, k, name=name: rows.readings[name][k])  # type: ignore[misc]
        self._declare("jet_commands", n_jets, lambda rows, k: rows.commands[k - 1])
        self._declare("command", n_jets, lambda rows, k: rows.commands[k])
        self._declare("outside_wrench", 6, lambda rows, k: rows.outside_wrench[k - 1])
        self._declare("record_time", 1, lambda rows, k: rows.time_s[k : k + 1])
        if within:
            self._declare("held_command_onset", n_jets, lambda rows, k: rows.onsets_s[k - 1])
            self._declare("command_onset", n_jets, lambda rows, k: rows.onsets_s[k])

    def _declare(self, name: str, size: int, select: Callable[[ServedRows, int], Array]) -> None:
        """Declares an output port that serves part of the row at the context's time."""
        read = {self.time_ticket(), self.pa_ticket()}
        declare_output(self, name, size, lambda context: select(*self._find_row(context)), read)

    def _read_rows(self, context: Any) -> ServedRows:
        """Returns the record's rows that a context holds."""
        rows: ServedRows = context.get_abstract_parameter(self._rows).get_value()
        return rows

    def _write_rows(self, context: Any, rows: ServedRows) -> None:
        """Stores rows of the record in a context, read-only."""
        for array in (rows.time_s, *rows.readings.values(), rows.commands, rows.outside_wrench, rows.onsets_s):
            array.flags.writeable = False
        context.get_mutable_abstract_parameter(self._rows).set_value(rows)

    def begin(self, context: Any, command: Array, outside_wrench: Array, onset_s: Array | None = None) -> None:
        """Sets command, onsets and outside wrench of the interval before the first row; call it before `extend`.

        Args:
            context: of the source.
            command: shape (n_jets,).
            outside_wrench: shape (6,).
            onset_s: of the command, shape (n_jets,); None: it is a level.
        """
        onset = level_onsets(np.shape(command)) if onset_s is None else onset_s
        commands, outside, onsets_s = (np.array([part]) for part in (command, outside_wrench, onset))
        rows = self._read_rows(context)
        self._write_rows(context, rows._replace(commands=commands, outside_wrench=outside, onsets_s=onsets_s))

    def extend(
        self,
        context: Any,
        time_s: Array,
        readings: Mapping[str, Array],
        commands: Array,
        outside_wrench: Array | None,
        onsets_s: Array | None = None,
    ) -> int:
        """Stores the next rows of a record in a context, in place of earlier ones; returns the last row's number.

        Args:
            context: of the source.
            time_s: in the record, s, shape (n,).
            readings: by sensor, shape (n, its size).
            commands: of the interval that starts at each row, shape (n, n_jets).
            outside_wrench: of that interval, shape (n, 6); None: zero.
            onsets_s: of the commands, shape (n, n_jets); None: these are levels.
        """
        earlier = self._read_rows(context)
        if outside_wrench is None:
            outside_wrench = np.zeros((time_s.size, 6))
        if onsets_s is None:
            onsets_s = level_onsets(commands.shape)
        rows = ServedRows(
            earlier.next,
            np.concatenate([earlier.time_s[-1:], time_s]),
            {name: np.vstack([values[-1:], readings[name]]) for name, values in earlier.readings.items()},
            np.vstack([earlier.commands[-1:], commands]),
            np.vstack([earlier.outside_wrench[-1:], outside_wrench]),
            np.vstack([earlier.onsets_s[-1:], onsets_s]),
        )
        self._write_rows(context, rows)
        return rows.next - 1

    def _find_row(self, context: Any) -> tuple[ServedRows, int]:
        """Returns the rows in a context, and the index in their arrays of the row to serve at its time."""
        rows, row = self._read_rows(context), round(context.get_time() / self._period_s)
        if not rows.first <= row < rows.next:
            raise IndexError(
                f"telemetry_source: row {row} is not in the window of rows {rows.first} to {rows.next - 1}"
            )
        return rows, row - rows.first + 1
