"""Settings of filters and detector with everything off, from which a test changes what it is about."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from massprop_drake.inputs.params import detector_params
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.maths.estimation.detector import Evidence
from massprop_drake.maths.estimation.detectors.cglr import CglrParams
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassParams
from massprop_drake.maths.estimation.filters.rotation_filter import RotationParams
from massprop_drake.maths.estimation.filters.thesis import joint_covariance
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.sensing import SensorModel

PERIOD_S = 0.08
PERFECT_SENSOR = SensorModel(
    period_s=PERIOD_S,
    scale_factor=np.zeros(3),
    smoothing=0.0,
    bias=np.zeros(3),
    walk_std=0.0,
    integrates=False,
    noise_std=0.0,
    quantum=0.0,
    phase=np.zeros(3),
    delay=0,
)


def rotation_params(**changes: Any) -> RotationParams:
    """The second-order filter with one exact gyro, coupling ignored, no jump test and no process noise."""
    plain = RotationParams(
        period_s=PERIOD_S,
        gyro_variances=np.zeros(1),
        rule=Rule.SINGLE,
        second_order=True,
        coupling=rotation_filter.RotationCoupling.IGNORE,
        coupling_limit=50.0,
        jump_threshold=np.inf,
        jump_covariance=np.zeros((9, 9)),
        process_noise=np.zeros((9, 9)),
        disturbance_covariance=np.zeros((3, 3)),
    )
    return plain._replace(**changes)


def mass_params(**changes: Any) -> MassParams:
    """The mass filter with one exact accelerometer at the origin, no compensation and no jump test."""
    plain = MassParams(
        period_s=PERIOD_S,
        positions=np.zeros((1, 3)),
        variances=np.zeros(1),
        rule=Rule.SINGLE,
        correlated=False,
        compensation=mass_filter.Compensation.NONE,
        compensation_covariance=False,
        process_noise=0.0,
        jump_variance=0.0,
        jump_threshold=np.inf,
        jump_window=1,
        disturbance_covariance=np.zeros((3, 3)),
    )
    return plain._replace(**changes)


@cache
def detector_settings_of(*overrides: str) -> CglrParams:
    """The detector of a bundled scenario, with overrides."""
    made: CglrParams = detector_params(load_scenario("stuck_on_29", list(overrides)))
    return made


def sure_evidence(time_s: float, innovation: Array, properties: Array, whole: Array, **changes: Any) -> Evidence:
    """Input of a detector from filters that coast and are sure of their estimates, but for the changes."""
    # a variance of zero would say that nothing was ever measured
    sure = (1e-9 * properties) ** 2
    given = {
        "command": np.zeros(44),
        "usable": True,
        "firing": False,
        "translation": innovation[:3],
        "rotation": innovation[3:],
        "translation_covariance": whole[:3, :3],
        "rotation_covariance": whole[3:, 3:],
        "shared_covariance": None,
        "state_covariance": np.diag(np.append(sure[:3], np.zeros(6))),
        "mass_estimate": np.array([properties[9], sure[9]]),
    } | changes
    covariance, shared = np.zeros((6, 6)), given["shared_covariance"]
    covariance[:3, :3], covariance[3:, 3:] = given["translation_covariance"], given["rotation_covariance"]
    if shared is not None:
        covariance[:3, 3:], covariance[3:, :3] = shared, shared.T
    return Evidence(
        time_s,
        *(given[name] for name in ("command", "usable", "firing")),
        np.concatenate([given["translation"], given["rotation"]]),
        covariance,
        shared is not None,
        np.append(properties[:9], given["mass_estimate"][0]),
        joint_covariance(given["state_covariance"], given["mass_estimate"][1]),
        np.zeros((6, 10)),
    )


# a body of moderate numbers: inertia of a few units, center of mass within a unit
INVERSE = np.linalg.inv(np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]))
STATE = np.array([*INVERSE.diagonal(), INVERSE[1, 2], INVERSE[0, 2], INVERSE[0, 1], 0.5, -0.3, 0.2])


def spd(rng: np.random.Generator, size: int) -> Array:
    """A covariance with nothing diagonal about it."""
    mixing = rng.normal(size=(size, size)) + 1.5 * np.eye(size)
    return mixing @ mixing.T / size


def crossing(vector: Array) -> Array:
    """The matrix [v x], by columns."""
    columns: Array = np.cross(vector, np.eye(3)).T
    return columns
