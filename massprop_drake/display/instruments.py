"""Instruments of the replay and of the live view: rates, the consistency of the filter, the sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import motion
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_sensors import SensorPackage

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

Array = NDArray[np.float64]

NIS_WINDOW = 10  # samples used that the light of the filter looks back on
# 95 and 99.9 % of chi-square with 3 degrees of freedom for each of them, over their number
NIS_LIMITS = (4.3773, 5.9703)
APART_LIMITS = (4.0, 6.0)  # 1-sigma


def columns(run: RunContent) -> dict[str, Array]:
    """Returns the instrument readings at every sample, shape (n, 1) or (n, 3) each, by name; NaN: shows nothing.

    Returns:
        `rate`: true or else as read, deg/s; `nis`: of the rotation filter at the samples that it used;
        ``apart``: see `package_deviation`.
    """
    scenario = run.scenario
    rate = motion.rate(scenario, run.signals)
    used = np.asarray(run["rotation_used"]) > 0.0
    return {
        "rate": np.degrees(rate),
        "nis": np.where(used, np.asarray(run["rotation_nis"]), np.nan),
        "apart": package_deviation(scenario, np.asarray(run.time_s), run.signals)[:, None],
    }


def limits(scenario: Scenario) -> dict[str, object]:
    """Returns limits by instrument at which its light turns doubtful and bad; None where it does not apply."""
    vehicle = scenario.vehicle_data
    several = max(len(vehicle.gyros), len(vehicle.accelerometers)) > 1
    return {"nis": NIS_LIMITS, "nis_window": NIS_WINDOW, "apart": APART_LIMITS if several else None}


def package_deviation(scenario: Scenario, time_s: Array, signals: Mapping[str, Array]) -> Array:
    """Computes the largest deviation of sensor packages from the median of their kind, in 1-sigma, shape (n,).

    Compared are the changes of their readings over a sample; those of accelerometers with what their places make of
    the rotation, dw x r + w x (w x r) T.

    Args:
        scenario: for the packages.
        time_s: sample times, s, shape (n,).
        signals: readings by the names of the packages, shape (n, 3) each.
    """
    vehicle = scenario.vehicle_data
    period = vehicle.sample_period_s
    worst = np.full(time_s.size, np.nan)
    if time_s.size < 2 or not vehicle.gyros:
        return worst
    rate = motion.onboard_rate(scenario, signals)
    gyros = [np.diff(np.asarray(signals[gyro.name]), axis=0) for gyro in vehicle.gyros]
    middle, turned = 0.5 * (rate[1:] + rate[:-1]), np.diff(rate, axis=0)
    velocities = []
    for package in vehicle.accelerometers:
        arm = np.array(package.position)
        by_place = np.cross(turned, arm) + period * np.cross(middle, np.cross(middle, arm))
        velocities.append(np.diff(np.asarray(signals[package.name]), axis=0) - by_place)
    sizes = [_median_deviation(gyros, vehicle.gyros), _median_deviation(velocities, vehicle.accelerometers)]
    adjacent = np.diff(time_s) < 1.5 * period
    worst[1:] = np.where(adjacent, np.fmax(*sizes), np.nan)
    return worst


def _median_deviation(changes: Sequence[Array], packages: Sequence[SensorPackage]) -> Array:
    """Computes the largest deviation from the packages' median over axes, in 1-sigma, (n,); NaN for one package."""
    if len(packages) < 2:
        return np.full(changes[0].shape[0] if changes else 1, np.nan)
    sigmas = np.sqrt([2.0 * package.variance for package in packages])
    stacked = np.stack(changes)
    return np.asarray((np.abs(stacked - np.median(stacked, axis=0)) / sigmas[:, None, None]).max(axis=(0, 2)))
