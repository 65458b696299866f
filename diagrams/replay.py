"""The replay: recorded telemetry and the estimators, with no simulated vehicle.

telemetry_source --sensors, jet_commands, outside_wrench--> estimation --> estimate
"""

from __future__ import annotations

from pydrake.systems.framework import DiagramBuilder

from massprop_drake.diagrams import estimation
from massprop_drake.diagrams._wiring import ONSETS, Diagram, export_outputs
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.systems.estimation.telemetry_source import TelemetrySource


def build(scenario: Scenario, *, first_row: int = 0, findings: bool = False) -> Diagram:
    """Builds the replay Drake diagram of a scenario: the `estimation` diagram, fed by rows of a record.

    Ports: none in; out every output of the `estimation` diagram and of `TelemetrySource`, by the same
    names. Times in reports and findings are those of the diagram, k T at row k, whatever times the record has.

    Args:
        scenario: for the vehicle and the settings of the estimators; what it says of the true vehicle and of
            what is flown plays no part.
        first_row: number of the record's first row; later than zero when an earlier part went before.
        findings: see `estimation.build`.
    """
    vehicle = scenario.vehicle_data
    tracked = {sensor.name: len(sensor.columns) for sensor in vehicle.tracked}
    builder = DiagramBuilder()
    estimators = builder.AddNamedSystem("estimation", estimation.build(scenario, findings=findings))
    source = builder.AddNamedSystem(
        "telemetry_source",
        TelemetrySource(
            vehicle.sensor_names(),
            n_jets=len(vehicle.jets),
            period_s=vehicle.sample_period_s,
            first_row=first_row,
            tracked=tracked,
            within=vehicle.has_on_times,
        ),
    )

    told = ("jet_commands", "outside_wrench", "record_time", "command", *(ONSETS if vehicle.has_on_times else ()))
    for name in (*vehicle.sensor_names(), *tracked, *told):
        if estimators.HasInputPort(name):
            builder.Connect(source.GetOutputPort(name), estimators.GetInputPort(name))

    export_outputs(builder, (source, estimators))
    return Diagram(builder, "replay")
