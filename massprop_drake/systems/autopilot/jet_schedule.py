"""Jet commands prescribed beforehand, for open-loop runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.on_times import levels_alone

Array = NDArray[np.float64]


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
        ValueError: when commands are no table of numbers from 0 to 1, or onsets no table like it.
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
        self._period_s = period_s
        n_jets = self._commands.shape[1]
        self._held = self.DeclareDiscreteState(n_jets)
        self.DeclareVectorOutputPort("command", n_jets, self._calc_command, prerequisites_of_calc={self.time_ticket()})
        self.DeclareStateOutputPort("held_command", self._held)
        if self._onsets_s is not None:
            self._held_onset = self.DeclareDiscreteState(levels_alone(n_jets))
            told = {self.time_ticket()}
            self.DeclareVectorOutputPort("command_onset", n_jets, self._calc_onset, prerequisites_of_calc=told)
            self.DeclareStateOutputPort("held_command_onset", self._held_onset)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _row(self, table: Array, beyond: float, context: Any) -> Array:
        sample = round(context.get_time() / self._period_s)
        return table[sample] if sample < len(table) else np.full(table.shape[1], beyond)

    def _command(self, context: Any) -> Array:
        return self._row(self._commands, 0.0, context)

    def _onset(self, context: Any) -> Array:
        assert self._onsets_s is not None
        return self._row(self._onsets_s, np.nan, context)

    def _calc_onset(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._onset(context))

    def _calc_command(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._command(context))

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._held, self._command(context))
        if self._onsets_s is not None:
            state.set_value(self._held_onset, self._onset(context))
