"""A live view of a simulation in three dimensions, served on this machine only."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.stage import Stage
from massprop_drake.display.style import SHOWN
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.mass_properties import CENTER_OF_MASS

if TYPE_CHECKING:
    from massprop_drake.runners.moment import Moment

Array = NDArray[np.float64]


class Live:
    """Shows a simulation while it runs; pass it to `simulate` as `watch`.

    Args:
        scenario: the one to be simulated.
        speed: how many times faster than real time; infinity: as fast as it is computed.
    """

    def __init__(self, scenario: Scenario, speed: float = 1.0):
        self._vehicle = scenario.vehicle_data
        self._stage = Stage(self._vehicle, truth=True)
        self._speed = speed
        self._full = np.linalg.norm(self._vehicle.thrusts, axis=1)
        n_jets = len(self._vehicle.jets)
        self._firing = np.zeros(n_jets, dtype=bool)
        self._out = np.zeros(n_jets, dtype=bool)
        self._marks = [self._stage.add_mark("found", jet) for jet in range(n_jets)]
        self._began: float | None = None

    @property
    def address(self) -> str:
        """The URL of the view, for a browser on this machine."""
        return str(self._stage.meshcat.web_url())

    def __call__(self, moment: Moment) -> None:
        """Waits until a moment is due, then shows it."""
        if self._began is None:
            self._began = time.monotonic()
        ahead_s = moment.time_s / self._speed - (time.monotonic() - self._began)
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        self._stage.turn(moment.attitude)
        self._stage.center(moment.center_of_mass)
        self._stage.estimate(moment.estimate[CENTER_OF_MASS], moment.standard_deviation[CENTER_OF_MASS])
        firing = moment.thrust / self._full > SHOWN
        for jet in np.flatnonzero(firing != self._firing):
            self._stage.plume(int(jet), bool(firing[jet]))
        for jet in np.flatnonzero(moment.removed != self._out):
            self._stage.show(self._marks[jet], bool(moment.removed[jet]))
        self._firing, self._out = firing, moment.removed
