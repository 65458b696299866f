"""A run by Drake's simulator: the diagram, with a log at every port that a run keeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, Multiplexer

from massprop_drake.diagrams import closed_loop, open_loop
from massprop_drake.errors import InputError, moment
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.vehicle.rigid_body import QUATERNION, RATE
from massprop_drake.runners.logs import ESTIMATION, state_groups
from massprop_drake.runners.moment import Moment
from massprop_drake.signals import JOINTS
from massprop_drake.systems.layouts import RECONFIGURATION, ROTATION_REPORT, STRUCTURE

Array = NDArray[np.float64]

_LOGGED = (
    "body_state",
    "structure",
    "command",
    "thrust",
    JOINTS,
    "hand_controllers",
    "attitude_error",
    "request",
    "selection_counts",
    "out_of_use",
    *ESTIMATION,
)


_DETECTORS = ("failure_detector", "hypothesis_detector", "thrust_factor_detector")
_NEEDED = ("body_state", "structure", "command", "thrust", "impulses", "rotation_report")


class Simulated:
    """A run by Drake's simulator, see `simulate.Engine`.

    Args:
        scenario: to run.
        diagram: that runs it, built or still to be built; None: the bundled one. What a run keeps is taken from the
            output ports of the diagram or, of one still to be built, of its systems; of ports of one name from the
            system that was added first.
        log: more output ports to keep, of systems that are still to be built.

    Raises:
        InputError: when the diagram has not what a run keeps.
    """

    def __init__(
        self,
        scenario: Scenario,
        diagram: Diagram | DiagramBuilder | None = None,
        log: Sequence[OutputPort] = (),
    ):
        vehicle = scenario.vehicle_data
        builder = diagram if isinstance(diagram, DiagramBuilder) else DiagramBuilder()
        if builder is not diagram:
            whole = diagram or (open_loop if scenario.jet_schedule else closed_loop).build(scenario)
            builder.AddNamedSystem(whole.get_name() or "diagram", whole)
        self._sensors = vehicle.sensor_names()
        seen = [sensor.name for sensor in vehicle.tracked]
        self._systems = builder.GetSystems()
        names = (*_LOGGED, *self._sensors, *seen)
        ports = {name: port for name in names if (port := self._port(name)) is not None}
        missing = [name for name in (*_NEEDED, *self._sensors, *seen, "covariance") if self._port(name) is None]
        if missing:
            raise InputError(
                f"the diagram has no output port '{missing[0]}', which a run keeps: it must have those of the diagrams "
                "vehicle and estimation, and a command, as its own or, of a DiagramBuilder, on its systems"
            )
        ports |= {f"{port.get_system().get_name()}.{port.get_name()}": port for port in log}
        period_s = vehicle.sample_period_s
        # one log, since each takes an event a sample
        sizes = [port.size() for port in ports.values()]
        side_by_side = builder.AddSystem(Multiplexer(sizes))
        for place, port in enumerate(ports.values()):
            builder.Connect(port, side_by_side.get_input_port(place))
        self._columns = dict(zip(ports, pairwise(np.cumsum([0, *sizes]).tolist()), strict=True))
        self._sink = LogVectorOutput(side_by_side.get_output_port(), builder, period_s)
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
        moving = self._part("multibody_vehicle")
        if moving is not None:
            moving.set_initial_velocities(self._root)
        self._began = False
        self._logged_s = -math.inf  # time of the last row

    @property
    def logged(self) -> int:
        """Number of rows since the logs were emptied."""
        count: int = self._sink.FindLog(self._root).num_samples()
        return count

    def advance(self, reached_s: float) -> None:
        """Runs up to a time and logs every sample up to it, that at the time itself included."""
        if not self._began:
            self._simulator.Initialize()
            self._began = True
        self._simulator.AdvanceTo(reached_s)

    def emptied(self) -> dict[str, Array]:
        """What has been logged, by port, and the times; the logs are empty then."""
        log = self._sink.FindMutableLog(self._root)
        rows, times_s = log.data().T, np.array(log.sample_times())
        self._logged_s = float(times_s[-1]) if times_s.size else self._logged_s
        logs = {name: rows[:, first:last].copy() for name, (first, last) in self._columns.items()}
        log.Clear()
        return {"time_s": times_s, **logs}

    def moment(self) -> Moment:
        """What there is to see at the last sample."""
        thrust = self._output("thrust")
        removed = np.zeros(thrust.size, dtype=bool)
        if self._port("reconfiguration") is not None:
            removed = RECONFIGURATION.sized(jets=thrust.size).read(self._output("reconfiguration")).removed != 0.0
        report = ROTATION_REPORT.read(self._output("rotation_report"))
        return Moment(
            self._root.get_time(),
            self._output("body_state")[QUATERNION],
            STRUCTURE.read(self._output("structure")).center_of_mass,
            thrust,
            self._output("estimate"),
            self._output("standard_deviation"),
            removed,
            self._output("command"),
            self._output("body_state")[RATE],
            float(report.rotation_nis) if report.rotation_used else math.nan,
            tuple(self._output(name) for name in self._sensors),
            np.empty(0) if self._port(JOINTS) is None else self._output(JOINTS),
        )

    def finish(self, *, interrupted: bool = False) -> tuple[Array, Groups]:
        """Covariance of the ten estimates, shape (10, 10), and the estimators' state, after the last sample.

        Args:
            interrupted: something was raised on the way; its logs have been emptied.
        """
        covariance = self._output("covariance").reshape(10, 10)
        if interrupted:
            if self._logged_s != self._root.get_time():
                raise RuntimeError(f"the sample at {moment(self._root.get_time())} s was not logged")
            self._simulator.Initialize()  # Drake's condition for going on from where it was interrupted
        self._simulator.AdvancePendingEvents()  # the sample at the end is used like any other
        estimation = self._part("estimation")
        return covariance, {} if estimation is None else state_groups(estimation, self._root)

    def cycle_times(self, cycles: int) -> dict[str, float | None]:
        """Mean time per cycle spent in the mathematics of each part, microseconds."""
        estimation, autopilot = self._part("estimation"), self._part("autopilot")
        return _cycle_times(estimation, autopilot, cycles)

    def _port(self, name: str) -> OutputPort | None:
        """The output port of a name, of the system that was added first; None where there is none."""
        return next((one.GetOutputPort(name) for one in self._systems if one.HasOutputPort(name)), None)

    def _output(self, name: str) -> Array:
        port: Any = self._port(name)
        value: Array = port.Eval(port.get_system().GetMyContextFromRoot(self._root))
        return value

    def _part(self, name: str) -> Any:
        """The part of a name, of the diagram or of one in it; None where there is none."""
        waiting = list(self._systems)
        while waiting:
            system = waiting.pop(0)
            if system.get_name() == name:
                return system
            waiting += system.GetSystems() if isinstance(system, Diagram) else []
        return None


def _cycle_times(estimation: Any, autopilot: Any, cycles: int) -> dict[str, float | None]:
    """Mean time per cycle spent in the mathematics of each part, microseconds; None for a part is none."""
    spent = {
        system.get_name(): 1e6 * system.stopwatch.spent_s / cycles
        for system in ([] if estimation is None else estimation.GetSystems())
        if hasattr(system, "stopwatch")
    }
    detector = next((spent.pop(name) for name in _DETECTORS if name in spent), None)
    selection = None
    if autopilot is not None and autopilot.HasSubsystemNamed("jet_selection"):
        selection = 1e6 * autopilot.GetSubsystemByName("jet_selection").stopwatch.spent_s / cycles
    return {"estimators": sum(spent.values()), "detector": detector, "jet_selection": selection}
