"""Parameters of the true vehicle and its sensors, from a scenario's choices."""

from __future__ import annotations

import math

import numpy as np

from massprop_drake.inputs.onboard_blocks import SensorErrors
from massprop_drake.inputs.params import engine_sigmas, engines, plant_time_constants, thrust_factors, wheels
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.scheduled import Degraded, Drift, Failure, Intermittent, Leak, jump_terms
from massprop_drake.inputs.true_blocks import MultibodyBlock, PlantBlock
from massprop_drake.inputs.vehicle_sensors import (
    Accelerometer,
    PoseSensor,
    RocketEngine,
    SensorPackage,
    VelocitySensor,
    Wheel,
)
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties, Spread
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle import true_failures as failures
from massprop_drake.maths.vehicle.depletion import NO_TANKS, Tanks
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, decay_factor, draw_initial_deviation
from massprop_drake.maths.vehicle.engine_thrust import N_ERRORS
from massprop_drake.maths.vehicle.joint_moves import Move
from massprop_drake.maths.vehicle.mounting import true_mounted_wrenches
from massprop_drake.maths.vehicle.reaction_jets import make_jets, true_wrenches
from massprop_drake.maths.vehicle.rigid_body import (
    RATE,
    Jump,
    draw_true_body,
    initial_state,
    jumps_by_sample,
    pack_structure,
)
from massprop_drake.maths.vehicle.sensing import (
    Draws,
    SensorModel,
    Tone,
    TruePackage,
    add_drawn_phases,
    make_vibration,
    smoothing_factor,
)
from massprop_drake.maths.vehicle.tracking import PoseModel
from massprop_drake.maths.vehicle.true_engines import OUT, EngineFailure, EnginesModel
from massprop_drake.maths.vehicle.true_failures import leaks_as_levels
from massprop_drake.maths.vehicle.vehicle_cycle import NO_FILL, VehicleParams
from massprop_drake.maths.vehicle.wheel_motors import WheelsModel


def simulated_non_inertial(scenario: Scenario) -> tuple[PoseSensor | VelocitySensor | Wheel | RocketEngine, ...]:
    """Returns pose and velocity sensors, wheels and engines of a simulation: engines only where they burn."""
    vehicle = scenario.vehicle_data
    return tuple(sensor for sensor in vehicle.tracked if scenario.engine_schedule or sensor not in vehicle.engines)


def time_step(scenario: Scenario) -> float:
    """Returns the integration step of the true vehicle, s; zero: continuous."""
    step = scenario.plant.time_step if isinstance(scenario.plant, PlantBlock) else 0.0
    return scenario.vehicle_data.sample_period_s if step is None else step


def sensor_model(scenario: Scenario, sensor: SensorPackage) -> SensorModel:
    """Makes the true error model of a sensor package: vehicle quantum and noise, and the scenario's errors."""
    return add_drawn_phases(sensor_model_before_draws(scenario, sensor), sensor_draws(scenario, sensor), scenario.seed)


def sensor_model_before_draws(scenario: Scenario, sensor: SensorPackage) -> SensorModel:
    """Makes a sensor package's true error model before the seed draws quantizer and vibration phases."""
    period, errors = scenario.vehicle_data.sample_period_s, _errors_of(scenario, sensor)
    tones, integrates = _tones(errors), isinstance(sensor, Accelerometer)
    scale_factor = np.array(errors.scale_factor)
    shaking = make_vibration(tones, 1.0 + scale_factor, errors.bandwidth_hz, integrates=integrates) if tones else None
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
    """Returns which quantizer and vibration phases of a sensor package the seed draws."""
    errors = _errors_of(scenario, sensor)
    quantum = sensor.quantum if errors.quantum is None else errors.quantum
    marks = quantum > 0.0 and scenario.sensors.quantizer_phase == "seeded"
    return Draws(sensor.name, marks, _tones(errors), errors.bandwidth_hz)


def _errors_of(scenario: Scenario, sensor: SensorPackage) -> SensorErrors:
    """Returns the stated errors of a sensor package; without an entry, errors of zero."""
    nothing = SensorErrors(sensor=sensor.name)
    return next((entry for entry in scenario.sensors.errors if entry.sensor == sensor.name), nothing)


def _tones(errors: SensorErrors) -> tuple[Tone, ...]:
    """Makes the tones of a package's vibration, all with phase zero."""
    return tuple(Tone(entry.frequency_hz, np.array(entry.amplitude), np.zeros(3)) for entry in errors.vibration)


def vehicle_params(scenario: Scenario) -> VehicleParams:
    """Makes the parameters by which the true rigid vehicle steps: body, jets, failures, sensors, disturbance."""
    vehicle, properties = scenario.vehicle_data, true_properties(scenario)
    period = vehicle.sample_period_s
    body = initial_state(properties.mass)
    body[RATE] = np.array(scenario.plant.initial_rate)
    packages = tuple(
        TruePackage(
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
        jets=make_jets(plant_wrenches(scenario), plant_time_constants(scenario), period),
        failures=jet_failures(scenario),
        packages=packages,
        disturbance=disturbance(scenario),
        jumps=jumps_by_sample(mass_jumps(scenario), period),
        body=body,
        structure=pack_structure(properties),
        planar=vehicle.motion == "planar",
        tanks=tanks,
        fill=fill,
    )


def mass_jumps(scenario: Scenario) -> tuple[Jump, ...]:
    """Lists the payloads that are released or docked: time, s, signed mass and inertia, and position."""
    return tuple(Jump(jump.time_s, *jump_terms(jump)) for jump in scenario.jumps)


def joint_moves(plant: MultibodyBlock) -> dict[str, tuple[Move, ...]]:
    """Maps each driven joint to its moves in the order of time, to an empty tuple where it is only held."""
    moves = sorted(plant.moves, key=lambda move: move.start_s)
    driven = [start.joint for start in plant.joints if start.held] + [move.joint for move in moves]
    return {
        name: tuple(Move(one.start_s, one.end_s, one.position) for one in moves if one.joint == name)
        for name in dict.fromkeys(driven)
    }


def disturbance(scenario: Scenario) -> DisturbanceModel | None:
    """Makes the model of the true vehicle's disturbance torque and force; None: there is none."""
    block = scenario.plant.disturbance
    mean, std = np.array([*block.torque, *block.force]), np.array([*block.torque_std, *block.force_std])
    if not (mean.any() or std.any()):
        return None
    kept = decay_factor(block.correlation_time_s, scenario.vehicle_data.sample_period_s)
    return DisturbanceModel(mean, std, kept, draw_initial_deviation(scenario.seed, std))


def true_properties(scenario: Scenario) -> MassProperties:
    """Returns the true mass properties at the start, drawn if dispersed; the nominal ones if multibody."""
    spread, body = mass_spread(scenario), properties_before_draws(scenario)
    return body if spread is None else draw_true_body(scenario.seed, body, spread)


def mass_spread(scenario: Scenario) -> Spread | None:
    """Returns the 1-sigmas by which the true mass properties are drawn; None: they are not drawn."""
    spread = scenario.plant.dispersion.spread if isinstance(scenario.plant, PlantBlock) else None
    return spread if spread is not None and any(spread) else None


def properties_before_draws(scenario: Scenario) -> MassProperties:
    """Returns mass properties about which the true ones are drawn, or the true ones where nothing is drawn."""
    properties = scenario.plant.mass_properties if isinstance(scenario.plant, PlantBlock) else None
    return scenario.vehicle_data.nominal if properties is None else properties.properties()


def pose_model(scenario: Scenario, sensor: PoseSensor) -> PoseModel:
    """Makes the true model of a pose sensor: measured point, noise, outliers and reading rate."""
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
    nominal, errors = nominal_wrenches(scenario), mounting_errors(scenario)
    return true_mounted_wrenches(nominal, scenario.vehicle_data.positions, errors) if errors.any() else nominal


def mounting_errors(scenario: Scenario) -> Array:
    """Draws the true errors of each jet's mounting: two angles, rad, and two shifts, ft or m, shape (n_jets, 4)."""
    sigmas = scenario.plant.mounting_dispersion * np.repeat(scenario.vehicle_data.mounting_sigmas, 2, axis=1)
    drawn = normal_sample(scenario.seed, "mounting", 0, sigmas.size) if sigmas.any() else np.zeros(sigmas.size)
    return sigmas * drawn.reshape(sigmas.shape)


def plant_mass_flows(scenario: Scenario) -> Array:
    """Returns true mass flow of each jet at full thrust, slug/s or kg/s, shape (n_jets,); zero if none is used."""
    return plant_wrenches(scenario)[:, 6]


def nominal_wrenches(scenario: Scenario) -> Array:
    """Returns torque about the origin, force and mass flow of each jet at nominal thrust, shape (n_jets, 7)."""
    vehicle = scenario.vehicle_data
    depletes = isinstance(scenario.plant, PlantBlock) and scenario.plant.depletion
    flows = vehicle.mass_flows if depletes else np.zeros(len(vehicle.jets))
    return np.column_stack([vehicle.wrenches, flows])


def wheels_model(scenario: Scenario) -> WheelsModel:
    """Makes the model of the true reaction wheels, before their inertia errors are drawn."""
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


def true_tanks(scenario: Scenario) -> tuple[Tanks, Array] | None:
    """Returns geometry and initial propellant, slug or kg, of the true tanks; None: no firing empties them."""
    vehicle, plant = scenario.vehicle_data, scenario.plant
    if not (vehicle.tanks and isinstance(plant, PlantBlock) and plant.depletion):
        return None
    fill = [plant.propellant.get(tank.name, tank.propellant) for tank in vehicle.tanks]
    return vehicle.tank_geometry, np.array(fill, dtype=float)


def true_engines(scenario: Scenario) -> EnginesModel:
    """Makes the model of the true engines with stated errors and failures, before other errors are drawn."""
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


_ENGINE_FAILURES = {"out": OUT, "level_stuck": 0, "gimbal_1_stuck": 1, "gimbal_2_stuck": 2}


def jet_failures(scenario: Scenario) -> tuple[failures.Failure, ...]:
    """Makes the true failures of jets, a leak's force given as a level of its jet's true thrust."""
    thrusts = thrust_factors(scenario) * np.array([jet.thrust for jet in scenario.vehicle_data.jets])
    return leaks_as_levels(stated_failures(scenario), thrusts)


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
                amount=_failure_amount(entry),
                probability=entry.probability if isinstance(entry, Intermittent) else 0.0,
                stream=f"failure {number} of {entry.jet}",
            )
        )
    return tuple(result)


def _failure_amount(entry: Failure) -> float:
    """Returns the size of a failure: fraction of thrust, force of a leak, level or rate of a drift; else 0."""
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
