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
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_fields import STANDARD_GRAVITY
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import (
    Accelerometer,
    Gyro,
    PoseSensor,
    RocketEngine,
    SensorPackage,
    VelocitySensor,
    Wheel,
)
from massprop_drake.maths.estimation.cycle import EstimationParams
from massprop_drake.maths.estimation.detector import Detector, KnownJets
from massprop_drake.maths.estimation.detectors import DETECTORS
from massprop_drake.maths.estimation.filter import Instruments, Setup, ThrustModel
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.filters.mass_filter import MassParams
from massprop_drake.maths.estimation.filters.registry import FILTERS
from massprop_drake.maths.estimation.filters.thesis import ThesisParams
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE, DisturbanceParams
from massprop_drake.maths.estimation.joint.layout import EVERY_PERIOD, AttitudeSensors, Rates
from massprop_drake.maths.estimation.joint.modes import ModeParams
from massprop_drake.maths.estimation.joint.tanks import TankParams
from massprop_drake.maths.estimation.joint.wheels import WheelParams
from massprop_drake.maths.estimation.pose import setting as pose_setting
from massprop_drake.maths.estimation.pose.setting import Around, Tracking, Valves
from massprop_drake.maths.linear_algebra import Array, normals
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL, NAMES, initial_standard_deviation
from massprop_drake.maths.vehicle.engine_thrust import NO_ENGINES, EngineParams
from massprop_drake.maths.vehicle.mounting import mounting_errors
from massprop_drake.maths.vehicle.on_times import level_onsets, max_pieces, pulse_shares
from massprop_drake.maths.vehicle.reaction_jets import draw_thrust_factors
from massprop_drake.maths.vehicle.thrust import lag_factors

_WHOLE = 1e-6  # of a step: rounding of rates


def initial_estimate(scenario: Scenario) -> Array:
    """Returns the ten parameters that the filters start from, shape (10,)."""
    estimation, nominal = scenario.estimation, scenario.vehicle_data.nominal
    if estimation.start == "zero":
        return np.zeros(10)
    stated = None if estimation.given is None else estimation.given.mass_properties
    return (nominal if stated is None else stated.properties()).vector()


def initial_covariance(scenario: Scenario) -> Array:
    """Returns the covariance of the ten parameters at the start, shape (10, 10)."""
    return scenario.estimation.initial_covariance(scenario.vehicle_data)


def filter_setup(scenario: Scenario) -> Setup:
    """Collects the sensors, start, thrust model and wheels, engines, tanks that a filter is set up from."""
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
        trackers=_make_attitude_sensors(scenario),
        disturbance=stated_disturbance(scenario),
        opens_at=vehicle.opens_at,
        wheels=wheels(vehicle),
        wheel_uncertainty=np.array([wheel.inertia_uncertainty for wheel in vehicle.wheels]),
        engines=engines(vehicle),
        engine_sigmas=engine_sigmas(vehicle),
        rates=filter_step_rates(scenario),
        tanks=tanks(vehicle),
        modes=modes(vehicle),
        tracking=tracking(scenario) if scenario.estimation.filter == "pose" else None,
    )


def filter_step_rates(scenario: Scenario) -> Rates:
    """Returns the most steps of the joint filter in a sample period, and that period, zero where it is one step."""
    vehicle = scenario.vehicle_data
    if not steps_by_readings(scenario):
        return EVERY_PERIOD
    per_s = scenario.estimation.readings_per_s or vehicle.readings_per_s
    return Rates(vehicle.sample_period_s, max(math.ceil(per_s * vehicle.sample_period_s - _WHOLE), 1))


def steps_by_readings(scenario: Scenario) -> bool:
    """Tests whether the joint filter takes a step whenever anything is read, and not once a sample period."""
    stated = scenario.estimation.readings_per_s is not None or scenario.vehicle_data.has_own_rates
    return stated and scenario.estimation.filter == "joint"


def stated_disturbance(scenario: Scenario) -> DisturbanceParams:
    """Makes the Gauss-Markov model of the disturbance that a vehicle states, as accelerations at nominal mass."""
    vehicle = scenario.vehicle_data
    if vehicle.disturbance is None:
        return NO_DISTURBANCE
    sigmas = disturbance_sigmas(vehicle)
    accelerations = np.zeros((6, 6))
    accelerations[:3, :3] = np.linalg.inv(np.array(vehicle.mass_properties.inertia))
    accelerations[3:, 3:] = np.eye(3) / vehicle.nominal.mass
    scaled = np.ascontiguousarray((accelerations * sigmas)[:, sigmas > 0.0])
    return DisturbanceParams(scaled, vehicle.disturbance.time_constant_s)


def modes(vehicle: Vehicle) -> ModeParams:
    """Makes the joint filter's parameters of the modes of sloshing masses, panels and the like in a vehicle."""
    nominal = vehicle.nominal
    known = nominal.mass, nominal.center_of_mass, nominal.inertia
    return mode_params(vehicle.moving, known, vehicle.wrenches, vehicle.rms_arm)


def disturbance_sigmas(vehicle: Vehicle) -> Array:
    """Returns 1-sigma of a disturbance's torque and force, zero where none acts or no sensor shows it, shape (6,)."""
    stated = vehicle.disturbance
    if stated is None:
        return np.zeros(6)
    force = stated.force_std if vehicle.accelerometers else (0.0, 0.0, 0.0)
    return np.array((*stated.torque_std, *force))


def tracking(scenario: Scenario) -> Tracking:
    """Collects the pose filter's data of a vehicle tracked in a fixed frame: valves, surroundings, pose sensors."""
    vehicle = scenario.vehicle_data
    kinds, surroundings = list(vehicle.jet_kinds.values()), vehicle.surroundings
    poses, speeds = vehicle.poses, vehicle.velocities

    def by_kind(key: str) -> Array:
        """Values of one property of all jet kinds, shape (n_kinds,)."""
        return np.array([getattr(kind, key) for kind in kinds], dtype=float)

    def by_pose_sensor(key: str) -> Array:
        """1-sigmas of one measurement by pose sensor, infinite where not measured."""
        return np.array([math.inf if getattr(pose, key) is None else getattr(pose, key) for pose in poses])

    estimation = scenario.estimation
    is_stated = vehicle.mass_std is not None and estimation.start == "nominal" and estimation.std_fraction is None
    covariance = initial_covariance(scenario)
    relative = float(np.sqrt(covariance[MASS_RECIPROCAL, MASS_RECIPROCAL])) * vehicle.nominal.mass
    return Tracking(
        positions=vehicle.positions,
        forces=vehicle.thrusts,
        valves=Valves(
            delays_s=by_kind("command_delay_s"),
            delay_stds_s=by_kind("command_delay_std_s"),
            lags_s=by_kind("time_constant_s"),
            lag_stds=by_kind("lag_uncertainty"),
            openings_s=by_kind("opening_delay_s"),
            opening_stds_s=by_kind("opening_delay_std_s"),
            pulse_scatters=by_kind("pulse_scatter"),
        ),
        around=Around(**{name: getattr(surroundings, name) for name in Around._fields}),
        mass_std=(vehicle.mass_std or 0.0) / vehicle.nominal.mass if is_stated else relative,
        common_std=vehicle.common_scale_uncertainty,
        common_walk=vehicle.common_scale_walk,
        planar=vehicle.motion == "planar",
        fixed=np.isin(NAMES, vehicle.fixed),
        position_stds=by_pose_sensor("position_std"),
        attitude_stds=by_pose_sensor("attitude_std"),
        time_stds_s=np.array([pose.time_std_s for pose in poses]),
        outliers=max((pose.outliers for pose in poses), default=0.0),
        points=np.array([pose.point for pose in poses]).reshape(-1, 3),
        point_stds=np.array([pose.point_std for pose in poses]),
        velocity_positions=np.array([speed.position for speed in speeds]).reshape(-1, 3),
        velocity_stds=np.array([speed.noise_std for speed in speeds]),
    )


def known_parameters(scenario: Scenario) -> NDArray[np.bool_]:
    """Flags mass properties that are not estimated, as fixed or of no effect in a plane, shape (10,)."""
    if scenario.estimation.filter != "pose":
        return np.zeros(10, dtype=bool)
    return pose_setting.known_parameters(tracking(scenario))


def _instruments(packages: Sequence[SensorPackage]) -> Instruments:
    """Collects quantum, noise and bias 1-sigma of sensor packages, each of shape (n,)."""
    quanta, noise, biases = ([getattr(p, key) for p in packages] for key in ("quantum", "noise_std", "bias_std"))
    return Instruments(np.array(quanta), np.array(noise), np.array(biases))


def thrust_model(scenario: Scenario) -> ThrustModel:
    """Makes a filter's thrust model: jet wrenches, flows and lags, with the 1-sigma of their errors."""
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
        mounting=mounting_errors(vehicle.wrenches, vehicle.positions, vehicle.mounting_sigmas),
    )


def thesis_params(scenario: Scenario) -> ThesisParams:
    """Makes the parameters of the thesis's two filters, for rotation and for mass."""
    return thesis.make_params(filter_setup(scenario), scenario)


def mass_params(scenario: Scenario) -> MassParams:
    """Makes the parameters of the thesis's mass filter, for a vehicle with an accelerometer."""
    mass = thesis_params(scenario).mass
    assert mass is not None
    return mass


def estimation_params(scenario: Scenario) -> EstimationParams:
    """Makes the parameters of an estimation cycle: those of the filter and the detector that the scenario names."""
    vehicle = scenario.vehicle_data
    filter_ = FILTERS[scenario.estimation.filter]
    return EstimationParams(
        period_s=vehicle.sample_period_s,
        impulse_per_level=vehicle.wrenches * vehicle.sample_period_s,
        lag=lag_factors(estimator_time_constants(scenario), vehicle.sample_period_s),
        filter=filter_,
        filter_params=filter_.params(filter_setup(scenario), scenario),
        detector=detector(scenario),
        detector_params=detector_params(scenario),
        limits=convergence_limits(scenario),
    )


def convergence_limits(scenario: Scenario) -> Array:
    """Returns 1-sigmas of convergence, shape (3,): inverse inertia (relative), center of mass, 1/m (relative)."""
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
    """Returns the attitude sensors that the joint filter reads; empty with the pose filter."""
    return () if scenario.estimation.filter == "pose" else scenario.vehicle_data.poses


def non_inertial_sensors(scenario: Scenario) -> tuple[PoseSensor | VelocitySensor | Wheel | RocketEngine, ...]:
    """Returns the pose and velocity sensors, wheels and engines that the filter reads."""
    vehicle = scenario.vehicle_data
    return (
        vehicle.tracked if scenario.estimation.filter == "pose" else (*vehicle.poses, *vehicle.wheels, *vehicle.engines)
    )


def _make_attitude_sensors(scenario: Scenario) -> AttitudeSensors:
    """Makes the joint filter's parameters of attitude sensors: variances of attitude and stamp, outlier share."""
    sensors = trackers(scenario)
    rows = ((sensor.attitude_std or math.inf, sensor.time_std_s, sensor.outliers) for sensor in sensors)
    attitude_std, time_std_s, outliers = np.array(list(rows)).reshape(-1, 3).T
    return AttitudeSensors(attitude_std**2, time_std_s**2, outliers.copy())


def vector_sensor_names(scenario: Scenario) -> list[str]:
    """Returns names of the three-component sensors that a filter reads: gyros, accelerometers, trackers."""
    packages: tuple[SensorPackage | PoseSensor, ...] = (*gyros(scenario), *accelerometers(scenario))
    return [sensor.name for sensor in (*packages, *trackers(scenario))]


def mass_is_observable(scenario: Scenario) -> bool:
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
    """Computes the impulse of a 1-sigma thrust error of each jet, shape (n_jets, 6); None where thrust is known.

    It is that of full level over a sample, about the vehicle origin.
    """
    uncertainty, vehicle = scenario.estimation.thrust_uncertainty, scenario.vehicle_data
    return uncertainty * vehicle.wrenches * vehicle.sample_period_s if uncertainty > 0.0 else None


def thrust_factors(scenario: Scenario) -> Array:
    """Returns the drawn ratio of true to nominal thrust of each jet, shape (n_jets,)."""
    return draw_thrust_factors(scenario.seed, scenario.plant.thrust_dispersion, len(scenario.vehicle_data.jets))


def selectable_jets(scenario: Scenario) -> NDArray[np.bool_]:
    """Flags the jets that the autopilot may use, by their kind, shape (n_jets,)."""
    kinds, vehicle = scenario.autopilot.jet_kinds, scenario.vehicle_data
    if kinds is None:
        kinds = ("primary",) if "primary" in vehicle.jet_kinds else tuple(vehicle.jet_kinds)
    return np.array([jet.kind in kinds for jet in vehicle.jets])


def scheduled_jet_commands(scenario: Scenario) -> tuple[Array, Array | None]:
    """Makes the prescribed commands of each jet at each sample and their onsets, see `maths.vehicle.on_times`.

    Of a vehicle without on-times a pulse is on at t_k with start <= t_k < end, to within a billionth of the sample
    period. There are no onsets (None) where all jets switch with samples. Both tables are of shape (n_samples, n_jets).
    """
    vehicle, count = scenario.vehicle_data, sample_count(scenario)
    period = vehicle.sample_period_s
    table = np.zeros((count, len(vehicle.jets)))
    onset_s = level_onsets(table.shape)
    for pulse in scenario.jet_schedule:
        jet = vehicle.jet_index(pulse.jet)
        if vehicle.has_on_times:
            for sample, since_s, fraction in pulse_shares(pulse.start_s, pulse.end_s, period, count):
                table[sample, jet], onset_s[sample, jet] = fraction, since_s
        else:
            first, last = (math.ceil(time / period - 1e-9) for time in (pulse.start_s, pulse.end_s))
            table[first:last, jet] = 1.0
    return table, onset_s if max_pieces(table, onset_s, period) > 1 else None


def sample_count(scenario: Scenario) -> int:
    """Counts the sample intervals of a run: the last sample is at or just before the end."""
    return math.floor(scenario.duration_s / scenario.vehicle_data.sample_period_s + 1e-9)


def unit_wrenches(vehicle: Vehicle) -> Array:
    """Computes torque about the vehicle origin and force of a unit force along each jet, shape (n_jets, 6)."""
    return vehicle.wrenches / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]


def known_jets(scenario: Scenario) -> KnownJets:
    """Makes the jet parameters that a detector uses: clusters, manifolds, thrusts and unit wrenches."""
    vehicle = scenario.vehicle_data
    manifolds = sorted({jet.manifold for jet in vehicle.jets if jet.manifold is not None})
    return KnownJets(
        period_s=vehicle.sample_period_s,
        clusters=np.array([jet.cluster for jet in vehicle.jets]),
        unit_wrenches=unit_wrenches(vehicle),
        thrusts=np.array([jet.thrust for jet in vehicle.jets]),
        manifolds=np.array([-1 if jet.manifold is None else manifolds.index(jet.manifold) for jet in vehicle.jets]),
        limits=convergence_limits(scenario),
    )


def detector(scenario: Scenario) -> Detector | None:
    """Returns the detector that a scenario names; None: it is off, or of the thesis without accelerometer."""
    if scenario.detector.kind == "off":
        return None
    if scenario.estimation.filter == "thesis" and not scenario.vehicle_data.accelerometers:
        return None
    return DETECTORS[scenario.detector.kind]


def detector_params(scenario: Scenario) -> Any:
    """Makes the parameters of the detector that the scenario names; None: there is none."""
    method = detector(scenario)
    if method is None:
        return None
    of_filter = (FILTERS[method.made_for].params(filter_setup(scenario), scenario),) if method.made_for else ()
    options: Any = scenario.detector
    if isinstance(options, HypothesesBlock):
        options = scenario.faults.of_each_jet(scenario.vehicle_data.designations)
    return method.params(known_jets(scenario), options, *of_filter)


# ----------------------------------------------------------- wheels, engines and tanks as they are stated


def wheels(vehicle: Vehicle) -> WheelParams:
    """Makes the parameters of the reaction wheels as the vehicle states them, with exact inertia."""
    axes = np.array([wheel.axis for wheel in vehicle.wheels]).reshape(-1, 3)
    return WheelParams(
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        inertias=np.array([wheel.inertia for wheel in vehicle.wheels]),
        sigma=0.0,
        speed_std=np.array([wheel.speed_std for wheel in vehicle.wheels]),
        most=np.array([wheel.most_acceleration for wheel in vehicle.wheels]),
    )


def engines(vehicle: Vehicle) -> EngineParams:
    """Makes the parameters of the rocket engines as the vehicle states them, without errors."""
    stated = vehicle.engines
    if not stated:
        return NO_ENGINES
    directions = np.array([engine.direction for engine in stated])
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    across = normals(directions)
    axes = across.copy()
    for index, engine in enumerate(stated):
        if engine.gimbal is not None:
            axes[index] = np.array(engine.gimbal.axes)
            across[index] = normals(directions[[index]], axes[[index], 0])[0]
    axes = axes / np.linalg.norm(axes, axis=2, keepdims=True)
    levels = np.unique([0.0, 1.0, *(level for engine in stated for level, _ in engine.impulses)])
    throttle = np.array([(one.level_rate, one.level_time_constant_s, 1.0, one.level_noise_std) for one in stated])
    fixed = (1.0, 0.0, 0.0, 0.0)
    of_gimbals = np.array(
        [fixed if g is None else (g.rate, g.time_constant_s, g.stop, g.noise_std) for g in (e.gimbal for e in stated)]
    )
    rates, constants_s, stops, read_std = np.stack((throttle, of_gimbals, of_gimbals), axis=2).transpose(1, 0, 2)
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
    """Computes an engine's propellant flow at some throttle levels, slug/s or kg/s, shape (k,)."""
    stated_levels, impulses = np.array(engine.impulses).T
    return np.asarray(engine.thrust * levels / (gravity * np.interp(levels, stated_levels, impulses)))


def engine_sigmas(vehicle: Vehicle) -> Array:
    """Returns 1-sigma of each engine's errors: two each of thrust, direction and position, shape (6 n,)."""
    return np.array(
        [
            sigma
            for engine in vehicle.engines
            for sigma in (engine.thrust_uncertainty, engine.direction_std, engine.position_std)
            for _ in range(2)
        ]
    )


def tanks(vehicle: Vehicle) -> TankParams:
    """Makes the parameters of the tanks that jets empty: geometry, capacity, propellant and 1-sigmas."""
    stated, geometry = vehicle.tanks, vehicle.tank_geometry

    def by_tank(key: str) -> Array:
        """Values of one property of all tanks, shape (n_tanks,)."""
        return np.array([getattr(tank, key) for tank in stated], dtype=float)

    sigmas = by_tank("propellant_std"), by_tank("flow_uncertainty")
    return TankParams(*geometry, by_tank("capacity"), by_tank("propellant"), *sigmas)
