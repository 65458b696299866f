"""A package of three rate gyros."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.vehicle.rigid_body import RATE
from massprop_drake.systems.vehicle.sensor import Sensor


class RateGyro(Sensor):
    """Measures the angular rate, rad/s, body axes; ports, state and timing as `Sensor`.

    Assumptions and limitations: the package's axes are the body's; its position does not matter.
    """

    def _signal(self, body_state: NDArray[np.float64]) -> NDArray[np.float64]:
        return body_state[RATE]
