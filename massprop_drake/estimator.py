"""The estimators for real time: one call a cycle, no simulator, no file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from massprop_drake import settings as make
from massprop_drake.errors import InputError
from massprop_drake.maths import detection, mass_filter, mass_jump, rotation_filter
from massprop_drake.maths.adaptation import NO_ADAPTATION
from massprop_drake.maths.impulses import interval_impulses
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import N_ROTATION, converged
from massprop_drake.maths.sensing import increment_noise
from massprop_drake.maths.thrust import lag_factors
from massprop_drake.models import dotted
from massprop_drake.scenario import Scenario, check_against_vehicle
from massprop_drake.vehicle import Vehicle

Array = NDArray[np.float64]


class Detection(NamedTuple):
    """A failure or a jump declared at a cycle.

    Attributes:
        kind: "jet", "mass_property_jump" or "withdrawn".
        onset_s: end of the last sample that showed nothing, s.
        cluster: number of the suspected jet's cluster; None for a jump.
        jet: designation of the suspected jet, the likeliest of its cluster; None for a jump.
        isolated: whether the data name the jet, not only its cluster.
        magnitude: force too much (positive) or missing (negative), lbf or N.
        magnitude_std: its 1-sigma.
    """

    kind: str
    onset_s: float
    cluster: int | None
    jet: str | None
    isolated: bool
    magnitude: float
    magnitude_std: float


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
        alarm: whether the sample shows a failed jet.
        detection: what was declared at this cycle; None: nothing.
        known_wrench: torque about the vehicle origin and force of failed jets from now on, shape (6,).
        removed: jets to be taken out of use, boolean, shape (n_jets,).
    """

    time_s: float
    estimate: Array
    standard_deviation: Array
    converged: bool
    used: bool
    mass_used: bool
    rotation_nis: float
    mass_nis: float
    alarm: bool
    detection: Detection | None
    known_wrench: Array
    removed: NDArray[np.bool_]


class Estimator:
    """Estimates mass properties and finds failed jets, cycle by cycle.

    From gyro, accelerometers and commands. The same mathematics as the `estimation` diagram, and the same
    answers. Call `step` once per sample
    period, in order of time; nothing it keeps grows.

    Args:
        vehicle: jets, sensors and nominal mass properties.
        settings: a scenario whose `sensors`, `estimation`, `rotation`, `mass` and `detector`
            fields are used; default: all at their defaults.

    Raises:
        InputError: (a ValueError) when the settings name what the vehicle does not have, or it has no
            accelerometer.
    """

    def __init__(self, vehicle: Vehicle, settings: Scenario | None = None):
        scenario = (settings or Scenario()).model_copy(update={"vehicle": vehicle})
        problems = check_against_vehicle(scenario, vehicle)
        if problems:
            raise InputError(*(f"settings: {dotted(path)}: {problem}" for path, problem in problems))
        self._vehicle = vehicle
        accelerometer = make.accelerometer(scenario)
        if accelerometer is None:
            raise InputError(f"vehicle '{vehicle.name}' has no accelerometer: its mass cannot be observed")
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
        self._window = mass_jump.empty_window(self._mass.jump_window)
        self._detector = None if scenario.detector.kind == "off" else make.detector_settings(scenario)
        self._suspicion = detection.initial_state(n_jets)
        self._unit_wrenches = make.unit_wrenches(vehicle)
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

        try:
            step = self._cycle(time_s, rate, velocity)
        except NotPositiveDefiniteError as error:
            raise error.at(time_s, "estimator") from None
        self._rate, self._velocity = rate, velocity
        self._commands_before, self._commands = self._commands, coming.copy()
        self._time_s = time_s
        return step

    def _cycle(self, time_s: float, rate: Array, velocity: Array) -> EstimatorStep:
        impulses = interval_impulses(
            self._commands, self._commands_before, self._level, self._impulse_per_level, self._lag
        )
        estimate, covariance = self._estimate, self._covariance
        known = detection.NO_KNOWN_FORCE
        if self._detector is not None:
            parameters = np.append(estimate, self._mass_reciprocal)
            known = detection.known_force(self._suspicion, parameters, self._detector)
        impulse = known.wrench * self._vehicle.sample_period_s
        angular_impulse = impulses.angular_impulse + impulse[:3]
        linear_impulse = impulses.linear_impulse + impulse[3:]
        firing = impulses.firing
        acting = firing or known is not detection.NO_KNOWN_FORCE

        turning = rotation_filter.measure(
            estimate,
            covariance,
            self._rate,
            self._subtract_coupling,
            rate,
            self._rate_noise + known.rotation_spread,
            angular_impulse,
            linear_impulse,
            acting,
            self._rotation,
        )
        moving = mass_filter.measure(
            self._mass_reciprocal,
            self._variance,
            self._velocity,
            velocity,
            self._velocity_noise + known.translation_spread,
            self._position - estimate[6:],
            covariance[6:, 6:],
            turning.sample.increment,
            turning.sample.rate,
            2.0 * self._gyro.variance,
            linear_impulse,
            self._mass,
        )
        judged = None
        if self._detector is not None:
            judged = detection.judged(
                self._suspicion,
                time_s,
                self._commands,
                impulses.usable,
                firing,
                moving.innovation.innovation,
                turning.innovation.innovation,
                moving.innovation.covariance,
                turning.innovation.covariance,
                estimate,
                covariance,
                np.array([self._mass_reciprocal, self._variance]),
                self._limits,
                self._detector,
            )
            self._suspicion = judged.state
        adaptation = NO_ADAPTATION if judged is None else judged.adaptation
        # a known force alone is no reason to learn: it may have ceased
        usable = impulses.usable and firing
        turned = rotation_filter.finish(estimate, covariance, turning, usable, adaptation, self._rotation)
        weighed = mass_filter.finish(
            self._mass_reciprocal,
            self._variance,
            self._window,
            moving,
            impulses.usable,
            firing,
            adaptation,
            self._mass,
        )
        self._estimate, self._covariance = turned.estimate, turned.covariance
        self._subtract_coupling = turning.innovation.subtract_coupling
        self._mass_reciprocal, self._variance, self._window = weighed[:3]
        self._level = impulses.level

        ten = np.append(self._estimate, self._mass_reciprocal)
        deviation = np.sqrt(np.append(self._covariance.diagonal(), self._variance))
        return EstimatorStep(
            time_s,
            ten,
            deviation,
            converged(deviation, ten, self._limits),
            turned.used,
            weighed.used,
            turning.innovation.nis,
            moving.innovation.nis,
            judged is not None and judged.finding.alarm,
            None if judged is None else self._detection(judged.finding),
            self._suspicion.force @ self._unit_wrenches,
            self._suspicion.removed != 0.0,
        )

    def _detection(self, finding: detection.Finding) -> Detection | None:
        if finding.event == detection.NOTHING:
            return None
        if finding.event == detection.JUMP:
            return Detection("mass_property_jump", finding.onset_s, None, None, False, 0.0, 0.0)
        jet = self._vehicle.jets[finding.isolation.jet]
        return Detection(
            "jet" if finding.event == detection.DECLARED else "withdrawn",
            finding.onset_s,
            jet.cluster,
            jet.designation,
            finding.jet_isolated,
            finding.magnitude,
            finding.magnitude_std,
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
