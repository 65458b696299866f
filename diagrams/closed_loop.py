"""The closed loop: autopilot, vehicle and estimators.

autopilot --command, held_command--> vehicle --gyros, accelerometers--> estimation --> estimate
    ^ ^ ^                               |            ^ jet_commands = held_command        |
    | | '---------- gyro ---------------'                                                 |
    | '--- command of jet_schedule, where jets are prescribed beside the autopilot        |
    '---------------- estimate, converged (autopilot.mass_properties: estimated) ---------'
"""

from __future__ import annotations

from pydrake.systems.framework import DiagramBuilder

from massprop_drake.diagrams import autopilot, estimation, vehicle
from massprop_drake.diagrams._wiring import (
    ONSETS,
    Diagram,
    connect_engine_commands,
    connect_estimation,
    connect_wheels,
    export_outputs,
)
from massprop_drake.inputs import crafts, params, pilot_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.systems.autopilot.firing_test import FiringTestSystem
from massprop_drake.systems.autopilot.jet_schedule import JetSchedule


def build(scenario: Scenario, *, findings: bool = False) -> Diagram:
    """Builds the closed-loop Drake diagram of a scenario: vehicle, autopilot and estimation, connected.

    Args:
        scenario: with windows of the hand controllers.
        findings: see `estimation.build`.

    Ports: none in; out every output of the `vehicle`, `autopilot` and `estimation` diagrams, by the same
    names.

    Timing: at t_k the sensors report the body, the autopilot decides the command of [t_k, t_k+1), and
    the estimators use the readings with the command of [t_k-1, t_k).
    """
    gyro = params.gyro(scenario).name
    builder = DiagramBuilder()
    pilot = builder.AddNamedSystem("autopilot", autopilot.build(scenario))
    body = builder.AddNamedSystem("vehicle", vehicle.build(scenario))
    estimators = builder.AddNamedSystem("estimation", estimation.build(scenario, findings=findings))

    builder.Connect(body.GetOutputPort(gyro), pilot.GetInputPort("gyro"))
    for name in ("command", "held_command", *filter(pilot.HasOutputPort, ONSETS)):
        builder.Connect(pilot.GetOutputPort(name), body.GetInputPort(name))
    connect_estimation(builder, body, pilot, estimators, scenario)
    if estimators.HasOutputPort("reconfiguration"):
        builder.Connect(estimators.GetOutputPort("reconfiguration"), pilot.GetInputPort("reconfiguration"))
    if pilot_params.closes_manifolds(scenario) and estimators.HasOutputPort("closed"):
        for name in ("closed", "held_closed"):
            builder.Connect(estimators.GetOutputPort(name), body.GetInputPort(name))
    if scenario.autopilot.mass_properties == "estimated":
        for name in ("estimate", "converged"):
            builder.Connect(estimators.GetOutputPort(name), pilot.GetInputPort(name))

    if scenario.jet_schedule:
        table, _ = params.scheduled_jet_commands(scenario)
        period_s = scenario.vehicle_data.sample_period_s
        schedule = builder.AddNamedSystem("jet_schedule", JetSchedule(table, period_s=period_s))
        builder.Connect(schedule.GetOutputPort("command"), pilot.GetInputPort("prescribed"))

    testing = crafts.firing_test(scenario)
    if testing is not None:
        test = builder.AddNamedSystem("firing_test", FiringTestSystem(testing))
        builder.Connect(body.GetOutputPort(gyro), test.GetInputPort("gyro"))
        for name in ("estimate", "covariance", *(("fault_probability",) if testing.groups else ())):
            builder.Connect(estimators.GetOutputPort(name), test.GetInputPort(name))
        builder.Connect(test.GetOutputPort("command"), pilot.GetInputPort("prescribed"))

    wheels = connect_wheels(builder, body, pilot, scenario)
    engines = connect_engine_commands(builder, body, scenario)
    export_outputs(builder, (body, pilot, estimators, *wheels, *engines))
    return Diagram(builder, "closed_loop")
