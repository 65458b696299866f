"""Parameters of the mathematics, numbers and arrays, from a vehicle and a scenario's choices.

The diagrams and the real-time `Estimator` both build their parts from these, so they agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.estimation_blocks import HypothesesBlock
from massprop_drake.inputs.moving import mode_params
from massprop_drake.inputs.onboard_blocks import SensorErrors
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.scheduled import Degraded, Drift, Failure, Intermittent, Leak, jump_terms
from massprop_drake.inputs.true_blocks import MultibodyBlock, PlantBlock
from massprop_drake.inputs.vehicle_file import STANDARD_GRAVITY, Vehicle
from massprop_drake.inputs.vehicle_sensors import (
    Accelerometer,
    Gyro,
    PoseSensor,
    RocketEngine,
    SensorPackage,
    VelocitySensor,
    Wheel,
)
from massprop_drake.maths.autopilot.gimbal_control import GimbalControl
from massprop_drake.maths.autopilot.jet_selection import forces_of
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, Window
from massprop_drake.maths.autopilot.pulses import Pulses, most_edges, valve_pulses, whole_cycles
from massprop_drake.maths.autopilot.wheel_control import WheelControlParams, shares_of
from massprop_drake.maths.estimation.cycle import EstimationParams
from massprop_drake.maths.estimation.detector import Detector, KnownJets
from massprop_drake.maths.estimation.detectors import DETECTORS
from massprop_drake.maths.estimation.filter import Instruments, Setup, ThrustModel
from massprop_drake.maths.estimation.filters import joint, thesis
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.filters.mass_filter import MassParams
from massprop_drake.maths.estimation.filters.registry import FILTERS
from massprop_drake.maths.estimation.filters.rotation_filter import RotationParams
from massprop_drake.maths.estimation.filters.thesis import ThesisParams
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE, DisturbanceParams
from massprop_drake.maths.estimation.joint.layout import AttitudeSensors
from massprop_drake.maths.estimation.joint.modes import ModeParams
from massprop_drake.maths.estimation.joint.rates import EVERY_PERIOD, Rates
from massprop_drake.maths.estimation.joint.tanks import TankParams
from massprop_drake.maths.estimation.joint.wheels import WheelParams
from massprop_drake.maths.estimation.pose import setting as pose_setting
from massprop_drake.maths.estimation.pose.setting import Around, Tracking, Valves
from massprop_drake.maths.flight import FlightParams, PilotParams
from massprop_drake.maths.linear_algebra import normals
from massprop_drake.maths.mass_properties import (
    MASS_RECIPROCAL,
    NAMES,
    MassProperties,
    Spread,
    initial_standard_deviation,
)
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle import true_failures as failures
from massprop_drake.maths.vehicle.depletion import NO_TANKS, Tanks
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, deviation_before, kept_share
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS, NO_ENGINES, EngineParams
from massprop_drake.maths.vehicle.joint_moves import Move
from massprop_drake.maths.vehicle.mounting import mounting, true_mounting
from massprop_drake.maths.vehicle.on_times import PLACES, levels_alone, most_pieces, shares
from massprop_drake.maths.vehicle.reaction_jets import drawn_factors, jets_params, true_wrenches
from massprop_drake.maths.vehicle.rigid_body import (
    RATE,
    Jump,
    initial_state,
    jumps_by_sample,
    packed_structure,
    seeded_body,
)
from massprop_drake.maths.vehicle.sensing import (
    Draws,
    SensorModel,
    Tone,
    package,
    smoothing_factor,
    vibration,
    with_draws,
)
from massprop_drake.maths.vehicle.thrust import lag_factors
from massprop_drake.maths.vehicle.tracking import PoseModel
from massprop_drake.maths.vehicle.true_engines import OUT, EngineFailure, EnginesModel
from massprop_drake.maths.vehicle.true_failures import as_levels
from massprop_drake.maths.vehicle.vehicle_cycle import NO_FILL, VehicleParams, truth
from massprop_drake.maths.vehicle.wheel_motors import WheelsModel

Array = NDArray[np.float64]

_WHOLE = 1e-6  # of a step: rounding of rates


def initial_estimate(scenario: Scenario) -> Array:
    """Returns the ten parameters that the filters start from, shape (10,)."""
    estimation, nominal = scenario.estimation, scenario.vehicle_data.nominal
    if estimation.start == "zero":
        return np.zeros(10)
    given = None if estimation.given is None else estimation.given.mass_properties
    return (nominal if given is None else given.properties()).vector()


def initial_covariance(scenario: Scenario) -> Array:
    """Returns the covariance of the ten parameters at the start, shape (10, 10)."""
    return scenario.estimation.initial_covariance(scenario.vehicle_data)


def setup(scenario: Scenario) -> Setup:
    """Collects the data from which a filter makes its parameters."""
    packages, vehicle = accelerometers(scenario), scenario.vehicle_data
    return Setup(
        period_s=vehicle.sample_period_s,
        gyro_variances=np.array([package.variance for package in gyros(scenario)]),
        accelerometer_positions=np.array([package.position for package in packages]).reshape(-1, 3),
        accelerometer_variances=np.array([package.variance for package in packages]),
        estimate=initial_estimate(scenario),
        covariance=initial_covariance(scenario),
        nominal=vehicle.nominal.vector(),
        thrust_errors=thrust_errors(scenario),
        gyros=_instruments(gyros(scenario)),
        accelerometers=_instruments(packages),
        thrust=thrust_model(scenario),
        widest=initial_standard_deviation(vehicle.nominal.vector(), 1.0, vehicle.center_of_mass_floor),
        limits=convergence_limits(scenario),
        trackers=_trackers(scenario),
        disturbance=stated_disturbance(scenario),
        opens_at=vehicle.opens_at,
        wheels=wheels(vehicle),
        wheel_uncertainty=np.array([wheel.inertia_uncertainty for wheel in vehicle.wheels]),
        engines=engines(vehicle),
        engine_sigmas=engine_sigmas(vehicle),
        rates=rates(scenario),
        tanks=tanks(vehicle),
        modes=modes(vehicle),
        tracking=tracking(scenario) if scenario.estimation.filter == "pose" else None,
    )


def rates(scenario: Scenario) -> Rates:
    """Returns the steps of the joint filter."""
    vehicle = scenario.vehicle_data
    if not steps_by_readings(scenario):
        return EVERY_PERIOD
    per_s = scenario.estimation.readings_per_s or vehicle.readings_per_s
    return Rates(vehicle.sample_period_s, max(math.ceil(per_s * vehicle.sample_period_s - _WHOLE), 1))


def steps_by_readings(scenario: Scenario) -> bool:
    """Tests whether the filter takes a step whenever anything is read, and not once a sample period."""
    stated = scenario.estimation.readings_per_s is not None or scenario.vehicle_data.has_own_rates
    return stated and scenario.estimation.filter == "joint"


def stated_disturbance(scenario: Scenario) -> DisturbanceParams:
    """Returns a vehicle's stated disturbance, torque and force as accelerations of the nominal vehicle."""
    vehicle = scenario.vehicle_data
    if vehicle.disturbance is None:
        return NO_DISTURBANCE
    sigmas = disturbance_sigmas(vehicle)
    accelerations = np.zeros((6, 6))
    accelerations[:3, :3] = np.linalg.inv(np.array(vehicle.mass_properties.inertia))
    accelerations[3:, 3:] = np.eye(3) / vehicle.nominal.mass
    acting = np.ascontiguousarray((accelerations * sigmas)[:, sigmas > 0.0])
    return DisturbanceParams(acting, vehicle.disturbance.time_constant_s)


def wheels(vehicle: Vehicle) -> WheelParams:
    """Makes the reaction wheels, of exact inertia."""
    axes = np.array([wheel.axis for wheel in vehicle.wheels]).reshape(-1, 3)
    return WheelParams(
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        inertias=np.array([wheel.inertia for wheel in vehicle.wheels]),
        sigma=0.0,
        speed_std=np.array([wheel.speed_std for wheel in vehicle.wheels]),
        most=np.array([wheel.most_acceleration for wheel in vehicle.wheels]),
    )


def engines(vehicle: Vehicle) -> EngineParams:
    """Makes the engines, without errors."""
    stated = vehicle.engines
    if not stated:
        return NO_ENGINES
    directions = np.array([engine.direction for engine in stated])
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    across = normals(directions)
    axes = across.copy()
    for place, engine in enumerate(stated):
        if engine.gimbal is not None:
            axes[place] = np.array(engine.gimbal.axes)
            across[place] = normals(directions[[place]], axes[[place], 0])[0]
    axes = axes / np.linalg.norm(axes, axis=2, keepdims=True)
    levels = np.unique([0.0, 1.0, *(level for engine in stated for level, _ in engine.impulses)])
    own = np.array([(one.level_rate, one.level_time_constant_s, 1.0, one.level_noise_std) for one in stated])
    fixed = (1.0, 0.0, 0.0, 0.0)
    of_gimbals = np.array(
        [fixed if g is None else (g.rate, g.time_constant_s, g.stop, g.noise_std) for g in (e.gimbal for e in stated)]
    )
    rates, constants_s, stops, read_std = np.stack((own, of_gimbals, of_gimbals), axis=2).transpose(1, 0, 2)
    return EngineParams(
        positions=np.array([engine.position for engine in stated]),
        directions=directions,
        axes=axes,
        normals=across,
        thrusts=np.array([engine.thrust for engine in stated]),
        levels=levels,
        flows=np.stack([_flows(engine, levels, STANDARD_GRAVITY[vehicle.units]) for engine in stated]),
        rates=rates.copy(),
        constants_s=constants_s.copy(),
        stops=stops.copy(),
        read_std=read_std.copy(),
        least=np.array([engine.least_level for engine in stated]),
        measured=np.array([float(engine.telemetry == "measured") for engine in stated]),
    )


def _flows(engine: RocketEngine, levels: Array, gravity: float) -> Array:
    """Returns flows of propellant at some levels, shape (k,)."""
    given, impulses = np.array(engine.impulses).T
    return np.asarray(engine.thrust * levels / (gravity * np.interp(levels, given, impulses)))


def engine_sigmas(vehicle: Vehicle) -> Array:
    """Returns 1-sigma of the errors of the engines, shape (6 n,)."""
    return np.array(
        [
            sigma
            for engine in vehicle.engines
            for sigma in (engine.thrust_uncertainty, engine.direction_std, engine.position_std)
            for _ in range(2)
        ]
    )


def tanks(vehicle: Vehicle) -> TankParams:
    """Makes the tanks that jets empty, as they are stated."""
    stated, geometry = vehicle.tanks, vehicle.tank_geometry

    def each(key: str) -> Array:
        return np.array([getattr(tank, key) for tank in stated], dtype=float)

    sigmas = each("propellant_std"), each("flow_uncertainty")
    return TankParams(*geometry, each("capacity"), each("propellant"), *sigmas)


def modes(vehicle: Vehicle) -> ModeParams:
    """Makes the modes of the parts that move inside a vehicle."""
    nominal = vehicle.nominal
    known = nominal.mass, nominal.center_of_mass, nominal.inertia
    return mode_params(vehicle.moving, known, vehicle.wrenches, vehicle.rms_arm)


def disturbance_sigmas(vehicle: Vehicle) -> Array:
    """Returns 1-sigma of a disturbance's torque and force, zero where none acts or none is shown, shape (6,)."""
    stated = vehicle.disturbance
    if stated is None:
        return np.zeros(6)
    force = stated.force_std if vehicle.accelerometers else (0.0, 0.0, 0.0)
    return np.array((*stated.torque_std, *force))


def tracking(scenario: Scenario) -> Tracking:
    """Collects the data of a vehicle that is followed in a fixed frame."""
    vehicle = scenario.vehicle_data
    kinds, around = list(vehicle.jet_kinds.values()), vehicle.surroundings
    poses, speeds = vehicle.poses, vehicle.velocities

    def each(key: str) -> Array:
        return np.array([getattr(kind, key) for kind in kinds], dtype=float)

    def stds(key: str) -> Array:
        return np.array([math.inf if getattr(pose, key) is None else getattr(pose, key) for pose in poses])

    estimation = scenario.estimation
    own = vehicle.mass_std is not None and estimation.start == "nominal" and estimation.std_fraction is None
    covariance = initial_covariance(scenario)
    relative = float(np.sqrt(covariance[MASS_RECIPROCAL, MASS_RECIPROCAL])) * vehicle.nominal.mass
    return Tracking(
        positions=vehicle.positions,
        forces=vehicle.thrusts,
        valves=Valves(
            delays_s=each("command_delay_s"),
            delay_stds_s=each("command_delay_std_s"),
            lags_s=each("time_constant_s"),
            lag_stds=each("lag_uncertainty"),
            openings_s=each("opening_delay_s"),
            opening_stds_s=each("opening_delay_std_s"),
            pulse_scatters=each("pulse_scatter"),
        ),
        around=Around(**{name: getattr(around, name) for name in Around._fields}),
        mass_std=(vehicle.mass_std or 0.0) / vehicle.nominal.mass if own else relative,
        common_std=vehicle.common_scale_uncertainty,
        common_walk=vehicle.common_scale_walk,
        planar=vehicle.motion == "planar",
        fixed=np.isin(NAMES, vehicle.fixed),
        position_stds=stds("position_std"),
        attitude_stds=stds("attitude_std"),
        time_stds_s=np.array([pose.time_std_s for pose in poses]),
        outliers=max((pose.outliers for pose in poses), default=0.0),
        points=np.array([pose.point for pose in poses]).reshape(-1, 3),
        point_stds=np.array([pose.point_std for pose in poses]),
        velocity_positions=np.array([speed.position for speed in speeds]).reshape(-1, 3),
        velocity_stds=np.array([speed.noise_std for speed in speeds]),
    )


def known_parameters(scenario: Scenario) -> NDArray[np.bool_]:
    """Selects parameters that are not estimated: they are fixed, or play no part in a plane, shape (10,)."""
    if scenario.estimation.filter != "pose":
        return np.zeros(10, dtype=bool)
    return pose_setting.known_parameters(tracking(scenario))


def _instruments(packages: Sequence[SensorPackage]) -> Instruments:
    quanta, noise, biases = ([getattr(p, key) for p in packages] for key in ("quantum", "noise_std", "bias_std"))
    return Instruments(np.array(quanta), np.array(noise), np.array(biases))


def thrust_model(scenario: Scenario) -> ThrustModel:
    """Makes the thrust model of a filter."""
    vehicle = scenario.vehicle_data
    kinds, of_jets = list(vehicle.jet_kinds.values()), vehicle.kind_indices
    return ThrustModel(
        wrenches=vehicle.wrenches,
        flows=vehicle.mass_flows,
        time_constants_s=estimator_time_constants(scenario),
        kinds=of_jets,
        uncertainty=vehicle.thrust_uncertainties,
        lag_uncertainty=np.array([kind.lag_uncertainty for kind in kinds]),
        repeatability=np.array([kind.repeatability for kind in kinds])[of_jets],
        arm=vehicle.rms_arm,
        tank_fraction=vehicle.tank_fraction,
        mounting=mounting(vehicle.wrenches, vehicle.positions, vehicle.mounting_sigmas),
    )


def joint_params(scenario: Scenario) -> JointFilterParams:
    """Makes the parameters of the joint filter."""
    return joint.make_params(setup(scenario), scenario)


def thesis_params(scenario: Scenario) -> ThesisParams:
    """Makes the parameters of the thesis's two filters."""
    return thesis.make_params(setup(scenario), scenario)


def rotation_params(scenario: Scenario) -> RotationParams:
    """Makes the parameters of the rotation filter."""
    return thesis_params(scenario).rotation


def mass_params(scenario: Scenario) -> MassParams:
    """Makes the parameters of the mass filter of a vehicle with an accelerometer."""
    found = thesis_params(scenario).mass
    assert found is not None
    return found


def estimation_params(scenario: Scenario) -> EstimationParams:
    """Makes the parameters of a cycle: those of the filter and the detector that the scenario names."""
    vehicle = scenario.vehicle_data
    filter_ = FILTERS[scenario.estimation.filter]
    return EstimationParams(
        period_s=vehicle.sample_period_s,
        impulse_per_level=vehicle.wrenches * vehicle.sample_period_s,
        lag=lag_factors(estimator_time_constants(scenario), vehicle.sample_period_s),
        filter=filter_,
        filter_params=filter_.params(setup(scenario), scenario),
        detector=detector(scenario),
        detector_params=detector_params(scenario),
        limits=convergence_limits(scenario),
    )


def phase_space_params(scenario: Scenario) -> PhaseSpaceParams:
    """Makes the settings of the phase-space controller."""
    autopilot = scenario.autopilot
    return PhaseSpaceParams(
        period_s=scenario.vehicle_data.sample_period_s,
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


def windows(scenario: Scenario) -> tuple[Window, ...]:
    """Lists the windows in which hand controllers are out of detent."""
    return tuple(
        Window(
            channel=(0 if window.controller == "rhc" else 3) + "xyz".index(window.axis[-1]),
            sign=1.0 if window.axis[0] == "+" else -1.0,
            start_s=window.start_s,
            end_s=window.end_s,
        )
        for window in scenario.maneuver
    )


def selection(scenario: Scenario) -> dict[str, Any]:
    """Makes the arguments of jet selection, see `systems.autopilot.selector.Selector`."""
    vehicle = scenario.vehicle_data
    return {
        "wrenches": vehicle.wrenches,
        "mass_flows": vehicle.mass_flows,
        "minimum_on_times_s": vehicle.minimum_on_times_s,
        "selectable": selectable(scenario),
        "mass_properties": vehicle.nominal.vector(),
        "period_s": vehicle.sample_period_s,
        "pulses": pulses(scenario),
    }


def pulses(scenario: Scenario) -> Pulses:
    """Returns the pulses that the autopilot flies; whole cycles unless the scenario asks for pulses."""
    vehicle, selected = scenario.vehicle_data, scenario.autopilot.jet_selection
    if scenario.open_loop or selected.output == "cycles":
        return whole_cycles(len(vehicle.jets))
    place, accumulates = PLACES[vehicle.jet_commands.at], selected.below_minimum == "accumulate"
    return valve_pulses(
        vehicle.minimum_on_times_s, vehicle.on_time_quanta_s, vehicle.sample_period_s, place, accumulates
    )


def convergence_limits(scenario: Scenario) -> Array:
    """Returns limits of `mass_properties.converged`, shape (3,)."""
    limits = scenario.estimation.convergence
    center = limits.center_of_mass or 0.03 * scenario.vehicle_data.rms_arm
    return np.array([limits.diagonal, center, limits.mass_reciprocal])


def plant_time_constants(scenario: Scenario) -> Array:
    """Returns time constants of the true thrust, s, shape (n_jets,); zero: instantaneous."""
    constants = scenario.vehicle_data.time_constants_s
    if scenario.plant.thrust_transient == "none":
        return np.zeros_like(constants)
    return constants * scenario.plant.lag_factor


def estimator_time_constants(scenario: Scenario) -> Array:
    """Returns time constants that the estimators begin with, s, shape (n_jets,); zero: instantaneous."""
    constants, estimation = scenario.vehicle_data.time_constants_s, scenario.estimation
    lagged = estimation.thrust_transient == "gate_lag"
    if estimation.filter == "pose":
        return constants
    if estimation.filter == "joint":
        lagged = scenario.joint.thrust_transient != "none"
    return constants if lagged else np.zeros_like(constants)


def gyros(scenario: Scenario) -> tuple[Gyro, ...]:
    """Returns the gyro packages, the one in use first."""
    packages = scenario.vehicle_data.gyros
    return tuple(sorted(packages, key=lambda package: package.name != scenario.sensors.gyro))


def accelerometers(scenario: Scenario) -> tuple[Accelerometer, ...]:
    """Returns the accelerometer packages, the one in use first."""
    vehicle = scenario.vehicle_data
    preferred = scenario.sensors.accelerometer or vehicle.preferred_accelerometer
    return tuple(sorted(vehicle.accelerometers, key=lambda package: package.name != preferred))


def trackers(scenario: Scenario) -> tuple[PoseSensor, ...]:
    """Returns the sensors of attitude that the joint filter reads."""
    return () if scenario.estimation.filter == "pose" else scenario.vehicle_data.poses


def read_besides(scenario: Scenario) -> tuple[PoseSensor | VelocitySensor | Wheel | RocketEngine, ...]:
    """Returns sensors of the vehicle that a filter reads, other than gyros and accelerometers."""
    vehicle = scenario.vehicle_data
    return (
        vehicle.tracked if scenario.estimation.filter == "pose" else (*vehicle.poses, *vehicle.wheels, *vehicle.engines)
    )


def simulated_besides(scenario: Scenario) -> tuple[PoseSensor | VelocitySensor | Wheel | RocketEngine, ...]:
    """Returns sensors of a simulation, other than gyros and accelerometers: engines only where they burn."""
    vehicle = scenario.vehicle_data
    return tuple(one for one in vehicle.tracked if scenario.engine_schedule or one not in vehicle.engines)


def _trackers(scenario: Scenario) -> AttitudeSensors:
    found = trackers(scenario)
    each = ((one.attitude_std or math.inf, one.time_std_s, one.outliers) for one in found)
    attitude_std, time_std_s, outliers = np.array(list(each)).reshape(-1, 3).T
    return AttitudeSensors(attitude_std**2, time_std_s**2, outliers.copy())


def read(scenario: Scenario) -> list[str]:
    """Returns names of the three-component sensors that a filter reads: gyros, accelerometers, trackers."""
    packages: tuple[SensorPackage | PoseSensor, ...] = (*gyros(scenario), *accelerometers(scenario))
    return [one.name for one in (*packages, *trackers(scenario))]


def weighs(scenario: Scenario) -> bool:
    """Tests whether readings show the mass: by an accelerometer, or by the vehicle's position."""
    return bool(scenario.vehicle_data.accelerometers) or scenario.estimation.filter == "pose"


def gyro(scenario: Scenario) -> Gyro:
    """Returns the gyro package in use.

    Raises:
        InputError: when the vehicle has none.
    """
    packages = gyros(scenario)
    if not packages:
        raise InputError(
            f"vehicle '{scenario.vehicle_data.name}' has no gyro, which an autopilot flies by; prescribe its jets in "
            "jet_schedule"
        )
    return packages[0]


def main_sensor(scenario: Scenario) -> str:
    """Returns the name of the sensor that shows rotation best: the gyro in use, or the first in a fixed frame."""
    packages = gyros(scenario)
    return packages[0].name if packages else scenario.vehicle_data.tracked[0].name


def thrust_errors(scenario: Scenario) -> Array | None:
    """Computes impulses of one sigma of each jet's thrust error, shape (n_jets, 6); None where thrust is known.

    They are those of full level over a sample, about the vehicle origin.
    """
    uncertainty, vehicle = scenario.estimation.thrust_uncertainty, scenario.vehicle_data
    return uncertainty * vehicle.wrenches * vehicle.sample_period_s if uncertainty > 0.0 else None


def thrust_factors(scenario: Scenario) -> Array:
    """Returns true over nominal thrust of each jet, shape (n_jets,)."""
    return drawn_factors(scenario.seed, scenario.plant.thrust_dispersion, len(scenario.vehicle_data.jets))


def time_step(scenario: Scenario) -> float:
    """Returns the step of the plant, s; zero: continuous."""
    step = scenario.plant.time_step if isinstance(scenario.plant, PlantBlock) else 0.0
    return scenario.vehicle_data.sample_period_s if step is None else step


def selectable(scenario: Scenario) -> NDArray[np.bool_]:
    """Selects the jets that the autopilot may use, by their kind, shape (n_jets,)."""
    kinds, vehicle = scenario.autopilot.jet_kinds, scenario.vehicle_data
    if kinds is None:
        kinds = ("primary",) if "primary" in vehicle.jet_kinds else tuple(vehicle.jet_kinds)
    return np.array([jet.kind in kinds for jet in vehicle.jets])


def sensor_model(scenario: Scenario, sensor: SensorPackage) -> SensorModel:
    """Makes the true errors of a sensor package: the vehicle's quantum and noise, and the scenario's errors."""
    return with_draws(undrawn_model(scenario, sensor), sensor_draws(scenario, sensor), scenario.seed)


def undrawn_model(scenario: Scenario, sensor: SensorPackage) -> SensorModel:
    """Makes the errors of `sensor_model` before the seed draws phases."""
    period, errors = scenario.vehicle_data.sample_period_s, _errors_of(scenario, sensor)
    tones, integrates = _tones(errors), isinstance(sensor, Accelerometer)
    scale_factor = np.array(errors.scale_factor)
    shaking = vibration(tones, 1.0 + scale_factor, errors.bandwidth_hz, integrates=integrates) if tones else None
    return SensorModel(
        period_s=period,
        scale_factor=scale_factor,
        smoothing=smoothing_factor(errors.bandwidth_hz, period),
        bias=np.array(errors.bias),
        walk_std=errors.bias_random_walk * math.sqrt(period),
        integrates=integrates,
        noise_std=sensor.noise_std if errors.noise_std is None else errors.noise_std,
        quantum=sensor.quantum if errors.quantum is None else errors.quantum,
        phase=np.zeros(3),
        delay=errors.delay_samples,
        limit=sensor.limit,
        vibration=shaking,
    )


def sensor_draws(scenario: Scenario, sensor: SensorPackage) -> Draws:
    """Draws phases of a sensor package by the seed."""
    errors = _errors_of(scenario, sensor)
    quantum = sensor.quantum if errors.quantum is None else errors.quantum
    marks = quantum > 0.0 and scenario.sensors.quantizer_phase == "seeded"
    return Draws(sensor.name, marks, _tones(errors), errors.bandwidth_hz)


def _errors_of(scenario: Scenario, sensor: SensorPackage) -> SensorErrors:
    nothing = SensorErrors(sensor=sensor.name)
    return next((entry for entry in scenario.sensors.errors if entry.sensor == sensor.name), nothing)


def _tones(errors: SensorErrors) -> tuple[Tone, ...]:
    """Makes tones of a package's vibration, in phase."""
    return tuple(Tone(entry.frequency_hz, np.array(entry.amplitude), np.zeros(3)) for entry in errors.vibration)


def vehicle_params(scenario: Scenario) -> VehicleParams:
    """Makes the parameters of the true vehicle's step."""
    vehicle, properties = scenario.vehicle_data, true_properties(scenario)
    period = vehicle.sample_period_s
    body = initial_state(properties.mass)
    body[RATE] = np.array(scenario.plant.initial_rate)
    jets = jets_params(
        plant_wrenches(scenario), plant_time_constants(scenario), period, jet_failures(scenario), scenario.seed
    )
    packages = tuple(
        package(
            sensor.name,
            sensor_model(scenario, sensor),
            np.array(sensor.position) if isinstance(sensor, Accelerometer) else None,
        )
        for sensor in vehicle.sensors
    )
    tanks, fill = true_tanks(scenario) or (NO_TANKS, NO_FILL)
    return VehicleParams(
        period_s=period,
        seed=scenario.seed,
        jets=jets,
        packages=packages,
        disturbance=disturbance(scenario),
        jumps=jumps_by_sample(mass_jumps(scenario), period),
        body=body,
        structure=packed_structure(properties),
        planar=vehicle.motion == "planar",
        tanks=tanks,
        fill=fill,
    )


def flight_params(scenario: Scenario, true: VehicleParams) -> FlightParams:
    """Makes the parameters of vehicle and autopilot from sample to sample; ``true``: see `vehicle_params`."""
    vehicle, names = scenario.vehicle_data, scenario.vehicle_data.sensor_names()
    flies = not scenario.open_loop
    pilot = PilotParams(
        phase_space_params(scenario),
        forces_of(vehicle.wrenches),
        unit_wrenches(vehicle),
        float(vehicle.nominal.vector()[MASS_RECIPROCAL]),
        flies and scenario.autopilot.mass_properties == "estimated",
        convergence_limits(scenario),
        pulses(scenario),
    )
    return FlightParams(
        truth(true),
        pilot,
        flies,
        flies and closes_manifolds(scenario),
        np.array([names.index(package.name) for package in gyros(scenario)], dtype=np.int_),
        np.array([names.index(package.name) for package in accelerometers(scenario)], dtype=np.int_),
    )


def mass_jumps(scenario: Scenario) -> tuple[Jump, ...]:
    """Lists the payloads that leave or come."""
    return tuple(Jump(jump.time_s, *jump_terms(jump)) for jump in scenario.jumps)


def joint_moves(plant: MultibodyBlock) -> dict[str, tuple[Move, ...]]:
    """Lists moves of each driven joint in the order of time; none of one that is held."""
    told = sorted(plant.moves, key=lambda move: move.start_s)
    driven = [start.joint for start in plant.joints if start.held] + [move.joint for move in told]
    return {
        name: tuple(Move(one.start_s, one.end_s, one.position) for one in told if one.joint == name)
        for name in dict.fromkeys(driven)
    }


def disturbance(scenario: Scenario) -> DisturbanceModel | None:
    """Returns torque and force on the true vehicle besides its jets'; None: there are none."""
    block = scenario.plant.disturbance
    mean, std = np.array([*block.torque, *block.force]), np.array([*block.torque_std, *block.force_std])
    if not (mean.any() or std.any()):
        return None
    kept = kept_share(block.correlation_time_s, scenario.vehicle_data.sample_period_s)
    return DisturbanceModel(mean, std, kept, deviation_before(scenario.seed, std))


def true_properties(scenario: Scenario) -> MassProperties:
    """Returns mass properties of the true vehicle at the start, if it is rigid; else the nominal ones."""
    spread, body = mass_spread(scenario), undrawn_properties(scenario)
    return body if spread is None else seeded_body(scenario.seed, body, spread)


def mass_spread(scenario: Scenario) -> Spread | None:
    """Returns the spread of the true mass properties; None: they are not drawn."""
    spread = scenario.plant.dispersion.spread if isinstance(scenario.plant, PlantBlock) else None
    return spread if spread is not None and any(spread) else None


def undrawn_properties(scenario: Scenario) -> MassProperties:
    """Returns mass properties about which the true ones are drawn, or the true ones where nothing is drawn."""
    properties = scenario.plant.mass_properties if isinstance(scenario.plant, PlantBlock) else None
    return scenario.vehicle_data.nominal if properties is None else properties.properties()


def pose_model(scenario: Scenario, sensor: PoseSensor) -> PoseModel:
    """Makes the true model of a sensor of position and attitude."""
    return PoseModel(
        point=np.array(sensor.point),
        position_std=math.inf if sensor.position_std is None else sensor.position_std,
        attitude_std=math.inf if sensor.attitude_std is None else sensor.attitude_std,
        time_std_s=sensor.time_std_s,
        outliers=sensor.outliers,
        planar=scenario.vehicle_data.motion == "planar",
        rate_hz=sensor.rate_hz or math.inf,
        period_s=scenario.vehicle_data.sample_period_s,
    )


def plant_wrenches(scenario: Scenario) -> Array:
    """Returns true torque about the vehicle origin, force and mass flow of each jet, shape (n_jets, 7).

    In a plane the floor takes what would lift or tip the vehicle: force along z, and torque about the true center of
    mass but about z.
    """
    floor = true_properties(scenario).center_of_mass if scenario.vehicle_data.motion == "planar" else None
    return true_wrenches(mounted_wrenches(scenario), thrust_factors(scenario), floor)


def mounted_wrenches(scenario: Scenario) -> Array:
    """Returns torque, force and mass flow of each jet at nominal thrust, as truly mounted, shape (n_jets, 7)."""
    vehicle, nominal, spread = scenario.vehicle_data, nominal_wrenches(scenario), scenario.plant.mounting_dispersion
    sigmas = spread * np.repeat(vehicle.mounting_sigmas, 2, axis=1)  # of two angles and two shifts
    if not sigmas.any():
        return nominal
    drawn = normal_sample(scenario.seed, "mounting", 0, sigmas.size).reshape(sigmas.shape)
    return true_mounting(nominal, vehicle.positions, sigmas * drawn)


def plant_mass_flows(scenario: Scenario) -> Array:
    """Returns true mass flow of each jet at full thrust, slug/s or kg/s, shape (n_jets,); zero if none is used."""
    return plant_wrenches(scenario)[:, 6]


def nominal_wrenches(scenario: Scenario) -> Array:
    """Returns torque about the origin, force and mass flow of each jet at nominal thrust, shape (n_jets, 7)."""
    vehicle = scenario.vehicle_data
    depletes = isinstance(scenario.plant, PlantBlock) and scenario.plant.depletion
    flows = vehicle.mass_flows if depletes else np.zeros(len(vehicle.jets))
    return np.column_stack([vehicle.wrenches, flows])


def commands(scenario: Scenario) -> tuple[Array, Array | None]:
    """Makes the prescribed jet schedule, a row per sample: commands and onsets, see `maths.vehicle.on_times`.

    Of a vehicle without on-times a pulse is on at t_k with start <= t_k < end, to within a billionth of the sample
    period. There are no onsets (None) where all jets switch with samples. Both tables are of shape (n_samples, n_jets).
    """
    vehicle, count = scenario.vehicle_data, sample_count(scenario)
    period = vehicle.sample_period_s
    table = np.zeros((count, len(vehicle.jets)))
    onset_s = levels_alone(table.shape)
    for pulse in scenario.jet_schedule:
        jet = vehicle.jet_index(pulse.jet)
        if vehicle.has_on_times:
            for sample, since_s, share in shares(pulse.start_s, pulse.end_s, period, count):
                table[sample, jet], onset_s[sample, jet] = share, since_s
        else:
            first, last = (math.ceil(time / period - 1e-9) for time in (pulse.start_s, pulse.end_s))
            table[first:last, jet] = 1.0
    return table, onset_s if most_pieces(table, onset_s, period) > 1 else None


def wheels_model(scenario: Scenario) -> WheelsModel:
    """Makes the true reaction wheels, before their inertias are drawn."""
    stated, plant = scenario.vehicle_data.wheels, scenario.plant
    known = wheels(scenario.vehicle_data)
    return WheelsModel(
        axes=known.axes,
        inertias=known.inertias,
        most=known.most * known.inertias,
        quanta=np.array([wheel.quantum for wheel in stated]),
        noise_std=np.array([wheel.noise_std for wheel in stated]),
        dispersion=plant.wheel_dispersion,
        start=np.array([plant.wheel_speeds.get(wheel.name, 0.0) for wheel in stated]),
        fastest=np.array([wheel.fastest for wheel in stated]),
    )


def wheel_control(scenario: Scenario) -> WheelControlParams | None:
    """Makes the law by which the autopilot turns the vehicle by its wheels; None: it does not."""
    vehicle, block = scenario.vehicle_data, scenario.autopilot.wheels
    if block is None:
        return None
    known, settings = wheels(vehicle), phase_space_params(scenario)
    return WheelControlParams(
        axes=known.axes,
        shares=shares_of(known.axes),
        inertias=known.inertias,
        most=known.most * known.inertias,
        fastest=np.array([wheel.fastest for wheel in vehicle.wheels]),
        inertia=vehicle.nominal.inertia,
        rate_gain=block.rate_gain,
        unload_above=math.inf if block.unload_above is None else block.unload_above,
        unload_below=block.unload_below,
        unload_rate=1.5 * settings.rate_deadband if block.unload_rate is None else block.unload_rate,
        settings=settings,
    )


def true_tanks(scenario: Scenario) -> tuple[Tanks, Array] | None:
    """Makes the true vehicle's tanks, and initial propellant in each, slug or kg; None: nothing is drawn from any."""
    vehicle, plant = scenario.vehicle_data, scenario.plant
    if not (vehicle.tanks and isinstance(plant, PlantBlock) and plant.depletion):
        return None
    fill = [plant.propellant.get(tank.name, tank.propellant) for tank in vehicle.tanks]
    return vehicle.tank_geometry, np.array(fill, dtype=float)


def wheel_torques(scenario: Scenario) -> Array:
    """Makes the prescribed torques of wheels, a row per sample, shape (n_samples, n_wheels)."""
    vehicle = scenario.vehicle_data
    names, period = [wheel.name for wheel in vehicle.wheels], vehicle.sample_period_s
    table = np.zeros((sample_count(scenario), len(names)))
    for pulse in scenario.wheel_schedule:
        first, last = (math.ceil(time / period - 1e-9) for time in (pulse.start_s, pulse.end_s))
        table[first:last, names.index(pulse.wheel)] = pulse.torque
    return table


def true_engines(scenario: Scenario) -> EnginesModel:
    """Makes the true engines, before their errors are drawn."""
    vehicle, plant = scenario.vehicle_data, scenario.plant
    assert isinstance(plant, PlantBlock)  # which alone has engines
    names = [engine.name for engine in vehicle.engines]
    errors = np.zeros((len(names), N_ERRORS))
    for name, stated in plant.engine_errors.items():
        errors[names.index(name)] = (*stated.thrust, *stated.direction, *stated.position)
    return EnginesModel(
        engines=engines(vehicle),
        errors=errors.ravel(),
        spread=plant.engine_dispersion * engine_sigmas(vehicle),
        failures=tuple(
            EngineFailure(names.index(one.engine), _ENGINE_FAILURES[one.kind], one.start_s, one.end_s or math.inf)
            for one in scenario.engine_failures
        ),
    )


def gimbal_control(scenario: Scenario) -> GimbalControl:
    """Makes the control of the rate by the engines' gimbals."""
    vehicle, bandwidth = scenario.vehicle_data, scenario.autopilot.gimbal_bandwidth
    return GimbalControl(engines(vehicle), vehicle.nominal, bandwidth, vehicle.sample_period_s)


_ENGINE_FAILURES = {"out": OUT, "level_stuck": 0, "gimbal_1_stuck": 1, "gimbal_2_stuck": 2}


def engine_commands(scenario: Scenario) -> Array:
    """Makes the engines' prescribed levels and angles, a row per sample, shape (n_samples, 3 n_engines)."""
    vehicle = scenario.vehicle_data
    names, period = [engine.name for engine in vehicle.engines], vehicle.sample_period_s
    table = np.zeros((sample_count(scenario), len(names), N_CHANNELS))
    for burn in scenario.engine_schedule:
        first, last = (math.ceil(time / period - 1e-9) for time in (burn.start_s, burn.end_s))
        table[first:last, names.index(burn.engine)] = (burn.level, *burn.gimbal)
    return table.reshape(len(table), -1)


def pieces(scenario: Scenario) -> int:
    """Returns the largest number of pieces of a sample, as true jets switch within it; 1: they do not."""
    if not scenario.open_loop:
        return 1 + most_edges(pulses(scenario))
    table, onset_s = commands(scenario)
    return 1 if onset_s is None else most_pieces(table, onset_s, scenario.vehicle_data.sample_period_s)


def sample_count(scenario: Scenario) -> int:
    """Counts the sample intervals of a run: the last sample is at or just before the end."""
    return math.floor(scenario.duration_s / scenario.vehicle_data.sample_period_s + 1e-9)


def jet_failures(scenario: Scenario) -> tuple[failures.Failure, ...]:
    """Makes the true failures of jets, with a leak as a level of its jet."""
    thrusts = thrust_factors(scenario) * np.array([jet.thrust for jet in scenario.vehicle_data.jets])
    return as_levels(stated_failures(scenario), thrusts)


def stated_failures(scenario: Scenario) -> tuple[failures.Failure, ...]:
    """Makes the true failures of jets, with the force of a leak as its amount, lbf or N."""
    vehicle, result = scenario.vehicle_data, []
    for number, entry in enumerate(scenario.failures):
        jet = vehicle.jet_index(entry.jet)
        result.append(
            failures.Failure(
                jet=jet,
                kind=failures.FailureKind[entry.kind.upper()],
                start_s=entry.start_s,
                end_s=math.inf if entry.end_s is None else entry.end_s,
                amount=_amount(entry),
                probability=entry.probability if isinstance(entry, Intermittent) else 0.0,
                stream=f"failure {number} of {entry.jet}",
            )
        )
    return tuple(result)


def _amount(entry: Failure) -> float:
    """Returns the amount of a `maths.vehicle.true_failures.Failure`; of a leak its force."""
    match entry:
        case Degraded():
            return entry.fraction
        case Leak():
            return entry.force
        case Intermittent():
            return entry.level
        case Drift():
            return entry.rate_per_s
        case _:
            return 0.0


def unit_wrenches(vehicle: Vehicle) -> Array:
    """Computes torque about the vehicle origin and force of a unit force along each jet, shape (n_jets, 6)."""
    return vehicle.wrenches / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]


def _manifolds(vehicle: Vehicle) -> NDArray[np.int_]:
    """Returns the index of each jet's manifold, -1 where it has none."""
    names = sorted({jet.manifold for jet in vehicle.jets if jet.manifold is not None})
    return np.array([-1 if jet.manifold is None else names.index(jet.manifold) for jet in vehicle.jets])


def jets(scenario: Scenario) -> KnownJets:
    """Makes the jets as a detector knows them."""
    vehicle = scenario.vehicle_data
    return KnownJets(
        period_s=vehicle.sample_period_s,
        clusters=np.array([jet.cluster for jet in vehicle.jets]),
        unit_wrenches=unit_wrenches(vehicle),
        thrusts=np.array([jet.thrust for jet in vehicle.jets]),
        manifolds=_manifolds(vehicle),
        limits=convergence_limits(scenario),
    )


def detector(scenario: Scenario) -> Detector | None:
    """Returns the detector that a scenario names; None: off, or one of the thesis without accelerometer."""
    if scenario.detector.kind == "off":
        return None
    if scenario.estimation.filter == "thesis" and not scenario.vehicle_data.accelerometers:
        return None
    return DETECTORS[scenario.detector.kind]


def closes_manifolds(scenario: Scenario) -> bool:
    """Tests whether a declared failure closes the jet's manifold; a matter of the detector's block."""
    return bool(getattr(scenario.detector, "close_manifold", False))


def detector_params(scenario: Scenario) -> Any:
    """Makes the parameters of the detector that the scenario names; None: there is none."""
    method = detector(scenario)
    if method is None:
        return None
    of_filter = (FILTERS[method.made_for].params(setup(scenario), scenario),) if method.made_for else ()
    options: Any = scenario.detector
    if isinstance(options, HypothesesBlock):
        options = scenario.faults.of_each_jet(scenario.vehicle_data.designations)
    return method.params(jets(scenario), options, *of_filter)
