"""Motion of a vehicle and thrust of its jets, as far as a run tells: the truth, a reading, or an estimate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.style import LEAKS, SHOWN
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario

Array = NDArray[np.float64]


def rate(scenario: Scenario, signals: Mapping[str, Array]) -> Array:
    """Returns the angular rate, rad/s, body axes, shape (n, 3): true, or as the gyro in use reads it, or estimated.

    Args:
        scenario: as run.
        signals: of the run.
    """
    if "rate" in signals:
        return np.asarray(signals["rate"])
    return onboard_rate(scenario, signals)


def onboard_rate(scenario: Scenario, signals: Mapping[str, Array]) -> Array:
    """Returns the angular rate known on board, rad/s, shape (n, 3): the reading of the gyro in use, or the estimate."""
    packages = params.gyros(scenario)
    return np.asarray(signals[packages[0].name if packages else "rate_estimate"])


def classify_plumes(
    level: Array, commanded: NDArray[np.bool_], failing: NDArray[np.bool_]
) -> dict[str, NDArray[np.bool_]]:
    """Returns masks by kind of plume: given (regular), untold (uncommanded, failed jet), withheld (missing).

    Args:
        level: thrust over full thrust, of any shape.
        commanded: whether the jet is commanded.
        failing: whether it truly fails; then it is shown to fire even if it only leaks.
    """
    fires = level > SHOWN
    return {
        "given": fires & (commanded | ~failing),
        "untold": (level > LEAKS) & ~commanded & failing,
        "withheld": commanded & ~fires & failing,
    }
