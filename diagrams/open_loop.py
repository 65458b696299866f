"""The open loop: a prescribed jet schedule, the vehicle and the estimators.

jet_schedule --command, held_command--> vehicle --gyros, accelerometers--> estimation --> estimate
"""

from __future__ import annotations

from pydrake.systems.framework import DiagramBuilder

from massprop_drake.diagrams import estimation, vehicle
from massprop_drake.diagrams._wiring import (
    ONSETS,
    Diagram,
    connect_engine_commands,
    connect_estimation,
    connect_wheels,
    export_outputs,
)
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.systems.autopilot.jet_schedule import JetSchedule


def build(scenario: Scenario, *, findings: bool = False) -> Diagram:
    """Builds the open-loop Drake diagram of a scenario: vehicle, jet schedule and estimation, connected.

    Args:
        scenario: with a jet schedule.
        findings: see `estimation.build`.

    Ports: none in; out every output of the `vehicle` and `estimation` diagrams and of `JetSchedule`, by
    the same names.
    """
    builder = DiagramBuilder()
    commands, onsets_s = params.scheduled_jet_commands(scenario)
    schedule = builder.AddNamedSystem(
        "jet_schedule", JetSchedule(commands, period_s=scenario.vehicle_data.sample_period_s, onsets_s=onsets_s)
    )
    body = builder.AddNamedSystem("vehicle", vehicle.build(scenario))
    estimators = builder.AddNamedSystem("estimation", estimation.build(scenario, findings=findings))

    for name in ("command", "held_command", *(() if onsets_s is None else ONSETS)):
        builder.Connect(schedule.GetOutputPort(name), body.GetInputPort(name))
    connect_estimation(builder, body, schedule, estimators, scenario)
    if scenario.estimation.filter == "pose":  # a jet may act before its command, as the clocks have it
        builder.Connect(schedule.GetOutputPort("command"), estimators.GetInputPort("command"))

    wheels = connect_wheels(builder, body, schedule, scenario)
    engines = connect_engine_commands(builder, body, scenario)
    export_outputs(builder, (body, schedule, estimators, *wheels, *engines))
    return Diagram(builder, "open_loop")
