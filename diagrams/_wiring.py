"""Connections of estimators, wheels and engines that several diagrams share, and their exported outputs."""

from __future__ import annotations

from collections.abc import Container, Iterable

from pydrake.systems import framework
from pydrake.systems.framework import DiagramBuilder, System

from massprop_drake.inputs import params, pilot_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.systems.autopilot.engine_commands import EngineCommands
from massprop_drake.systems.autopilot.wheel_schedule import WheelSchedule

ONSETS = ("command_onset", "held_command_onset")  # ports beside those of commands, where jets open within a sample


class Diagram(framework.Diagram):  # type: ignore[misc]
    """Diagram with a description of itself."""

    def __init__(self, builder: DiagramBuilder, name: str):
        super().__init__()
        builder.BuildInto(self)
        self.set_name(name)

    def __repr__(self) -> str:
        parts = ", ".join(system.get_name() for system in self.GetSystems())
        return f"<Diagram '{self.get_name()}' of {parts}: {self.num_input_ports()} in, {self.num_output_ports()} out>"


def connect_estimation(
    builder: DiagramBuilder,
    vehicle: framework.Diagram,
    commander: System,
    estimation: framework.Diagram,
    scenario: Scenario,
) -> None:
    """Connects every sensor, and the command of the past interval, to the estimation's input ports."""
    seen = (sensor.name for sensor in scenario.vehicle_data.tracked)
    for name in (*scenario.vehicle_data.sensor_names(), *seen):
        if estimation.HasInputPort(name) and vehicle.HasOutputPort(name):  # engines that never burn are not there
            builder.Connect(vehicle.GetOutputPort(name), estimation.GetInputPort(name))
    builder.Connect(commander.GetOutputPort("held_command"), estimation.GetInputPort("jet_commands"))
    if commander.HasOutputPort("held_command_onset") and estimation.HasInputPort("held_command_onset"):
        builder.Connect(commander.GetOutputPort("held_command_onset"), estimation.GetInputPort("held_command_onset"))


def connect_wheels(
    builder: DiagramBuilder, vehicle: framework.Diagram, commander: System, scenario: Scenario
) -> list[System]:
    """Connects wheels to the autopilot's or prescribed torques; returns systems added that play them back."""
    if not scenario.vehicle_data.wheels:
        return []
    if commander.HasOutputPort("wheel_torque"):
        builder.Connect(commander.GetOutputPort("wheel_torque"), vehicle.GetInputPort("wheel_torque"))
        for wheel in scenario.vehicle_data.wheels:
            builder.Connect(vehicle.GetOutputPort(wheel.name), commander.GetInputPort(wheel.name))
        return []
    torques, period_s = pilot_params.wheel_torques(scenario), scenario.vehicle_data.sample_period_s
    schedule = builder.AddSystem(WheelSchedule(torques, period_s=period_s))
    builder.Connect(schedule.get_output_port(), vehicle.GetInputPort("wheel_torque"))
    return [schedule]


def connect_engine_commands(builder: DiagramBuilder, vehicle: framework.Diagram, scenario: Scenario) -> list[System]:
    """Connects engines to systems that command them; returns these systems, empty where no engine burns."""
    if not scenario.engine_schedule:
        return []
    control = pilot_params.gimbal_control(scenario)
    commands = builder.AddSystem(EngineCommands(pilot_params.engine_commands(scenario), control))
    builder.Connect(commands.get_output_port(), vehicle.GetInputPort("engine_command"))
    if control.bandwidth > 0.0:
        builder.Connect(vehicle.GetOutputPort(params.gyro(scenario).name), commands.GetInputPort("gyro"))
    return [commands]


def export_outputs(builder: DiagramBuilder, systems: Iterable[System], *, but: Container[str] = ()) -> None:
    """Exports every output port of some systems under its own name, except those listed."""
    for system in systems:
        for index in range(system.num_output_ports()):
            port = system.get_output_port(index)
            if port.get_name() not in but:
                builder.ExportOutput(port, port.get_name())
