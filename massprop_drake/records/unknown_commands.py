"""Stretches of a record in which commands are not known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array

_MOST = 100  # stretches that are kept


class UnknownCommands:
    """Collection of stretches with unknown commands, block by block.

    Attributes:
        count: number of stretches.
        samples: number of samples that are in one.
        until_s: end of the record.
    """

    def __init__(self, vehicle: Vehicle):
        self._vehicle, self._stretches = vehicle, list[dict[str, Any]]()
        self._within = False  # whether the last sample is in one
        self.count, self.samples, self.until_s = 0, 0, -math.inf

    def add(self, time_s: Array, unknown: NDArray[np.bool_], recorded: NDArray[np.bool_]) -> None:
        """Notes the samples with unknown commands.

        Args:
            time_s: their ends, s, shape (n,).
            unknown: whose command is not known, shape (n, n_jets).
            recorded: rows that there are, shape (n,).
        """
        self.until_s = float(time_s[-1]) if time_s.size else self.until_s
        some = unknown.any(axis=1) & recorded
        within = np.append(self._within, some)
        self._within = bool(within[-1])
        for row in np.flatnonzero(some).tolist():
            self._note(float(time_s[row]), np.flatnonzero(unknown[row]), begins=not within[row])

    def _note(self, time_s: float, jets: NDArray[np.int_], *, begins: bool) -> None:
        self.samples += 1
        names = [self._vehicle.designations[jet] for jet in jets.tolist()]
        if begins:
            self.count += 1
            if self.count <= _MOST:
                from_s = time_s - self._vehicle.sample_period_s
                self._stretches.append({"jets": names, "from_s": from_s, "to_s": time_s, "samples": 0})
        if self.count <= _MOST:
            last = self._stretches[-1]
            more = [name for name in names if name not in last["jets"]]
            last.update(jets=[*last["jets"], *more], to_s=time_s, samples=last["samples"] + 1)

    def found(self) -> list[dict[str, Any]]:
        """Returns the first stretches: jets, from when to when, s, and number of samples."""
        return self._stretches
