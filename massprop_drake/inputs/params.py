"""From a vehicle and a scenario's choices to what the mathematics takes: numbers and arrays.

The diagrams and the real-time `Estimator` both build their parts from these, so they agree.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from massprop_drake.inputs.scenario import Degraded, Drift, Failure, Intermittent, Leak, Scenario, SensorErrors
from massprop_drake.inputs.vehicle import Accelerometer, Gyro, SensorPackage, Vehicle
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams
from massprop_drake.maths.estimation import adaptation, redundancy
from massprop_drake.maths.estimation.detectors.cglr import CglrParams
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.mass_properties import N_ROTATION, MassProperties, initial_standard_deviation
from massprop_drake.maths.noise import normal_sample, uniform_phase
from massprop_drake.maths.vehicle import true_failures as failures
from massprop_drake.maths.vehicle.sensing import SensorModel, smoothing_factor

Array = NDArray[np.float64]

_COUPLING = {
    "subtract": rotation_filter.SUBTRACT,
    "ignore": rotation_filter.IGNORE,
    "hybrid": rotation_filter.HYBRID,
    "model": rotation_filter.MODEL,
}
_COMPENSATION = {
    "none": mass_filter.NO_COMPENSATION,
    "transverse": mass_filter.TRANSVERSE,
    "transverse_centripetal": mass_filter.TRANSVERSE_CENTRIPETAL,
}


_FORCE_FLOOR = 1e-4  # least 1-sigma of a known force, relative to the strongest jet's

_RULES = {
    "single": redundancy.SINGLE,
    "most_accurate": redundancy.MOST_ACCURATE,
    "mid_value": redundancy.MID_VALUE,
    "average": redundancy.AVERAGE,
    "weighted_average": redundancy.WEIGHTED_AVERAGE,
    "serial": redundancy.SERIAL,
}


def initial_estimate(scenario: Scenario) -> Array:
    """The ten parameters that the filters start from, shape (10,)."""
    estimation, nominal = scenario.estimation, scenario.vehicle_data.nominal
    if estimation.start == "zero":
        return np.zeros(10)
    given = None if estimation.given is None else estimation.given.mass_properties
    return (nominal if given is None else given.properties()).vector()


def initial_covariance(scenario: Scenario) -> Array:
    """Covariance of the ten parameters at the start, shape (10, 10)."""
    estimation, vehicle = scenario.estimation, scenario.vehicle_data
    if estimation.given is not None:
        if estimation.given.covariance is not None:
            return np.array(estimation.given.covariance)
        return np.diag(np.square(np.array(estimation.given.standard_deviation)))
    fraction = estimation.std_fraction
    if fraction is None:
        fraction = vehicle.uncertainty if estimation.start == "nominal" else 1.0
    deviation = initial_standard_deviation(
        vehicle.nominal.vector(), fraction, vehicle.center_of_mass_floor, floors=estimation.floors
    )
    return np.diag(deviation**2)


def rotation_params(scenario: Scenario) -> rotation_filter.RotationParams:
    """Settings of the rotation filter."""
    rotation = scenario.rotation
    jump_std = rotation.jump_std_fraction * np.sqrt(initial_covariance(scenario).diagonal()[:N_ROTATION])
    return rotation_filter.RotationParams(
        period_s=scenario.vehicle_data.sample_period_s,
        gyro_variances=np.array([package.variance for package in gyros(scenario)]),
        rule=_RULES[scenario.sensors.combine.gyros],
        second_order=rotation.filter != "extended",
        bias=rotation.filter != "second_order_without_bias",
        curvature=rotation.filter != "second_order_without_covariance",
        coupling=_COUPLING[rotation.coupling],
        coupling_limit=rotation.coupling_limit,
        jump_threshold=rotation.jump_threshold if rotation.jump == "covariance_increment" else math.inf,
        jump_covariance=np.diag(jump_std**2),
        process_noise=np.diag(np.square(rotation.process_noise_std)),
        disturbance_covariance=rotation.disturbance_std**2 * np.eye(3),
        largest_turn=rotation.largest_turn,
    )


def mass_params(scenario: Scenario) -> mass_filter.MassParams:
    """Settings of the mass filter."""
    mass = scenario.mass
    window = mass.jump_window if mass.jump == "glr" else 1
    # chi-square with one degree of freedom for each sample of the window
    threshold = math.inf if mass.jump == "none" else float(chdtri(1, mass.jump_false_alarm_rate / window))
    return mass_filter.MassParams(
        period_s=scenario.vehicle_data.sample_period_s,
        positions=np.array([package.position for package in accelerometers(scenario)]),
        variances=np.array([package.variance for package in accelerometers(scenario)]),
        rule=_RULES[scenario.sensors.combine.accelerometers],
        correlated=scenario.sensors.combine.correlated,
        compensation=_COMPENSATION[mass.compensation],
        compensation_covariance=mass.compensation_covariance,
        process_noise=mass.process_noise_std**2,
        jump_variance=float(scenario.vehicle_data.nominal.vector()[9] ** 2),
        jump_threshold=threshold,
        jump_window=window,
        small_gain=mass.jump == "single_sample_thesis",
        disturbance_covariance=mass.disturbance_std**2 * np.eye(3),
    )


def phase_space_params(scenario: Scenario) -> PhaseSpaceParams:
    """Settings of the phase-space controller."""
    autopilot = scenario.autopilot
    return PhaseSpaceParams(
        discrete_rate=autopilot.discrete_rate,
        hold_gain=autopilot.hold_gain,
        hold_rate_limit=autopilot.hold_rate_limit,
        capture_rate=autopilot.capture_rate,
        rate_deadband=autopilot.rate_deadband,
        acceleration=autopilot.acceleration,
        horizon_s=autopilot.horizon_s,
        resolve_rate=autopilot.resolve_rate,
        resolve_after_s=autopilot.resolve_after_s,
    )


def convergence_limits(scenario: Scenario) -> Array:
    """Limits of `mass_properties.converged`, shape (3,)."""
    limits = scenario.estimation.convergence
    center = limits.center_of_mass or 0.03 * scenario.vehicle_data.rms_arm
    return np.array([limits.diagonal, center, limits.mass_reciprocal])


def plant_time_constants(scenario: Scenario) -> Array:
    """Time constants of the true thrust, s, shape (n_jets,); zero: instantaneous."""
    constants = scenario.vehicle_data.time_constants_s
    return constants if scenario.plant.thrust_transient == "vehicle" else np.zeros_like(constants)


def estimator_time_constants(scenario: Scenario) -> Array:
    """Time constants that the impulse model uses, s, shape (n_jets,); zero: instantaneous."""
    constants = scenario.vehicle_data.time_constants_s
    return constants if scenario.estimation.thrust_transient == "gate_lag" else np.zeros_like(constants)


def gyros(scenario: Scenario) -> tuple[Gyro, ...]:
    """The gyro packages, the one in use first."""
    packages = scenario.vehicle_data.gyros
    return tuple(sorted(packages, key=lambda package: package.name != scenario.sensors.gyro))


def accelerometers(scenario: Scenario) -> tuple[Accelerometer, ...]:
    """The accelerometer packages, the one in use first."""
    vehicle = scenario.vehicle_data
    preferred = scenario.sensors.accelerometer or vehicle.preferred_accelerometer
    return tuple(sorted(vehicle.accelerometers, key=lambda package: package.name != preferred))


def gyro(scenario: Scenario) -> Gyro:
    """The gyro package in use."""
    return gyros(scenario)[0]


def thrust_errors(scenario: Scenario) -> Array | None:
    """Impulses of one sigma of each jet's thrust error at full level over a sample, about the vehicle origin,
    shape (n_jets, 6); None where thrust is taken as known.
    """
    uncertainty, vehicle = scenario.estimation.thrust_uncertainty, scenario.vehicle_data
    return uncertainty * vehicle.wrenches * vehicle.sample_period_s if uncertainty > 0.0 else None


def thrust_factors(scenario: Scenario) -> Array:
    """True over nominal thrust of each jet, shape (n_jets,)."""
    spread, jets = scenario.plant.thrust_dispersion, scenario.vehicle_data.jets
    if spread == 0.0:
        return np.ones(len(jets))
    stream = "thrust dispersion"
    factors = 1.0 + spread * normal_sample(scenario.seed, stream, 0, len(jets))
    return np.maximum(factors, 0.01)  # above zero: what a failed jet gives is a multiple of its thrust


def time_step(scenario: Scenario) -> float:
    """Step of the plant, s; zero: continuous."""
    step = scenario.plant.time_step
    return scenario.vehicle_data.sample_period_s if step is None else step


def selectable(scenario: Scenario) -> NDArray[np.bool_]:
    """Which jets the autopilot may select, by their kind, shape (n_jets,)."""
    kinds, vehicle = scenario.autopilot.jet_kinds, scenario.vehicle_data
    if kinds is None:
        kinds = ("primary",) if "primary" in vehicle.jet_kinds else tuple(vehicle.jet_kinds)
    return np.array([jet.kind in kinds for jet in vehicle.jets])


def sensor_model(scenario: Scenario, sensor: SensorPackage) -> SensorModel:
    """The true errors of a sensor package: the vehicle's quantum and noise, and the scenario's errors."""
    period = scenario.vehicle_data.sample_period_s
    errors = next(
        (entry for entry in scenario.sensors.errors if entry.sensor == sensor.name), SensorErrors(sensor=sensor.name)
    )
    seeded = scenario.sensors.quantizer_phase == "seeded"
    return SensorModel(
        period_s=period,
        scale_factor=np.array(errors.scale_factor),
        smoothing=smoothing_factor(errors.bandwidth_hz, period),
        bias=np.array(errors.bias),
        walk_std=errors.bias_random_walk * math.sqrt(period),
        integrates=isinstance(sensor, Accelerometer),
        noise_std=sensor.noise_std if errors.noise_std is None else errors.noise_std,
        quantum=sensor.quantum if errors.quantum is None else errors.quantum,
        phase=uniform_phase(scenario.seed, sensor.name, 3) if seeded else np.zeros(3),
        delay=errors.delay_samples,
        limit=math.inf if sensor.range is None else sensor.range,
    )


def true_properties(scenario: Scenario) -> MassProperties:
    """Mass properties of the true vehicle at the start."""
    properties = scenario.plant.mass_properties
    return scenario.vehicle_data.nominal if properties is None else properties.properties()


def plant_wrenches(scenario: Scenario) -> Array:
    """Torque about the vehicle origin, force and mass flow of each jet, shape (n_jets, 7)."""
    vehicle = scenario.vehicle_data
    flows = vehicle.mass_flows if scenario.plant.depletion else np.zeros(len(vehicle.jets))
    return thrust_factors(scenario)[:, None] * np.column_stack([vehicle.wrenches, flows])


def commands(scenario: Scenario) -> Array:
    """The prescribed jet schedule, a row per sample: 1 where a pulse is on, shape (n_samples, n_jets).

    A pulse is on at t_k with start <= t_k < end, to within a billionth of the sample period.
    """
    vehicle = scenario.vehicle_data
    period = vehicle.sample_period_s
    table = np.zeros((sample_count(scenario), len(vehicle.jets)))
    for pulse in scenario.jet_schedule:
        first, last = (math.ceil(time / period - 1e-9) for time in (pulse.start_s, pulse.end_s))
        table[first:last, vehicle.jet_index(pulse.jet)] = 1.0
    return table


def sample_count(scenario: Scenario) -> int:
    """Number of sample intervals in a run: the last sample is at or just before the end."""
    return math.floor(scenario.duration_s / scenario.vehicle_data.sample_period_s + 1e-9)


_FAILURES = {
    "stuck_on": failures.STUCK_ON,
    "stuck_off": failures.STUCK_OFF,
    "degraded": failures.DEGRADED,
    "leak": failures.LEAK,
    "intermittent": failures.INTERMITTENT,
    "drift": failures.DRIFT,
}


def jet_failures(scenario: Scenario) -> tuple[failures.Failure, ...]:
    """The true failures of jets."""
    vehicle = scenario.vehicle_data
    factors = thrust_factors(scenario)
    result = []
    for number, entry in enumerate(scenario.failures):
        jet = vehicle.jet_index(entry.jet)
        result.append(
            failures.Failure(
                jet=jet,
                kind=_FAILURES[entry.kind],
                start_s=entry.start_s,
                end_s=math.inf if entry.end_s is None else entry.end_s,
                amount=_amount(entry, factors[jet] * vehicle.jets[jet].thrust),
                probability=entry.probability if isinstance(entry, Intermittent) else 0.0,
                stream=f"failure {number} of {entry.jet}",
            )
        )
    return tuple(result)


def _amount(entry: Failure, thrust: float) -> float:
    """What `maths.failures.Failure` calls the amount."""
    match entry:
        case Degraded():
            return entry.fraction
        case Leak():
            return entry.force / thrust
        case Intermittent():
            return entry.level
        case Drift():
            return entry.rate_per_s
        case _:
            return 0.0


def unit_wrenches(vehicle: Vehicle) -> Array:
    """Torque about the vehicle origin and force of a unit force along each jet, shape (n_jets, 6)."""
    return vehicle.wrenches / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]


_ACTIONS = {
    "correct": adaptation.CORRECT,
    "correct_thesis": adaptation.CORRECT_THESIS,
    "reject": adaptation.REJECT,
}


def _manifolds(vehicle: Vehicle) -> NDArray[np.int_]:
    """Index of each jet's manifold, -1 where it has none."""
    names = sorted({jet.manifold for jet in vehicle.jets if jet.manifold is not None})
    return np.array([-1 if jet.manifold is None else names.index(jet.manifold) for jet in vehicle.jets])


def detector_params(scenario: Scenario) -> CglrParams:
    """Settings of the failure detector."""
    vehicle, detector = scenario.vehicle_data, scenario.detector
    limit = detector.unexplained_limit
    return CglrParams(
        period_s=vehicle.sample_period_s,
        clusters=np.array([jet.cluster for jet in vehicle.jets]),
        unit_wrenches=unit_wrenches(vehicle),
        thrusts=np.array([jet.thrust for jet in vehicle.jets]),
        margin=detector.margin,
        threshold=detector.threshold,
        dispersion_threshold=detector.dispersion_threshold,
        magnitude_threshold=detector.magnitude_threshold,
        mirror_sign_rule=detector.mirror_sign_rule,
        signature_uncertainty=detector.signature_uncertainty,
        unexplained_limit=math.inf if limit is None else limit,
        alarms_to_declare=detector.reconfigure_after or 0,
        alarm_gap=detector.alarm_gap,
        action=_ACTIONS[detector.on_detection],
        force_variance_floor=(_FORCE_FLOOR * max(jet.thrust for jet in vehicle.jets)) ** 2,
        manifolds=_manifolds(vehicle) if detector.close_manifold else np.full(len(vehicle.jets), -1),
    )
