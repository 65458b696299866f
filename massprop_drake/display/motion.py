"""How a vehicle turns and what its jets do, as far as a run tells: the truth, a reading, or an estimate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.style import LEAKS, SHOWN
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


def plumes(level: Array, asked: NDArray[np.bool_], fails: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """Which jets have which plume: thrust as it should be, of a failed jet untold, and none where one was asked for.

    Args:
        level: thrust over full thrust, of any shape.
        asked: whether the jet is commanded.
        fails: whether it truly fails; such a jet is shown to fire if it only leaks.
    """
    given = level > SHOWN
    return {
        "given": given & (asked | ~fails),
        "untold": (level > LEAKS) & ~asked & fails,
        "withheld": asked & ~given & fails,
    }
