"""Engine of Drake's simulator: the diagram, with a log at every port that a run keeps."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, PortDataType, System
from pydrake.systems.primitives import LogVectorOutput, Multiplexer

from massprop_drake.diagrams import closed_loop, open_loop
from massprop_drake.diagrams.estimation import MassPropertyEstimator
from massprop_drake.errors import InputError, moment, suggestion
from massprop_drake.inputs import true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.mass_properties import CENTER_OF_MASS
from massprop_drake.maths.signals import JOINTS, PROPELLANT, is_user_signal
from massprop_drake.maths.vehicle.rigid_body import QUATERNION, RATE
from massprop_drake.runners.logs import ESTIMATION, state_groups
from massprop_drake.runners.moment import Moment
from massprop_drake.systems.layouts import RECONFIGURATION, ROTATION_REPORT, STRUCTURE
from massprop_drake.systems.stopwatch import DETECTOR, ESTIMATORS, JET_SELECTION, Stopwatch

Array = NDArray[np.float64]
Truth = Mapping[str, OutputPort | str]

# true quantities that a diagram of one's own may give, with the signal of each
TRUTH = {
    "rate": "rate",
    "attitude": "attitude",
    "position": "position",
    "velocity": "velocity",
    "mass_properties": "truth",
    "thrust": "thrust",
}
_SIZES = {"rate": 3, "attitude": 4, "position": 3, "velocity": 3, "mass_properties": 10}  # thrust: one for each jet
_BUNDLED_TRUTH = ("body_state", "structure", "thrust")
_AUTOPILOT = ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use")
_NEEDED = ("command", "impulses", "rotation_report", "covariance")
_UNLOGGED = ("covariance", "estimate", "standard_deviation", "reconfiguration")
_HELD = "held_command"


class DrakeEngine:
    """Engine that runs a scenario by Drake's simulator, see `simulate.Engine`.

    Args:
        scenario: to run.
        diagram: that runs it, built or still to be built; None: the bundled one.
        log: more output ports to keep, of systems that are still to be built.
        truth: output ports of true quantities, or their names, see `TRUTH`; None: those of the bundled vehicle, where
            the diagram has them.

    Output ports are found by name, on the diagram or, of one still to be built, on its systems; the system that was
    added first comes first. In a builder, a reading or command without a port of its name is what feeds the estimator.

    Raises:
        InputError: when the diagram lacks what a run keeps, the table of the truth is wrong, a port to log is none of
            numbers or its system has no name, or the diagram commands a jet by less than 0 or more than 1.
    """

    def __init__(
        self,
        scenario: Scenario,
        diagram: Diagram | DiagramBuilder | None = None,
        log: Sequence[OutputPort] = (),
        truth: Truth | None = None,
    ):
        vehicle = scenario.vehicle_data
        self._sensors, self._n_jets = vehicle.sensor_names(), len(vehicle.jets)
        self._jets = vehicle.designations
        with _explain_diagram_errors(diagram):
            self._simulator = Simulator(self._build(scenario, diagram, log, truth))
        self._root = self._simulator.get_mutable_context()
        if self._root.num_continuous_states():
            config = SimulatorConfig(
                integration_scheme=scenario.plant.integrator,
                max_step_size=vehicle.sample_period_s,
                accuracy=scenario.plant.accuracy,
                use_error_control=True,
            )
            ApplySimulatorConfig(config, self._simulator)
        moving = self._find_system(lambda system: hasattr(system, "set_initial_velocities"))
        if moving is not None:
            moving.set_initial_velocities(self._root)
        self._truth_names = () if truth is None else tuple(truth)  # true quantities of a table
        self._began = self._ended = False
        self._waiting: dict[str, Array] = {}  # the last row, where its command is known a sample later
        self._stopwatch = Stopwatch()
        self._logged_s = -math.inf  # time of the last row

    def _build(
        self,
        scenario: Scenario,
        diagram: Diagram | DiagramBuilder | None,
        log: Sequence[OutputPort],
        truth: Truth | None,
    ) -> Diagram:
        """Builds the Drake diagram to simulate, with one vector log of all output ports that a run stores."""
        builder = diagram if isinstance(diagram, DiagramBuilder) else DiagramBuilder()
        if builder is not diagram:
            inner = diagram or (open_loop if scenario.open_loop else closed_loop).build(scenario)
            builder.AddNamedSystem(inner.get_name() or "diagram", inner)
        self._systems = builder.GetSystems()
        self._estimation = self._find_system(lambda system: isinstance(system, MassPropertyEstimator))
        _require_period(self._estimation, scenario)
        self._ports = self._find_ports(scenario, _feeding_ports(self._estimation, builder)) | self._find_truth_ports(
            truth
        )
        ports = {name: port for name, port in self._ports.items() if name not in _UNLOGGED}
        for port in log:
            vector_port = self._vector_port("log", port)
            ports[_user_signal_name(vector_port)] = vector_port
        sizes = [port.size() for port in ports.values()]
        multiplexer = builder.AddSystem(Multiplexer(sizes))
        for place, port in enumerate(ports.values()):
            builder.Connect(port, multiplexer.get_input_port(place))
        self._columns = dict(zip(ports, pairwise(np.cumsum([0, *sizes]).tolist()), strict=True))
        self._sink = LogVectorOutput(multiplexer.get_output_port(), builder, scenario.vehicle_data.sample_period_s)
        _require_unique_names(self._systems)
        return builder.Build()

    @property
    def logged(self) -> int:
        """Number of samples logged since the logs were emptied."""
        count: int = self._sink.FindLog(self._root).num_samples()
        return count + (1 if self._waiting else 0)

    def advance(self, until_s: float) -> None:
        """Simulates up to a time, s, and logs every sample up to it, that at the time itself included."""
        with self._stopwatch:
            if not self._began:
                self._simulator.Initialize()
                self._began = True
            self._simulator.AdvanceTo(until_s)

    def take_logs(self) -> dict[str, Array]:
        """Returns logged rows by port, shape (n, size), with their times as time_s, and empties the logs.

        Raises:
            InputError: when a true quantity of a table is not finite.
        """
        log = self._sink.FindMutableLog(self._root)
        rows, times_s = log.data().T, np.array(log.sample_times())
        self._logged_s = float(times_s[-1]) if times_s.size else self._logged_s
        logs = {name: rows[:, first:last].copy() for name, (first, last) in self._columns.items()}
        log.Clear()
        _require_fractions(logs["command" if "command" in logs else _HELD], times_s, self._jets)
        for name in self._truth_names:
            unknown = ~np.isfinite(logs[TRUTH[name]]).all(axis=1)
            if unknown.any():
                raise InputError(
                    f"truth: {name}: must be finite, but is not at t = {moment(times_s[unknown][0])} s; leave it out "
                    "where it is not known"
                )
        return self._add_commands({"time_s": times_s, **logs})

    def _add_commands(self, logs: dict[str, Array]) -> dict[str, Array]:
        """Adds the command of the coming interval, that of the next row, where only the past one is logged."""
        if _HELD not in logs:
            return logs
        if self._waiting:
            logs = {name: np.concatenate([self._waiting[name], rows]) for name, rows in logs.items()}
        unknown_row = np.full((1, self._n_jets), np.nan)
        logs["command"] = np.vstack([logs[_HELD][1:], unknown_row])
        n_kept = None if self._ended else -1
        self._waiting = {} if self._ended else {name: rows[-1:] for name, rows in logs.items() if name != "command"}
        return {name: rows[:n_kept] for name, rows in logs.items()}

    def snapshot(self) -> Moment:
        """Returns true motion, thrusts, estimates, commands and readings of the last sample, for viewers."""
        unknown = np.full(self._n_jets, np.nan)
        removed = np.zeros(self._n_jets, dtype=bool)
        if "reconfiguration" in self._ports:
            removed = (
                RECONFIGURATION.sized(jets=self._n_jets).read(self._evaluate_port("reconfiguration")).removed != 0.0
            )
        report = ROTATION_REPORT.read(self._evaluate_port("rotation_report"))
        attitude, center, rate = self._true_motion()
        return Moment(
            self._root.get_time(),
            attitude,
            center,
            self._evaluate_port("thrust") if "thrust" in self._ports else unknown,
            self._evaluate_port("estimate"),
            self._evaluate_port("standard_deviation"),
            removed,
            self._evaluate_port("command" if "command" in self._ports else _HELD),
            rate,
            float(report.rotation_nis) if report.rotation_used else math.nan,
            tuple(self._evaluate_port(name) for name in self._sensors),
            self._evaluate_port(JOINTS) if JOINTS in self._ports else np.empty(0),
        )

    def _true_motion(self) -> tuple[Array, Array, Array]:
        """Returns true attitude (4), center of mass (3) and rate (3) now, NaN where the diagram has no such port."""
        if "body_state" in self._ports:
            body = self._evaluate_port("body_state")
            return body[QUATERNION], STRUCTURE.read(self._evaluate_port("structure")).center_of_mass, body[RATE]
        attitude, rate, properties = (
            self._evaluate_port(TRUTH[name]) if TRUTH[name] in self._ports else np.full(_SIZES[name], np.nan)
            for name in ("attitude", "rate", "mass_properties")
        )
        return attitude, properties[CENTER_OF_MASS], rate

    def finish(self, *, interrupted: bool = False) -> tuple[Array, Groups]:
        """Completes the last cycle; returns covariance of the ten estimates, shape (10, 10), and the estimators' state.

        Args:
            interrupted: something was raised on the way; its logs have been emptied.
        """
        self._ended = True
        covariance = self._evaluate_port("covariance").reshape(10, 10)
        if interrupted:
            if self._logged_s != self._root.get_time():
                raise RuntimeError(f"the sample at {moment(self._root.get_time())} s was not logged")
            self._simulator.Initialize()  # Drake's condition for going on from where it was interrupted
            self._sink.FindMutableLog(self._root).Clear()  # which has logged the sample once more
        with self._stopwatch:
            self._simulator.AdvancePendingEvents()  # the sample at the end is used like any other
        return covariance, {} if self._estimation is None else state_groups(self._estimation, self._root)

    def cycle_times(self, cycles: int) -> dict[str, float | None]:
        """Computes mean times per cycle of estimators, detector and jet selection, microseconds; None: no such part."""
        spent = {part: 1e6 * spent_s / cycles for part, spent_s in self._stopwatch.spent_s.items()}
        selects = self._find_system(lambda system: system.get_name() == "jet_selection") is not None
        selection = spent.get(JET_SELECTION, 0.0 if selects else None)
        return {"estimators": spent.get(ESTIMATORS, 0.0), "detector": spent.get(DETECTOR), "jet_selection": selection}

    # ------------------------------------------------------------------------------------- its ports

    def _find_ports(self, scenario: Scenario, sources: Mapping[str, OutputPort]) -> dict[str, OutputPort]:
        """Maps names of all signals that a run stores, without true ones, to their output ports."""
        non_inertial = [sensor.name for sensor in true_params.simulated_non_inertial(scenario)]
        names = (
            "command",
            "command_onset",
            JOINTS,
            PROPELLANT,
            *_AUTOPILOT,
            *ESTIMATION,
            *_UNLOGGED,
            *self._sensors,
            *non_inertial,
        )
        found = {name: port for name in names if (port := self._find_port(name) or sources.get(name)) is not None}
        if self._find_port("command") is None and "jet_commands" in sources:
            found.pop("command", None)
            found[_HELD] = sources["jet_commands"]
        needed = (*_NEEDED, *self._sensors, *non_inertial)
        missing = [name for name in needed if name not in found and not (name == "command" and _HELD in found)]
        if missing:
            raise InputError(
                f"the diagram has no output port '{missing[0]}', which a run keeps: it needs a MassPropertyEstimator, "
                "its readings and its commands, as ports of those names or, in a DiagramBuilder, connected to it"
            )
        return found

    def _find_truth_ports(self, truth: Truth | None) -> dict[str, OutputPort]:
        """Maps true signals to output ports: those of the user's table, else the bundled vehicle's; empty: none."""
        if truth is None:
            ports = {name: port for name in _BUNDLED_TRUTH if (port := self._find_port(name)) is not None}
            return ports if len(ports) == len(_BUNDLED_TRUTH) else {}
        if not isinstance(truth, Mapping):
            raise InputError(f"truth: must be a table such as {{'rate': port}}, got {type(truth).__name__}")
        return {TRUTH[name]: self._true_port(name, port) for name, port in truth.items() if _require_truth_name(name)}

    def _true_port(self, name: str, port: OutputPort | str) -> OutputPort:
        """Returns the output port of a true quantity, from the port itself or its name, after a check of its size.

        Raises:
            InputError: when there is none of that name, or it has another size.
        """
        found = self._vector_port(f"truth: {name}", port)
        size = _SIZES.get(name, self._n_jets)
        if found.size() != size:
            raise InputError(
                f"truth: {name}: must be a port of {size} numbers; '{found.get_name()}' has {found.size()} numbers"
            )
        return found

    def _vector_port(self, label: str, port: OutputPort | str) -> OutputPort:
        """Returns the vector output port of a system in the diagram, from the port itself or its name.

        Raises:
            InputError: when there is none such, or it has no numbers.
        """
        found = self._find_port(port) if isinstance(port, str) else port
        if found is None:
            raise InputError(f"{label}: the diagram has no output port '{port}'")
        if not isinstance(found, OutputPort):
            raise InputError(f"{label}: must be an output port or its name, got {found!r}")
        if found.get_system() not in self._systems:
            raise InputError(
                f"{label}: '{found.get_name()}' is a port of system '{found.get_system().get_name()}', which the "
                "builder does not have; give a port of one that it has, or of the diagram around it that exports it"
            )
        if found.get_data_type() != PortDataType.kVectorValued:
            raise InputError(f"{label}: must be a port of numbers; '{found.get_name()}' has no vector")
        return found

    def _find_port(self, name: str) -> OutputPort | None:
        """Returns the output port with a name, of the first system that has one; None where no system has."""
        return next((system.GetOutputPort(name) for system in self._systems if system.HasOutputPort(name)), None)

    def _evaluate_port(self, name: str) -> Array:
        """Evaluates the output port of a signal at the present simulated time, shape (size,)."""
        port: Any = self._ports[name]
        with self._stopwatch:
            value: Array = port.Eval(port.get_system().GetMyContextFromRoot(self._root))
        return value

    def _find_system(self, predicate: Callable[[System], bool]) -> Any:
        """Returns the first system, inner diagrams included, that satisfies a predicate; None where there is none."""
        waiting = list(self._systems)
        while waiting:
            system = waiting.pop(0)
            if predicate(system):
                return system
            waiting += system.GetSystems() if isinstance(system, Diagram) else []
        return None


@contextlib.contextmanager
def _explain_diagram_errors(diagram: Any) -> Iterator[None]:
    """Converts, in a with block, Drake's errors about a diagram of the user's own into one InputError."""
    if diagram is not None and not isinstance(diagram, (DiagramBuilder, System)):
        raise InputError(f"simulate: diagram: must be a Diagram or a DiagramBuilder, got {type(diagram).__name__}")
    try:
        yield
    except (RuntimeError, SystemExit) as error:  # a demand of Drake's that is not met is the latter
        if diagram is None:
            raise
        raise InputError(f"simulate: diagram: {' '.join(str(error).split())}") from None


def _require_unique_names(systems: Sequence[System]) -> None:
    """Raises InputError where two systems have the same name, at which Drake would end the process."""
    names = [system.get_name() for system in systems]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise InputError(f"simulate: diagram: two of its systems are named '{repeated}'; rename one")


def _require_period(estimation: MassPropertyEstimator | None, scenario: Scenario) -> None:
    """Raises InputError where the estimator's sample period differs from that of the scenario's vehicle."""
    period = scenario.vehicle_data.sample_period_s
    if estimation is not None and estimation.scenario.vehicle_data.sample_period_s != period:
        own = estimation.scenario.vehicle_data.sample_period_s
        raise InputError(
            f"simulate: diagram: its estimator samples every {own:g} s, the scenario's vehicle every {period:g} s; "
            "build both for one vehicle"
        )


def _user_signal_name(port: OutputPort) -> str:
    """Returns the signal name `<system>.<port>` under which a run stores an output port of the user's own.

    Raises:
        InputError: when the port's system has no name that could be a signal's.
    """
    system, name = port.get_system().get_name(), port.get_name()
    if not is_user_signal(f"{system}.{name}"):
        raise InputError(
            f"log: the system '{system}' of the port '{name}' needs a name without '.', '/' and '\\', which the signal "
            "takes over: AddNamedSystem('plant', ...) gives one"
        )
    return f"{system}.{name}"


def _require_fractions(commands: Array, times_s: Array, jets: Sequence[str]) -> None:
    """Raises InputError where a jet's command is less than 0 or more than 1; NaN, an unknown command, passes."""
    rows, columns = ((commands < 0.0) | (commands > 1.0)).nonzero()
    if rows.size:
        jet, value, time_s = jets[columns[0]], commands[rows[0], columns[0]], times_s[rows[0]]
        raise InputError(
            f"command: at t = {moment(time_s)} s jet {jet} is commanded by {value:.6g}; it must be from 0 to 1, the "
            "fraction of full thrust"
        )


def _require_truth_name(name: str) -> bool:
    """Returns True for the name of a true signal that runs store; raises InputError for another name."""
    if name not in TRUTH:
        raise InputError(f"truth: no run keeps a true {name!r}{suggestion(name, list(TRUTH))}")
    return True


def _feeding_ports(estimation: System | None, builder: DiagramBuilder) -> dict[str, OutputPort]:
    """Maps names of an estimator's input ports to the output ports connected to them; empty: no estimator."""
    if estimation is None:
        return {}
    return {
        estimation.get_input_port(into).get_name(): source.get_output_port(out)
        for (system, into), (source, out) in builder.connection_map().items()
        if system is estimation
    }
