"""How a vehicle turns and moves, as far as a run tells: the truth, what a gyro reads, or what a filter makes of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario

Array = NDArray[np.float64]


def rate(scenario: Scenario, signals: Mapping[str, Array]) -> Array:
    """Angular rate, rad/s, body axes, shape (n, 3): true, else as the gyro in use reads it, else as it is estimated.

    Args:
        scenario: as run.
        signals: of the run.
    """
    if "rate" in signals:
        return np.asarray(signals["rate"])
    return read(scenario, signals)


def read(scenario: Scenario, signals: Mapping[str, Array]) -> Array:
    """Angular rate as it is known aboard, rad/s, shape (n, 3): by the gyro in use, or where there is none estimated."""
    packages = params.gyros(scenario)
    return np.asarray(signals[packages[0].name if packages else "rate_estimate"])
