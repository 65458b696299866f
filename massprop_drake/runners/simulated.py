"""A run by Drake's simulator: the diagram, with a log at every port that a run keeps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake.diagrams import closed_loop, open_loop
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.vehicle.rigid_body import QUATERNION
from massprop_drake.runners.logs import ESTIMATION, state_groups
from massprop_drake.runners.moment import Moment
from massprop_drake.systems.layouts import RECONFIGURATION, STRUCTURE

Array = NDArray[np.float64]

_LOGGED = (
    "body_state",
    "structure",
    "command",
    "thrust",
    "hand_controllers",
    "attitude_error",
    "request",
    "selection_counts",
    "out_of_use",
    *ESTIMATION,
)


class Simulated:
    """A run by Drake's simulator, see `simulate.Engine`.

    Args:
        scenario: to run.
    """

    def __init__(self, scenario: Scenario):
        vehicle = scenario.vehicle_data
        self._diagram = (open_loop if scenario.jet_schedule else closed_loop).build(scenario)
        builder = DiagramBuilder()
        builder.AddNamedSystem(self._diagram.get_name(), self._diagram)
        names = [name for name in (*_LOGGED, *vehicle.sensor_names()) if self._diagram.HasOutputPort(name)]
        self._sinks = {
            name: LogVectorOutput(self._diagram.GetOutputPort(name), builder, vehicle.sample_period_s) for name in names
        }
        self._simulator = Simulator(builder.Build())
        if params.time_step(scenario) == 0.0:
            config = SimulatorConfig(
                integration_scheme=scenario.plant.integrator,
                max_step_size=vehicle.sample_period_s,
                accuracy=scenario.plant.accuracy,
                use_error_control=True,
            )
            ApplySimulatorConfig(config, self._simulator)
        self._root = self._simulator.get_mutable_context()
        self._began = False

    @property
    def logged(self) -> int:
        """Number of rows since the logs were emptied."""
        count: int = self._sinks["command"].FindLog(self._root).num_samples()
        return count

    def advance(self, reached_s: float) -> None:
        """Runs up to a time and logs every sample up to it, that at the time itself included."""
        if not self._began:
            self._simulator.Initialize()
            self._began = True
        self._simulator.AdvanceTo(reached_s)

    def emptied(self) -> dict[str, Array]:
        """What has been logged, by port, and the times; the logs are empty then."""
        logs = {}
        for name, sink in self._sinks.items():
            log = sink.FindMutableLog(self._root)
            logs[name] = np.array(log.data().T)  # a copy: the log goes on in its memory
            times = np.array(log.sample_times())
            log.Clear()
        return {"time_s": times, **logs}

    def moment(self) -> Moment:
        """What there is to see at the last sample."""
        context = self._diagram.GetMyContextFromRoot(self._root)

        def output(name: str) -> Array:
            return self._diagram.GetOutputPort(name).Eval(context)

        thrust = output("thrust")
        removed = np.zeros(thrust.size, dtype=bool)
        if self._diagram.HasOutputPort("reconfiguration"):
            removed = RECONFIGURATION.sized(jets=thrust.size).read(output("reconfiguration")).removed != 0.0
        return Moment(
            context.get_time(),
            output("body_state")[QUATERNION],
            STRUCTURE.read(output("structure")).center_of_mass,
            thrust,
            output("estimate"),
            output("standard_deviation"),
            removed,
        )

    def finish(self) -> tuple[Array, Groups]:
        """Covariance of the ten estimates, shape (10, 10), and the estimators' state, after the last sample."""
        own = self._diagram.GetMyContextFromRoot(self._root)
        covariance = self._diagram.GetOutputPort("covariance").Eval(own).reshape(10, 10)
        self._simulator.AdvancePendingEvents()  # the sample at the end is used like any other
        return covariance, state_groups(self._diagram, self._root)

    def cycle_times(self, cycles: int) -> dict[str, float | None]:
        """Mean time per cycle spent in the mathematics of each part, microseconds."""
        return _cycle_times(self._diagram, cycles)


def _cycle_times(diagram: Any, cycles: int) -> dict[str, float | None]:
    """Mean time per cycle spent in the mathematics of each part, microseconds."""
    estimation = diagram.GetSubsystemByName("estimation")
    spent = {
        system.get_name(): 1e6 * system.stopwatch.spent_s / cycles
        for system in estimation.GetSystems()
        if hasattr(system, "stopwatch")
    }
    detector = next((spent.pop(name) for name in ("failure_detector", "hypothesis_detector") if name in spent), None)
    selection = None
    if diagram.HasSubsystemNamed("autopilot"):
        autopilot = diagram.GetSubsystemByName("autopilot")
        selection = 1e6 * autopilot.GetSubsystemByName("jet_selection").stopwatch.spent_s / cycles
    return {"estimators": sum(spent.values()), "detector": detector, "jet_selection": selection}
