"""The estimators for real time: one call a cycle, no simulator, no file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from massprop_drake.errors import InputError, dotted
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario, check_against_vehicle
from massprop_drake.inputs.vehicle import SensorPackage, Vehicle
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detectors import cglr as detection
from massprop_drake.maths.estimation.filters import mass_filter, mass_jump, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassState
from massprop_drake.maths.estimation.filters.rotation_filter import RotationState
from massprop_drake.maths.estimation.impulses import interval_impulses
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import N_ROTATION, converged
from massprop_drake.maths.vehicle.sensing import unsaturated
from massprop_drake.maths.vehicle.thrust import lag_factors

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
        scenario: whose `sensors`, `estimation`, `rotation`, `mass` and `detector` fields are used; default:
            all at their defaults.

    Raises:
        InputError: (a ValueError) when the scenario names what the vehicle does not have, or it has no
            accelerometer.
    """

    def __init__(self, vehicle: Vehicle, scenario: Scenario | None = None):
        scenario = (scenario or Scenario()).model_copy(update={"vehicle": vehicle})
        problems = check_against_vehicle(scenario, vehicle)
        if problems:
            raise InputError(*(f"scenario: {dotted(path)}: {problem}" for path, problem in problems))
        self._vehicle = vehicle
        if not vehicle.accelerometers:
            raise InputError(f"vehicle '{vehicle.name}' has no accelerometer: its mass cannot be observed")
        self._gyros, self._accelerometers = params.gyros(scenario), params.accelerometers(scenario)
        self._rotation, self._mass = params.rotation_params(scenario), params.mass_params(scenario)
        self._limits = params.convergence_limits(scenario)
        self._impulse_per_level = vehicle.wrenches * vehicle.sample_period_s
        self._lag = lag_factors(params.estimator_time_constants(scenario), vehicle.sample_period_s)
        self._thrust_errors = params.thrust_errors(scenario)

        estimate, covariance = params.initial_estimate(scenario), params.initial_covariance(scenario)
        n_jets = len(vehicle.jets)
        considers = self._thrust_errors is not None
        self._turning = RotationState(
            estimate[:N_ROTATION],
            covariance[:N_ROTATION, :N_ROTATION],
            np.zeros((N_ROTATION, n_jets)) if considers else None,
        )
        self._moving = MassState(
            float(estimate[9]),
            float(covariance[9, 9]),
            mass_jump.empty_window(self._mass.jump_window),
            np.zeros(n_jets) if considers else None,
        )
        self._subtract_coupling = False
        self._rates = np.full((len(self._gyros), 3), np.nan)
        self._velocities = np.full((len(self._accelerometers), 3), np.nan)
        self._commands = self._commands_before = self._level = np.zeros(n_jets)
        self._outside = np.zeros(6)
        self._detector = None if scenario.detector.kind == "off" else params.detector_params(scenario)
        self._suspicion = detection.initial_state(n_jets)
        self._unit_wrenches = params.unit_wrenches(vehicle)
        self._time_s = -math.inf

    @property
    def covariance(self) -> Array:
        """Covariance of the ten estimates, shape (10, 10)."""
        covariance = np.zeros((10, 10))
        covariance[:N_ROTATION, :N_ROTATION] = self._turning.covariance
        covariance[9, 9] = self._moving.variance
        return covariance

    def step(
        self,
        time_s: float,
        gyro: ArrayLike | Mapping[str, ArrayLike],
        accelerometers: ArrayLike | Mapping[str, ArrayLike],
        commands: ArrayLike,
        outside_wrench: ArrayLike | None = None,
    ) -> EstimatorStep:
        """Takes in the readings of one sample, and the commands that act from now on.

        Args:
            time_s: of the sample, s; one sample period after the last call's.
            gyro: angular rate, rad/s, body axes, shape (3,) of the package in use, or a mapping from
                package names. NaN where missing.
            accelerometers: integrated specific force, ft/s or m/s, body axes, shape (3,) of the package
                in use, or a mapping from package names. NaN where missing.
            commands: fraction commanded over the interval that starts now, 0 to 1, NaN where not known,
                shape (n_jets,).
            outside_wrench: torque about the vehicle origin and force of known outside forces, mean over
                that interval, shape (6,); None: none.

        Raises:
            ValueError: when time goes backwards, a shape is wrong, a fraction is outside 0 to 1, or the
                outside wrench is not finite.
            NotPositiveDefiniteError: when a covariance loses definiteness.
        """
        if not time_s > self._time_s:
            raise ValueError(f"time must go forward: {time_s} s after {self._time_s} s")
        rates = _readings(gyro, self._gyros, "gyro")
        velocities = _readings(accelerometers, self._accelerometers, "accelerometers")
        coming = np.array(commands, dtype=float)  # copies: the caller may reuse its buffers
        if coming.shape != self._level.shape:
            raise ValueError(f"commands must have shape {self._level.shape}, got {coming.shape}")
        if ((coming < 0.0) | (coming > 1.0)).any():
            raise ValueError("commands must be fractions from 0 to 1")
        outside = np.zeros(6) if outside_wrench is None else np.array(outside_wrench, dtype=float)
        if outside.shape != (6,):
            raise ValueError(f"outside_wrench must have shape (6,), got {outside.shape}")
        if not np.isfinite(outside).all():
            raise ValueError("outside_wrench must be finite")

        try:
            step = self._cycle(time_s, rates, velocities)
        except NotPositiveDefiniteError as error:
            raise error.at(time_s, "estimator") from None
        self._rates, self._velocities = rates, velocities
        self._commands_before, self._commands, self._outside = self._commands, coming, outside
        self._time_s = time_s
        return step

    def _cycle(self, time_s: float, rates: Array, velocities: Array) -> EstimatorStep:
        period = self._vehicle.sample_period_s
        impulses = interval_impulses(
            self._commands,
            self._commands_before,
            self._level,
            self._impulse_per_level,
            self._lag,
            self._outside * period,
        )
        estimate, covariance = self._turning.estimate, self._turning.covariance
        known = detection.NO_KNOWN_FORCE
        if self._detector is not None:
            parameters = np.append(estimate, self._moving.mass_reciprocal)
            known = detection.known_force(self._suspicion, parameters, self._commands, self._detector)
        impulse = known.wrench * period
        angular_impulse = impulses.angular_impulse + impulse[:3]
        linear_impulse = impulses.linear_impulse + impulse[3:]
        firing = impulses.firing
        failed = known is not detection.NO_KNOWN_FORCE
        spread, linear_spread = None, None
        if self._thrust_errors is not None:
            spread = impulses.mean_level[:, None] * self._thrust_errors
            linear_spread = self._thrust_errors[:, 3:].T * impulses.mean_level

        turning = rotation_filter.measure(
            self._turning,
            self._rates,
            self._subtract_coupling,
            rates,
            known.rotation_spread if failed else None,
            angular_impulse,
            linear_impulse,
            firing or failed,
            self._rotation,
            spread,
        )
        sample = turning.sample
        rotation = mass_filter.Rotation(
            sample.increment, sample.rate, sample.gyro_variance, estimate[6:], covariance[6:, 6:]
        )
        moving = mass_filter.measure(
            self._moving,
            self._velocities,
            velocities,
            known.translation_spread if failed else None,
            rotation,
            linear_impulse,
            self._mass,
            linear_spread,
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
                np.array([self._moving.mass_reciprocal, self._moving.variance]),
                self._limits,
                self._detector,
                detection.shared_covariance(moving.innovation.effects, turning.innovation.effects),
            )
            self._suspicion = judged.state
        adaptation = NO_ADAPTATION if judged is None else judged.adaptation
        # a known force alone is no reason to learn: it may have ceased
        usable = impulses.usable and firing
        turned = rotation_filter.finish(self._turning, turning, usable, adaptation, self._rotation)
        weighed = mass_filter.finish(self._moving, moving, impulses.usable, firing, adaptation, self._mass)
        self._turning, self._moving = turned.state, weighed.state
        self._subtract_coupling = turning.innovation.subtract_coupling
        self._level = impulses.level

        ten = np.append(self._turning.estimate, self._moving.mass_reciprocal)
        deviation = np.sqrt(np.append(self._turning.covariance.diagonal(), self._moving.variance))
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


def _readings(readings: ArrayLike | Mapping[str, ArrayLike], packages: Sequence[SensorPackage], what: str) -> Array:
    """Of all packages, the one in use first, NaN where missing or saturated, shape (s, 3)."""
    if not isinstance(readings, Mapping):
        readings = {packages[0].name: readings}
    known = [package.name for package in packages]
    unknown = [name for name in readings if name not in known]
    if unknown or not readings:
        given = f"'{unknown[0]}' is no package" if unknown else "no reading"
        raise ValueError(f"{what}: {given}; the vehicle has {known}")
    result = np.full((len(packages), 3), np.nan)
    for row, package in zip(result, packages, strict=True):
        if package.name in readings:
            reading = np.asarray(readings[package.name], dtype=float)
            if reading.shape != (3,):
                raise ValueError(f"{what} must have shape (3,), got {reading.shape}")
            row[:] = unsaturated(reading, math.inf if package.range is None else package.range)
    return result
