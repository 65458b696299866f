"""The autopilot: hand controllers, attitude reference, phase-space control and jet selection.

hand_controllers --> attitude_reference --attitude_error--> phase_space_controller --request--> jet_selection
gyro ----------------^--------------------------------------^                                    |   |  command
                                                            ^------------- delivered ------------'   '--------->
With `autopilot.wheels` the wheel controller has the attitude error and the gyro, too, gives the wheels their torques,
and stands between the gyro and the phase-space controller.
"""

from __future__ import annotations

from pydrake.systems.framework import DiagramBuilder

from massprop_drake.diagrams._wiring import ONSETS, Diagram, export_outputs
from massprop_drake.inputs import pilot_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.systems.autopilot.attitude_reference import AttitudeReference
from massprop_drake.systems.autopilot.hand_controllers import HandControllers
from massprop_drake.systems.autopilot.jet_selection_system import JetSelection
from massprop_drake.systems.autopilot.phase_space_controller import PhaseSpaceController
from massprop_drake.systems.autopilot.wheel_controller import WheelController


def build(scenario: Scenario) -> Diagram:
    """Builds the Drake diagram of a scenario's autopilot: from rates and estimates to jet and wheel commands.

    Ports:
        gyro (in, 3): measured rate, rad/s, body axes.
        estimate (in, 10), converged (in, 1), reconfiguration (in, 7 + n_jets), prescribed (in, n_jets): see
            `JetSelection`; may stay unconnected.
        command (out, n_jets), held_command (out, n_jets), command_onset (out, n_jets), held_command_onset (out,
            n_jets): see `JetSelection`; the onsets where the autopilot flies on-times.
        hand_controllers (out, 6): see `HandControllers`.
        attitude_error (out, 3): rad, body axes.
        request (out, 8): see `PhaseSpaceController`.
        <wheel> (in, 1), wheel_torque (out, n): see `WheelController`; where wheels turn the vehicle.
        selection_counts (out, 4), out_of_use (out, n_jets): see `JetSelection`.
    """
    vehicle = scenario.vehicle_data
    period = vehicle.sample_period_s
    control, compiled = pilot_params.phase_space_params(scenario), scenario.execution.compiled
    builder = DiagramBuilder()

    controllers = builder.AddNamedSystem("hand_controllers", HandControllers(pilot_params.controller_windows(scenario)))
    reference = builder.AddNamedSystem(
        "attitude_reference", AttitudeReference(period_s=period, capture_rate=control.capture_rate, compiled=compiled)
    )
    controller = builder.AddNamedSystem("phase_space_controller", PhaseSpaceController(control, compiled=compiled))
    arguments = pilot_params.jet_selection_arguments(scenario)
    selection = builder.AddNamedSystem("jet_selection", JetSelection(**arguments, compiled=compiled))

    for system in (reference, controller):
        builder.Connect(controllers.GetOutputPort("hand_controllers"), system.GetInputPort("hand_controllers"))
    builder.Connect(reference.GetOutputPort("attitude_error"), controller.GetInputPort("attitude_error"))
    builder.Connect(controller.GetOutputPort("request"), selection.GetInputPort("request"))
    builder.Connect(selection.GetOutputPort("delivered"), controller.GetInputPort("delivered"))

    gyro = builder.ExportInput(reference.GetInputPort("gyro"), "gyro")
    law = pilot_params.wheel_control(scenario)
    if law is None:
        builder.ConnectInput(gyro, controller.GetInputPort("gyro"))
    else:
        names = [wheel.name for wheel in vehicle.wheels]
        wheels = builder.AddSystem(WheelController(law, names))
        builder.ConnectInput(gyro, wheels.GetInputPort("gyro"))
        builder.Connect(controllers.GetOutputPort("hand_controllers"), wheels.GetInputPort("hand_controllers"))
        builder.Connect(reference.GetOutputPort("attitude_error"), wheels.GetInputPort("attitude_error"))
        builder.Connect(wheels.GetOutputPort("rate_for_jets"), controller.GetInputPort("gyro"))
        for name in names:
            builder.ExportInput(wheels.GetInputPort(name), name)
        builder.ExportOutput(wheels.GetOutputPort("wheel_torque"), "wheel_torque")
    for name in ("estimate", "converged", "reconfiguration", "prescribed"):
        builder.ExportInput(selection.GetInputPort(name), name)
    for name in ("command", "held_command", *filter(selection.HasOutputPort, ONSETS)):
        builder.ExportOutput(selection.GetOutputPort(name), name)
    export_outputs(builder, (controllers, reference, controller))
    builder.ExportOutput(selection.GetOutputPort("counts"), "selection_counts")
    builder.ExportOutput(selection.GetOutputPort("out_of_use"), "out_of_use")
    return Diagram(builder, "autopilot")
