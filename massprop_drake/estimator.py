"""The estimators for real time: one call a cycle, no simulator, no file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from massprop_drake import settings as make
from massprop_drake.maths import mass_filter, rotation_filter
from massprop_drake.maths.impulses import interval_impulses
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import N_ROTATION, converged
from massprop_drake.maths.sensing import increment_noise
from massprop_drake.maths.thrust import lag_factors
from massprop_drake.scenario import Scenario
from massprop_drake.vehicle import Vehicle

Array = NDArray[np.float64]


class EstimatorStep(NamedTuple):
    """What is known after one cycle.

    Attributes:
        time_s: of the cycle, s.
        estimate: the ten parameters, see `maths.mass_properties`, shape (10,).
        standard_deviation: 1-sigma of each, shape (10,).
        converged: whether the estimates may be acted on.
        used: whether the rotation filter used the sample.
        mass_used: whether the mass filter used it.
        rotation_nis: of the rotation filter's innovation; NaN where not measured.
        mass_nis: of the mass filter's.
    """

    time_s: float
    estimate: Array
    standard_deviation: Array
    converged: bool
    used: bool
    mass_used: bool
    rotation_nis: float
    mass_nis: float


class Estimator:
    """Estimates mass properties from gyro, accelerometers and commands, cycle by cycle.

    The same mathematics as the `estimation` diagram, and the same answers. Call `step` once per sample
    period, in order of time; nothing it keeps grows.

    Args:
        vehicle: jets, sensors and nominal mass properties.
        settings: a scenario whose `sensors`, `estimation`, `rotation` and `mass` fields are used;
            default: all at their defaults.

    Raises:
        ValueError: when the settings are of another vehicle, or the vehicle has no accelerometer.
    """

    def __init__(self, vehicle: Vehicle, settings: Scenario | None = None):
        scenario = (settings or Scenario()).model_copy(update={"vehicle": vehicle})
        self._vehicle = vehicle
        accelerometer = make.accelerometer(scenario)
        if accelerometer is None:
            raise ValueError(f"vehicle '{vehicle.name}' has no accelerometer: its mass cannot be observed")
        self._gyro, self._accelerometer = make.gyro(scenario), accelerometer
        self._position = np.array(accelerometer.position)
        self._rotation, self._mass = make.rotation_settings(scenario), make.mass_settings(scenario)
        self._limits = make.convergence_limits(scenario)
        self._rate_noise = increment_noise(self._gyro.variance)
        self._velocity_noise = increment_noise(accelerometer.variance)
        self._impulse_per_level = vehicle.wrenches * vehicle.sample_period_s
        self._lag = lag_factors(make.estimator_time_constants(scenario), vehicle.sample_period_s)

        estimate, deviation = make.initial_estimate(scenario), make.initial_deviation(scenario)
        n_jets = len(vehicle.jets)
        self._estimate = estimate[:N_ROTATION]
        self._covariance = np.diag(deviation[:N_ROTATION] ** 2)
        self._mass_reciprocal, self._variance = float(estimate[9]), float(deviation[9] ** 2)
        self._subtract_coupling = False
        self._rate = self._velocity = np.full(3, np.nan)
        self._commands = self._commands_before = self._level = np.zeros(n_jets)
        self._time_s = -math.inf

    @property
    def covariance(self) -> Array:
        """Covariance of the ten estimates, shape (10, 10)."""
        covariance = np.zeros((10, 10))
        covariance[:N_ROTATION, :N_ROTATION] = self._covariance
        covariance[9, 9] = self._variance
        return covariance

    def step(
        self,
        time_s: float,
        gyro: ArrayLike | Mapping[str, ArrayLike],
        accelerometers: ArrayLike | Mapping[str, ArrayLike],
        commands: ArrayLike,
    ) -> EstimatorStep:
        """Takes in the readings of one sample, and the commands that act from now on.

        Args:
            time_s: of the sample, s; one sample period after the last call's.
            gyro: angular rate, rad/s, body axes, shape (3,), or a mapping from package names. NaN where
                missing.
            accelerometers: integrated specific force, ft/s or m/s, body axes, shape (3,) of the package
                in use, or a mapping from package names. NaN where missing.
            commands: fraction commanded over the interval that starts now, 0 to 1, shape (n_jets,).

        Raises:
            ValueError: when time goes backwards, a shape is wrong, or a fraction is outside 0 to 1.
            NotPositiveDefiniteError: when a covariance loses definiteness.
        """
        if not time_s > self._time_s:
            raise ValueError(f"time must go forward: {time_s} s after {self._time_s} s")
        rate = _reading(gyro, self._gyro.name, "gyro")
        velocity = _reading(accelerometers, self._accelerometer.name, "accelerometers")
        coming = np.asarray(commands, dtype=float)
        if coming.shape != self._level.shape:
            raise ValueError(f"commands must have shape {self._level.shape}, got {coming.shape}")
        if not ((coming >= 0.0) & (coming <= 1.0)).all():
            raise ValueError("commands must be fractions from 0 to 1")

        impulses = interval_impulses(
            self._commands, self._commands_before, self._level, self._impulse_per_level, self._lag
        )
        estimate, covariance = self._estimate, self._covariance
        try:
            turned = rotation_filter.cycle(
                estimate,
                covariance,
                self._rate,
                self._subtract_coupling,
                rate,
                self._rate_noise,
                impulses.angular_impulse,
                impulses.linear_impulse,
                impulses.usable,
                impulses.firing,
                self._rotation,
            )
            weighed = mass_filter.cycle(
                self._mass_reciprocal,
                self._variance,
                self._velocity,
                velocity,
                self._velocity_noise,
                self._position - estimate[6:],
                covariance[6:, 6:],
                turned.sample.increment,
                turned.sample.rate,
                2.0 * self._gyro.variance,
                impulses.linear_impulse,
                impulses.usable,
                impulses.firing,
                self._mass,
            )
        except NotPositiveDefiniteError as error:
            raise error.at(time_s, "estimator") from None

        self._estimate, self._covariance = turned.estimate, turned.covariance
        self._subtract_coupling = turned.innovation.subtract_coupling
        self._mass_reciprocal, self._variance = weighed.mass_reciprocal, weighed.variance
        self._rate, self._velocity = rate, velocity
        self._commands_before, self._commands, self._level = self._commands, coming.copy(), impulses.level
        self._time_s = time_s

        ten = np.append(self._estimate, self._mass_reciprocal)
        deviation = np.sqrt(np.append(self._covariance.diagonal(), self._variance))
        return EstimatorStep(
            time_s,
            ten,
            deviation,
            converged(deviation, ten, self._limits),
            turned.used,
            weighed.used,
            turned.innovation.nis,
            weighed.innovation.nis,
        )


def _reading(readings: ArrayLike | Mapping[str, ArrayLike], package: str, what: str) -> Array:
    if isinstance(readings, Mapping):
        if package not in readings:
            raise ValueError(f"{what}: no reading of package '{package}' among {sorted(readings)}")
        readings = readings[package]
    reading = np.array(readings, dtype=float)  # a copy: the caller may reuse its buffer
    if reading.shape != (3,):
        raise ValueError(f"{what} must have shape (3,), got {reading.shape}")
    return reading
