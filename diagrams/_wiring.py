"""Wiring that several diagrams share."""

from __future__ import annotations

from collections.abc import Iterable

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from massprop_drake.inputs.scenario import Scenario


def connect_estimation(
    builder: DiagramBuilder, vehicle: Diagram, commander: System, estimation: Diagram, scenario: Scenario
) -> None:
    """Feeds the estimators with every sensor, and with the command of the interval that ended."""
    for name in scenario.vehicle_data.sensor_names():
        if estimation.HasInputPort(name):
            builder.Connect(vehicle.GetOutputPort(name), estimation.GetInputPort(name))
    builder.Connect(commander.GetOutputPort("held_command"), estimation.GetInputPort("jet_commands"))


def export_outputs(builder: DiagramBuilder, systems: Iterable[System]) -> None:
    """Exports every output port of some systems under its own name."""
    for system in systems:
        for index in range(system.num_output_ports()):
            port = system.get_output_port(index)
            builder.ExportOutput(port, port.get_name())
