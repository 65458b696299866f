"""Settings of filters and detector with everything off, from which a test changes what it is about."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from massprop_drake.maths import mass_filter, redundancy, rotation_filter
from massprop_drake.maths.detection import DetectorSettings
from massprop_drake.maths.mass_filter import MassSettings
from massprop_drake.maths.rotation_filter import RotationSettings
from massprop_drake.scenario import load_scenario
from massprop_drake.settings import detector_settings

PERIOD_S = 0.08


def rotation_settings(**changes: Any) -> RotationSettings:
    """The second-order filter with one exact gyro, coupling ignored, no jump test and no process noise."""
    plain = RotationSettings(
        period_s=PERIOD_S,
        gyro_variances=np.zeros(1),
        rule=redundancy.SINGLE,
        second_order=True,
        coupling=rotation_filter.IGNORE,
        coupling_limit=50.0,
        jump_threshold=np.inf,
        jump_covariance=np.zeros((9, 9)),
        process_noise=np.zeros((9, 9)),
        disturbance_covariance=np.zeros((3, 3)),
    )
    return plain._replace(**changes)


def mass_settings(**changes: Any) -> MassSettings:
    """The mass filter with one exact accelerometer at the origin, no compensation and no jump test."""
    plain = MassSettings(
        period_s=PERIOD_S,
        positions=np.zeros((1, 3)),
        variances=np.zeros(1),
        rule=redundancy.SINGLE,
        correlated=False,
        compensation=mass_filter.NO_COMPENSATION,
        compensation_covariance=False,
        process_noise=0.0,
        jump_variance=0.0,
        jump_threshold=np.inf,
        jump_window=1,
        disturbance_covariance=np.zeros((3, 3)),
    )
    return plain._replace(**changes)


@cache
def detector_settings_of(*overrides: str) -> DetectorSettings:
    """The detector of a bundled scenario, with overrides."""
    return detector_settings(load_scenario("stuck_on_29", list(overrides)))
