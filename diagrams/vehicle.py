"""The vehicle: jets, rigid body and sensors. The only place that knows the truth.

command ------> reaction_jets --wrench--> rigid_body --body_state--> gyros, accelerometers --> readings
held_command -->                                          noise_source --noise-->

A disturbance, where there is one, stands between jets and body, and has its noise from the same source. All chance is
that of the scenario's seed, until `SetRandomContext` draws `noise_seed`, a parameter of the context: noise and
intermittent failures in the course of a run, and before it the true thrusts, the phases of quantizers and vibration,
the disturbance's start and, with `plant.dispersion`, the mass properties. A diagram in which nothing is drawn has no
`noise_seed`.

Each part has its numbers as named parameters of the context, see `parameters` of its system. The diagram is one for
every scalar type of Drake where all of its parts are. `Linearize` asks for state of one kind and group, so for thrust
without lag and sensors without memory; `systems.linearization.linearized` takes the others, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from massprop_drake.diagrams._wiring import ONSETS, Diagram, export_outputs
from massprop_drake.inputs import params, pilot_params, true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_sensors import Accelerometer, PoseSensor, SensorPackage, VelocitySensor
from massprop_drake.systems.vehicle.disturbance_source import Disturbance
from massprop_drake.systems.vehicle.engines import Engines
from massprop_drake.systems.vehicle.integrating_accelerometer import IntegratingAccelerometer
from massprop_drake.systems.vehicle.noise_source import NoiseSource, noise_seed
from massprop_drake.systems.vehicle.rate_gyro import RateGyro
from massprop_drake.systems.vehicle.reaction_jets_system import ReactionJets
from massprop_drake.systems.vehicle.reaction_wheels import ReactionWheels
from massprop_drake.systems.vehicle.rigid_body_plant import RigidBodyPlant
from massprop_drake.systems.vehicle.trackers import PoseTracker, VelocityTracker


def build(scenario: Scenario, body: System | None = None, trackers: Sequence[System] = ()) -> Diagram:
    """Builds the Drake diagram of a scenario's vehicle: from commands to motion of the body and readings.

    Args:
        scenario: with the vehicle.
        body: in place of that of the scenario, with the ports of a continuous `RigidBodyPlant`; other ports that it
            has are exported under their names.
        trackers: besides those of the vehicle.

    Ports:
        command (in, n_jets), held_command (in, n_jets): see `ReactionJets`.
        command_onset (in, n_jets), held_command_onset (in, n_jets): see `ReactionJets`; where they open within samples.
        closed (in, n_jets), held_closed (in, n_jets): see `ReactionJets`; may stay unconnected.
        <gyro> (out, 3): measured rate, rad/s, body axes, for each package.
        <accelerometer> (out, 3): integrated specific force, ft/s or m/s, body axes, for each package.
        <pose> (out, 7), <velocity> (out, 3): see `PoseTracker` and `VelocityTracker`, for each sensor in a fixed frame.
        wheel_torque (in, n), wheel_speeds (out, n), <wheel> (out, 1): see `ReactionWheels`; of a vehicle that has them.
        engine_command (in, 3 n), engine_state (out, 3 n), <engine> (out, 1 or 3): see `Engines`; where they burn.
        body_state (out, 23), structure (out, 9), mass_properties (out, 10): the truth, see
            `RigidBodyPlant`.
        propellant (out, n_tanks): in each tank, see `RigidBodyPlant`; of a vehicle that has them.
        thrust (out, n_jets): mean force over the coming sample, see `ReactionJets`.
        joint_positions (out, n): of a multibody plant that has joints, see `MultibodyVehicle`.
    """
    vehicle, tanks = scenario.vehicle_data, true_params.true_tanks(scenario)
    pieces = pilot_params.max_pieces_per_sample(scenario)
    period = vehicle.sample_period_s
    builder = DiagramBuilder()

    jets = builder.AddNamedSystem(
        "reaction_jets",
        ReactionJets(
            wrenches=true_params.mounted_wrenches(scenario),
            time_constants_s=params.plant_time_constants(scenario),
            period_s=period,
            dispersion=scenario.plant.thrust_dispersion,
            failures=true_params.stated_failures(scenario),
            thrusts=np.array([jet.thrust for jet in vehicle.jets]),
            planar=vehicle.motion == "planar",
            pieces=pieces,
            feeds=None if tanks is None else tanks[0].feeds,
            seed=scenario.seed,
            compiled=scenario.execution.compiled,
        ),
    )
    body = builder.AddSystem(_make_body(scenario, jets.lag_time_constants_s, pieces) if body is None else body)
    stepped = true_params.time_step(scenario) != 0.0
    wrench = "wrench_profile" if stepped else "wrench"
    pushed = _add_other_forces(builder, scenario, jets, body, pieces if stepped else 1)
    if jets.HasOutputPort("drained") and body.HasInputPort("drained"):
        builder.Connect(jets.GetOutputPort("drained"), body.GetInputPort("drained"))
    if vehicle.motion == "planar":
        builder.Connect(body.GetOutputPort("structure"), jets.GetInputPort("structure"))
    for name in ("command", "held_command", *(ONSETS if pieces > 1 else ()), "closed", "held_closed"):
        builder.ExportInput(jets.GetInputPort(name), name)

    sensors: list[System] = []
    for package in vehicle.sensors:
        sensor = builder.AddNamedSystem(package.name, _make_sensor(package, scenario))
        builder.Connect(body.GetOutputPort("body_state"), sensor.GetInputPort("body_state"))
        builder.ExportOutput(sensor.GetOutputPort("reading"), package.name)
        sensors.append(sensor)

    if vehicle.wheels:
        model, names = true_params.wheels_model(scenario), tuple(wheel.name for wheel in vehicle.wheels)
        wheels = ReactionWheels(model, names, period_s=period, stepped=stepped, seed=scenario.seed)
        builder.AddSystem(wheels)
        builder.Connect(wheels.GetOutputPort("wheels"), body.GetInputPort("wheels"))
        builder.ExportInput(wheels.GetInputPort("wheel_torque"), "wheel_torque")
        for name in ("wheel_speeds", *names):
            builder.ExportOutput(wheels.GetOutputPort(name), name)
        sensors.append(wheels)

    followed: tuple[PoseSensor | VelocitySensor, ...] = (*vehicle.poses, *vehicle.velocities)
    for tracker in (*(_make_tracker(seen, scenario) for seen in followed), *trackers):
        builder.AddSystem(tracker)
        for name in ("body_state", "structure"):
            builder.Connect(body.GetOutputPort(name), tracker.GetInputPort(name))
        builder.ExportOutput(tracker.GetOutputPort("reading"), tracker.get_name())
        sensors.append(tracker)

    _connect_noise_and_seed(builder, scenario, jets, [*pushed, *sensors, body])
    for port in map(body.get_input_port, range(body.num_input_ports())):
        if port.get_name() not in (wrench, "seed", "wheels", "drained"):
            builder.ExportInput(port, port.get_name())
    export_outputs(builder, [body])
    builder.ExportOutput(jets.GetOutputPort("thrust"), "thrust")
    return Diagram(builder, "vehicle")


def _add_other_forces(
    builder: DiagramBuilder, scenario: Scenario, jets: System, body: System, pieces: int
) -> list[System]:
    """Adds engines and a disturbance between jets and body; returns the systems added.

    Args:
        builder: of the diagram.
        scenario: with the vehicle.
        jets: see `ReactionJets`.
        body: see `build`.
        pieces: of the jets' profile that the body gets.
    """
    vehicle, stepped = scenario.vehicle_data, true_params.time_step(scenario) != 0.0
    wrench = "wrench_profile" if stepped else "wrench"
    how: dict[str, Any] = {
        "period_s": vehicle.sample_period_s,
        "stepped": stepped,
        "n_lags": len(jets.lag_time_constants_s) if stepped else 0,
        "pieces": pieces,
        "seed": scenario.seed,
    }
    pushed, acting = list[System](), jets.GetOutputPort(wrench)
    if scenario.engine_schedule:  # a vehicle whose engines never burn flies without them
        names = tuple(engine.name for engine in vehicle.engines)
        engines = builder.AddSystem(Engines(true_params.true_engines(scenario), names, **how))
        builder.ExportInput(engines.GetInputPort("engine_command"), "engine_command")
        for name in ("engine_state", *names):
            builder.ExportOutput(engines.GetOutputPort(name), name)
        pushed.append(engines)
    model = true_params.disturbance(scenario)
    if model is not None:
        disturbance = builder.AddSystem(Disturbance(model, **how))
        builder.Connect(body.GetOutputPort("structure"), disturbance.GetInputPort("structure"))
        pushed.append(disturbance)
    for system in pushed:
        builder.Connect(acting, system.GetInputPort("jets"))
        acting = system.GetOutputPort("wrench")
    builder.Connect(acting, body.GetInputPort(wrench))
    return pushed


def _connect_noise_and_seed(builder: DiagramBuilder, scenario: Scenario, jets: System, others: list[System]) -> None:
    """Connects the noise source to noisy systems, and the seed's port to those that draw random numbers."""
    quiet = {
        one.name
        for one in scenario.vehicle_data.sensors
        if not true_params.sensor_model_before_draws(scenario, one).noisy
    }
    noisy = [system for system in others if system.get_name() not in quiet and system.HasInputPort("noise")]
    drawn = [system for system in others if system.HasInputPort("seed")]
    if scenario.plant.thrust_dispersion or any(failure.kind == "intermittent" for failure in scenario.failures):
        drawn.append(jets)
    if noisy:
        streams = {system.get_name(): system.GetInputPort("noise").size() for system in noisy}
        source = NoiseSource(scenario.seed, period_s=scenario.vehicle_data.sample_period_s, streams=streams)
        noise = builder.AddNamedSystem("noise_source", source)
        for system in noisy:
            builder.Connect(noise.GetOutputPort(system.get_name()), system.GetInputPort("noise"))
        drawn.append(noise)
    if drawn:
        seed = builder.AddSystem(noise_seed())
        for system in drawn:
            builder.Connect(seed.get_output_port(), system.GetInputPort("seed"))


def _make_body(scenario: Scenario, lag_time_constants_s: tuple[float, ...], pieces: int) -> System:
    """Makes the system of the body that a scenario flies, rigid or multibody; lags and pieces: of its jets."""
    if not isinstance(scenario.plant, PlantBlock):
        from massprop_drake.diagrams import multibody_body  # noqa: PLC0415 (loads Drake's multibody library)

        return multibody_body.build_body(scenario.plant, wheels=bool(scenario.vehicle_data.wheels))
    return RigidBodyPlant(
        true_params.properties_before_draws(scenario),
        time_step=true_params.time_step(scenario),
        lag_time_constants_s=lag_time_constants_s,
        pieces=pieces,
        initial_rate=np.array(scenario.plant.initial_rate),
        jumps=true_params.mass_jumps(scenario),
        period_s=scenario.vehicle_data.sample_period_s,
        spread=true_params.mass_spread(scenario),
        seed=scenario.seed,
        wheels=bool(scenario.vehicle_data.wheels),
        tanks=true_params.true_tanks(scenario),
        compiled=scenario.execution.compiled,
    )


def _make_tracker(sensor: PoseSensor | VelocitySensor, scenario: Scenario) -> System:
    if isinstance(sensor, PoseSensor):
        return PoseTracker(sensor.name, true_params.pose_model(scenario, sensor))
    return VelocityTracker(sensor.name, position=np.array(sensor.position), noise_std=sensor.noise_std)


def _make_sensor(package: SensorPackage, scenario: Scenario) -> System:
    """Makes the system of a gyro or accelerometer package, with the errors that the scenario states."""
    model, draws = true_params.sensor_model_before_draws(scenario, package), true_params.sensor_draws(scenario, package)
    chance: dict[str, Any] = {"seed": scenario.seed, "compiled": scenario.execution.compiled}
    if draws.marks or draws.tones:
        chance["draws"] = draws
    if isinstance(package, Accelerometer):
        return IntegratingAccelerometer(package.name, model, position=np.array(package.position), **chance)
    return RateGyro(package.name, model, **chance)
