"""Channels of a record after its map: values in SI units and body axes, with their times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.signals import AXES
from massprop_drake.records.topics import Recording

Places = NDArray[np.int64]
HOLE = 2.5  # intervals, in medians of them: a longer one is a hole in the data
TOLERANCE = 1e-6  # of a commanded fraction
SAME_S = 1e-9  # stamps closer than this are of one time
# components of a channel's values, by kind
COMPONENTS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("gyro", "accelerometer", "velocity"), AXES),
    "attitude": ("q_w", "q_x", "q_y", "q_z"),
    "pose": (*AXES, "q_w", "q_x", "q_y", "q_z"),
    "wheel": ("speed",),
    "engine": ("level", "gimbal_1", "gimbal_2"),
}


class Channel(NamedTuple):
    """Measurements of one sensor of a map.

    Attributes:
        name: of the sensor.
        kind: "gyro", "accelerometer", "velocity", "attitude", "pose", "wheel" or "engine".
        time_s: of each sample, in the clock of the rows, strictly increasing, shape (n,).
        values: as COMPONENTS names them, in the vehicle's units and axes, NaN where missing, shape (n, m): rates,
            rad/s; accelerations or their integrals as `gives` says; velocities; positions; attitudes as quaternions
            that turn body to world, scalar first; speeds of wheels, rad/s; of engines the level and, with a gimbal, its
            angles, rad.
        places: row of each sample in its topic, shape (n,).
        gives: of an accelerometer "integral", "increment", "mean" or "instant"; else "".
    """

    name: str
    kind: str
    time_s: Array
    values: Array
    places: Places
    gives: str = ""

    @property
    def interval_s(self) -> float:
        """Median interval between samples of the channel, s; NaN with fewer than two."""
        return float(np.median(np.diff(self.time_s))) if self.time_s.size > 1 else math.nan


class HeldValues(NamedTuple):
    """Values that each hold for a while: commands, or a known outside wrench.

    Attributes:
        begin_s, end_s: of each, s, shape (n,).
        values: NaN where unknown, shape (n, m).
    """

    begin_s: Array
    end_s: Array
    values: Array


@dataclass(frozen=True)
class Mapped:
    """Record as a map understands it.

    Attributes:
        recording: what was read.
        by: the map.
        source: the map's name in messages.
        vehicle: whose sensors and jets they are.
        channels: by the sensor's name.
        commands: of the jets, fractions of 0 to 1, shape (n, n_jets).
        known_force, known_torque: known outside force and torque, in the vehicle's units; None: none.
        notes: what is doubtful, a sentence each.
        information: what is to be known besides, likewise.
    """

    recording: Recording
    by: RecordMap
    source: str
    vehicle: Vehicle
    channels: Mapping[str, Channel]
    commands: HeldValues
    known_force: HeldValues | None
    known_torque: HeldValues | None
    notes: tuple[str, ...]
    information: tuple[str, ...]

    @property
    def rows(self) -> Channel:
        """Channel of the sensor whose samples become the rows of telemetry."""
        return self.channels[self.by.row_sensor]
