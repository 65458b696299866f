"""Jet commands prescribed beforehand, for open-loop runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.systems.caching import declare_output


class JetSchedule(LeafSystem):
    """Plays back a table of jet commands, a row per sample.

    Ports:
        command (out, n_jets): fraction commanded over the coming sample, 0 to 1; zero after the table.
        held_command (out, n_jets): the command of the last sample. No feedthrough.
        command_onset (out, n_jets), held_command_onset (out, n_jets), where onsets are given: how long after the
            beginning of the coming and of the last sample each jet opens, s, see `maths.vehicle.on_times`.

    State: held_command (n_jets), then held_command_onset (n_jets) where onsets are given.

    Timing: as `JetSelection`: `command` at t_k acts on [t_k, t_k+1).

    Args:
        commands: row k acts on [k T, (k + 1) T), shape (n_samples, n_jets).
        period_s: sample period T, s.
        onsets_s: of each, in the same shape; None: commands are levels.

    Raises:
        ValueError: when commands are no table of numbers from 0 to 1, onsets none like it, or a period not above 0.
    """

    def __init__(self, commands: Array, *, period_s: float, onsets_s: Array | None = None):
        super().__init__()
        self.set_name("jet_schedule")
        self._commands = np.array(commands, dtype=float)
        if self._commands.ndim != 2:
            raise ValueError(
                f"jet schedule: commands must be a table, a row per sample and a column per jet, got shape "
                f"{self._commands.shape}"
            )
        if not ((self._commands >= 0.0) & (self._commands <= 1.0)).all():
            raise ValueError("jet schedule: each command must be from 0 to 1, the fraction of a sample that it lasts")
        self._onsets_s = None if onsets_s is None else np.array(onsets_s, dtype=float)
        if self._onsets_s is not None and self._onsets_s.shape != self._commands.shape:
            raise ValueError(
                f"jet schedule: onsets must be a table like that of commands, {self._commands.shape}, got shape "
                f"{self._onsets_s.shape}"
            )
        n_jets, self._held = self._commands.shape[1], list[Any]()
        tables = [("command", self._commands, np.zeros(n_jets))]
        if self._onsets_s is not None:
            tables.append(("command_onset", self._onsets_s, level_onsets(n_jets)))
        for name, table, fallback in tables:
            row = make_row_reader(table, period_s, fallback)
            self._held.append((self.DeclareDiscreteState(fallback), row))
            declare_output(self, name, n_jets, row, {self.time_ticket()})
            self.DeclareStateOutputPort(f"held_{name}", self._held[-1][0])
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _update(self, context: Any, state: Any) -> None:
        """Stores commands, and onsets where given, of the sample that begins, as held ones."""
        for group, row in self._held:
            state.set_value(group, row(context))


def make_row_reader(table: Array, period_s: float, fallback: Array) -> Callable[[Any], Array]:
    """Makes a function from a context to the table's row at its time, or `fallback` after its last row."""
    if not period_s > 0.0:
        raise ValueError(f"period_s: must be above zero, got {period_s:g}")

    def read_row(context: Any) -> Array:
        """Returns the table's row at a context's time, or the fallback row."""
        sample = round(context.get_time() / period_s)
        values: Array = table[sample] if sample < len(table) else fallback
        return values

    return read_row
