"""Estimators for real time: one call a cycle, no simulator, no file."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from massprop_drake.errors import InputError, dotted, moment
from massprop_drake.inputs import params
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.scenario_checks import check_against_vehicle
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import SensorPackage
from massprop_drake.maths.estimation import cycle, whole
from massprop_drake.maths.estimation.detector import Verdict
from massprop_drake.maths.estimation.faults.declarations import Word
from massprop_drake.maths.estimation.faults.fault_report import jets_by_declaration
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterState
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import are_converged
from massprop_drake.maths.possible_inertia import nearest_possible
from massprop_drake.maths.vehicle.on_times import command_onsets, level_onsets, rest_of_sample
from massprop_drake.maths.vehicle.sensing import mask_saturated
from massprop_drake.records.blocks import LARGEST
from massprop_drake.records.cadence import HELD
from massprop_drake.results.events import locate_reading, sensor_event_kind
from massprop_drake.results.json_arrays import null_for_nan, onsets_as_json
from massprop_drake.results.stored import FORMAT, EstimatorState, FilterState, require_same_origin, state_origin
from massprop_drake.runners.cycles import RecordRows, ThesisKernelCycles
from massprop_drake.runners.logs import EstimationLog, state_from_json, state_to_json

Array = NDArray[np.float64]

_ROUNDING = 1e-6  # of a sample: by which a jet may close after its end


class Detection(NamedTuple):
    """Failure or jump declared at a cycle.

    Attributes:
        kind: "jet", "mass_property_jump" or "withdrawn"; with the detector by hypotheses besides "changed" (of the
            force of a failed jet), "erratic" (it has changed again and again), "jump_measured" (the size of an earlier
            jump), "false_reading", "engine_failed", "disturbance" and "unexplained". Of several at a cycle the first.
        onset_s: end of the last sample that showed nothing, s.
        cluster: number of the suspected jet's cluster; None for a jump.
        jet: designation of the suspected jet, the likeliest of its cluster; None for a jump.
        isolated: whether the data name the jet, not only its cluster.
        magnitude: force too much (positive) or missing (negative), lbf or N.
        magnitude_std: its 1-sigma.
        jets: designations of the jets that it may be, the likeliest first; none where only a cluster is known.
        mass, mass_std: gained in a jump, slug or kg, and its 1-sigma; NaN where the method measures none, or
            not yet.
        position, position_std: where, vehicle frame, ft or m; None where it is not known.
        told_apart_by: designation of the jet of a group that, fired alone, would tell it apart.
        told_apart_s: time without any jet after which it would be, s; NaN: with no jet either, nothing would.
        sensor, axis: package and axis of a false reading.
        torque_std, force_std: of a disturbance that nobody stated, 1-sigma to an order of magnitude, ft-lbf and lbf, or
            N-m and N; NaN: not known.
    """

    kind: str
    onset_s: float
    cluster: int | None
    jet: str | None
    isolated: bool
    magnitude: float
    magnitude_std: float
    jets: tuple[str, ...] = ()
    mass: float = math.nan
    mass_std: float = math.nan
    position: tuple[float, float, float] | None = None
    position_std: tuple[float, float, float] | None = None
    told_apart_by: str | None = None
    told_apart_s: float = math.nan
    sensor: str | None = None
    axis: str | None = None
    torque_std: float = math.nan
    force_std: float = math.nan


class EstimatorStep(NamedTuple):
    """Estimates and detections after one cycle.

    Attributes:
        time_s: of the cycle, s.
        estimate: the ten parameters, see `maths.mass_properties`, shape (10,); NaN for 1/m without an accelerometer.
        standard_deviation: 1-sigma of each, likewise, shape (10,).
        converged: whether the estimates may be acted on.
        used: whether the rotation filter used the sample.
        mass_used: whether the mass filter used it.
        rotation_nis: of the rotation filter's innovation; NaN where not measured.
        mass_nis: of the mass filter's.
        alarm: whether the sample shows a failed jet.
        detection: what was declared at this cycle; None: nothing.
        known_wrench: torque about the vehicle origin and force of failed jets from now on, shape (6,).
        removed: jets to be taken out of use, boolean, shape (n_jets,).
        fault_probability: posterior probability that each jet has failed, shape (n_jets,); zero without a detector that
            gives it.
        unknown_probability: posterior probability that something unknown pushes; zero likewise.
    """

    time_s: float
    estimate: Array
    standard_deviation: Array
    converged: bool
    used: bool
    mass_used: bool
    rotation_nis: float
    mass_nis: float
    alarm: bool
    detection: Detection | None
    known_wrench: Array
    removed: NDArray[np.bool_]
    fault_probability: Array
    unknown_probability: float


class _Cycle(NamedTuple):
    """Reports of a cycle, in one form for every kernel.

    Attributes:
        known: estimate and 1-sigma of the ten parameters.
        rotation, mass: reports of the filters.
        status: of the detector, see `detector.STATUS`; None: there is none.
        own: what this detector alone says, None: nothing.
        force, removed: see `detector.Detector`, shape (n_jets,) each.
    """

    known: tuple[Array, Array]
    rotation: Any
    mass: Any
    status: Any
    own: Any
    force: Array
    removed: Array


class Estimator:
    """Estimates mass properties and finds failed jets, cycle by cycle.

    From gyro, accelerometers and commands. The same mathematics as the `estimation` diagram, and the same answers. Call
    `step` once per sample period, or whenever a sensor with a rate of its own is read, in order of time; nothing it
    keeps grows, and `Estimator.state` and `Estimator.restore` carry it over a restart. A copy by `pickle` or
    `copy.deepcopy` goes on bit for bit, under the same version of this package.

    Args:
        vehicle: jets, sensors and nominal mass properties.
        scenario: whose `sensors`, `estimation`, `rotation`, `mass`, `joint` and `detector` fields are used, and
            `execution.compiled`; default: all at their defaults.

    Raises:
        InputError: (a ValueError) when the scenario names what the vehicle does not have, or it has no accelerometer
            and the filters are those of the thesis.
    """

    def __init__(self, vehicle: Vehicle, scenario: Scenario | None = None):
        scenario = (scenario or Scenario()).model_copy(update={"vehicle": vehicle})
        problems = check_against_vehicle(scenario, vehicle)
        if problems:
            raise InputError(*(f"scenario: {dotted(path)}: {problem}" for path, problem in problems))
        if scenario.estimation.filter == "thesis" and not params.mass_is_observable(scenario):
            problem = "has no accelerometer, which the filters of the thesis need; use estimation.filter: joint"
            raise InputError(f"vehicle '{vehicle.name}' {problem}")
        self._vehicle, self._scenario = vehicle, scenario
        self._made_with = state_origin(scenario)
        self._gyros, self._accelerometers = params.gyros(scenario), params.accelerometers(scenario)
        self._params = params.estimation_params(scenario)
        self._not_estimated = params.known_parameters(scenario)
        self._unit_wrenches = params.unit_wrenches(vehicle)
        self._begin(cycle.initial_state(self._params))
        self._published: tuple[Array, Array] | None = None  # where they are not those of the state
        self._command = np.zeros(len(vehicle.jets))  # of the interval that starts at the last sample
        self._outside, self._onset_s = np.zeros(6), level_onsets(len(vehicle.jets))  # likewise
        self._time_s = self._told_s = -math.inf
        self._own_times = params.steps_by_readings(scenario)

    def __repr__(self) -> str:
        at = "before its first sample" if self._time_s == -math.inf else f"at {moment(self._time_s)} s"
        detector = self._scenario.detector.kind
        return f"<Estimator of '{self._vehicle.name}', {self._scenario.estimation.filter} filter, {detector}, {at}>"

    def __getstate__(self) -> dict[str, Any]:
        """Returns scenario, state of the next cycle and last commands, for `pickle` and `copy`."""
        kept = ("_scenario", "_published", "_command", "_onset_s", "_outside", "_time_s", "_told_s")
        return {**{name: self.__dict__[name] for name in kept}, "_kept": self._state}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Estimator.__init__(self, state["_scenario"].vehicle_data, state["_scenario"])
        self._begin(state["_kept"])
        self.__dict__.update(state)

    def _begin(self, state: cycle.EstimationState) -> None:
        """Sets the state of filter and detector to start from; in one compiled kernel if asked for and covered."""
        self._kept, self._whole = state, None
        if self._scenario.execution.compiled and whole.covers(self._params):
            self._row = whole.allocate_sample(len(self._gyros), len(self._accelerometers), state.level.size)
            self._whole, self._log = (
                ThesisKernelCycles(self._params, state, compiled=True),
                EstimationLog(self._scenario, self._params, 1),
            )
            self._whole.begin(RecordRows(self._row), self._log)

    @property
    def _state(self) -> cycle.EstimationState:
        """State of filter and detector from which the next cycle goes on."""
        return self._kept if self._whole is None else self._whole.state()

    @property
    def covariance(self) -> Array:
        """Covariance of the ten estimates as the last step gave them, shape (10, 10)."""
        _, covariance = self._known
        return covariance

    @property
    def _known(self) -> tuple[Array, Array]:
        """Estimate and covariance, shapes (10,) and (10, 10); after `restore`, those in the filter's state."""
        return self._published or cycle.estimate_and_covariance(self._state, self._params)

    @property
    def disturbance(self) -> tuple[Array, Array] | None:
        """Disturbance torque about the center of mass and force, and their 1-sigma, shape (6,) each, or None.

        Body axes, ft-lbf and lbf, or N-m and N; None where the vehicle's file states no `disturbance`, or the scenario
        has another filter than the joint one.
        """
        known, sigmas = self._state.filter, params.disturbance_sigmas(self._vehicle)
        if not (isinstance(known, JointFilterState) and sigmas.any()):
            return None
        value, deviation = np.zeros(6), np.zeros(6)
        value[sigmas > 0.0], deviation[sigmas > 0.0] = joint.disturbance_estimate(known, self._params.filter_params)
        return sigmas * value, sigmas * deviation

    def nearest_possible(self) -> Array | None:
        """Returns the estimate if a rigid body can have it, else the nearest possible one, shape (10,), or None.

        See `maths.possible_inertia.nearest_possible`. The estimator itself goes on from its own.
        """
        return nearest_possible(*self._known)

    @property
    def state(self) -> dict[str, Any]:
        """State of filter and detector, time and commands as JSON data; a run's `filter_state.json` has more."""
        return {
            "format": FORMAT,
            "made_with": self._made_with,
            "time_s": self._time_s if math.isfinite(self._time_s) else None,
            "command": null_for_nan(self._command),
            **onsets_as_json(self._onset_s),
            "outside_wrench": null_for_nan(self._outside),
            "states": state_to_json(self._state, self._params),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restores the state of filter and detector from `Estimator.state` or a run's `filter_state.json`.

        Args:
            state: as `Estimator.state` gives it.

        Raises:
            InputError: when it is of another vehicle or other settings, or is not as it should be; the message says
                where. The estimator then is as it was.
        """
        kind = FilterState if isinstance(state, Mapping) and "row" in state else EstimatorState
        kept = validate_data(kind, state, source="state")
        require_same_origin(kept, self._scenario, "state")
        self._begin(state_from_json(kept.states, self._params, "state"))
        self._published = None
        self._command = np.array(kept.command, dtype=float)
        onset_s = kept.onset_s
        self._onset_s = level_onsets(self._command.size) if onset_s is None else onset_s
        self._outside = np.array(kept.outside_wrench)
        self._time_s = self._told_s = -math.inf if kept.time_s is None else kept.time_s

    def step(
        self,
        time_s: float,
        gyro: ArrayLike | Mapping[str, ArrayLike] | None = None,
        accelerometers: ArrayLike | Mapping[str, ArrayLike] | None = None,
        commands: ArrayLike | None = None,
        outside_wrench: ArrayLike | None = None,
        tracked: Mapping[str, ArrayLike] | None = None,
        *,
        onsets_s: ArrayLike | None = None,
    ) -> EstimatorStep:
        """Updates the estimates by the readings of one sample, and stores the commands of the interval that it begins.

        Where sensors have rates of their own (`rate_hz` of the vehicle's, or `estimation.readings_per_s`) there is a
        call whenever anything is read or commanded, with that alone.

        Args:
            time_s: of the sample, s; one sample period after the last call's, or, of a vehicle that is followed in a
                fixed frame and with rates of their own, any time later.
            gyro: angular rate, rad/s, body axes, shape (3,) of the package in use, or a mapping from
                package names. NaN where missing; None: the vehicle has none, or none was read.
            accelerometers: likewise, integrated specific force, ft/s or m/s, body axes, shape (3,) of the package
                in use, or a mapping from package names. NaN where missing.
            commands: fraction commanded over the interval that starts now, 0 to 1, NaN where not known,
                shape (n_jets,). None, where sensors have rates of their own: those told last go on, for 1.2 sample
                periods at the most, after which they are not known.
            outside_wrench: torque about the vehicle origin and force of known outside forces, mean over
                that interval, shape (6,); None: none.
            tracked: by name, what was read besides: of a pose, position and quaternion from body to fixed frame,
                scalar first, shape (7,); of a velocity, shape (3,); of a wheel, its speed, rad/s, shape (1,). NaN
                where missing.
            onsets_s: how long after this sample each jet opens that is on for less than an interval, s, see
                `maths.vehicle.on_times`, NaN: its command is a level, shape (n_jets,); None: as the vehicle's
                `jet_commands` say.

        Raises:
            ValueError: when time is no number or goes backwards, a shape is wrong, a reading is infinite, a fraction
                is outside 0 to 1, or the outside wrench is not finite.
            NotPositiveDefiniteError: when a covariance loses definiteness.

            After either the estimator is as it was before the call.
        """
        time_s = float(_copy_numbers(time_s, (), "time_s"))
        if not time_s > self._time_s:
            raise ValueError(f"time must go forward: {time_s} s after {self._time_s} s")
        rates = _package_readings(gyro, self._gyros, "gyro")
        velocities = _package_readings(accelerometers, self._accelerometers, "accelerometers")
        coming, opening, told_s = self._resolve_commands(time_s, commands, onsets_s)
        outside = np.zeros(6) if outside_wrench is None else _copy_numbers(outside_wrench, (6,), "outside_wrench")
        if not np.isfinite(outside).all():
            raise ValueError("outside_wrench must be finite")

        seen = _tracked_readings(tracked, self._vehicle)
        told = (self._command, self._outside, time_s, coming, seen, self._onset_s, opening)
        done = self._run_cycle(cycle.Sample(time_s, rates, velocities, *told))
        self._command, self._outside, self._time_s, self._onset_s = coming, outside, time_s, opening
        self._told_s = told_s
        return self._make_step_result(time_s, done)

    def _resolve_commands(
        self, time_s: float, commands: ArrayLike | None, onsets_s: ArrayLike | None
    ) -> tuple[Array, Array, float]:
        """Returns commands from now on and their onsets, s, shape (n_jets,) each, and the time of the commands, s."""
        if commands is not None:
            next_commands = _copy_numbers(commands, self._command.shape, "commands")
            if ((next_commands < 0.0) | (next_commands > 1.0)).any():
                raise ValueError("commands must be fractions from 0 to 1")
            return next_commands, self._check_onsets(next_commands, onsets_s), time_s
        if not self._own_times:
            raise ValueError("commands must be given with every sample; only with rate_hz of a sensor do they go on")
        period_s = self._vehicle.sample_period_s
        if not time_s - self._told_s < HELD * period_s:
            unknown = np.full(self._command.size, np.nan)
            return unknown, unknown.copy(), self._told_s
        since_s = np.array([time_s - self._time_s])
        next_commands, next_onsets_s = rest_of_sample(self._command[None], self._onset_s[None], since_s, period_s)
        return next_commands[0], next_onsets_s[0], self._told_s

    def _check_onsets(self, commands: Array, onsets_s: ArrayLike | None) -> Array:
        """Returns opening times of jets, s, the caller's, checked, or the vehicle's; NaN: constant level, (n_jets,)."""
        period_s = self._vehicle.sample_period_s
        if onsets_s is None:
            return command_onsets(commands, None, self._vehicle.opens_at, period_s)
        checked = _copy_numbers(onsets_s, commands.shape, "onsets_s")
        late = (checked < 0.0) | (checked + commands * period_s > period_s * (1.0 + _ROUNDING))
        if (late & (commands > 0.0)).any():
            raise ValueError(f"onsets_s: a jet must open and close within the sample period of {period_s:g} s")
        return checked

    def _run_cycle(self, sample: cycle.Sample) -> _Cycle:
        """Runs the estimation cycle of a sample, by one kernel or by `cycle.step`, and returns its reports."""
        nothing = np.zeros(len(self._vehicle.jets))
        if self._whole is not None:
            for part, value in zip(self._row, sample[: len(self._row)], strict=True):
                part[0] = value
            self._whole.restart()
            self._whole.advance(1)
            _, force, removed, _ = self._whole.asked
            return _Cycle(
                self._log.estimate_and_deviation(0), *self._log.reports(0), None, force.copy(), removed.copy()
            )
        try:
            step = cycle.step(self._kept, sample, self._params)
        except NotPositiveDefiniteError as error:
            raise error.at(sample.time_s, "estimator") from None
        self._kept, self._published = step.state, step.filtered.known
        filtered, judgment, detector = step.filtered, step.judgment, step.state.detector
        reports = (cycle.reported_estimate(step), filtered.rotation, filtered.mass)
        if judgment is None:
            return _Cycle(*reports, None, None, nothing, nothing)
        return _Cycle(*reports, judgment.status, judgment.own, detector.force, detector.removed)

    def _make_step_result(self, time_s: float, reports: _Cycle) -> EstimatorStep:
        """Converts the reports of a cycle to what `Estimator.step` returns."""
        (estimate, deviation), mass = reports.known, reports.mass
        return EstimatorStep(
            time_s,
            estimate,
            deviation,
            self._are_converged(estimate, deviation),
            bool(reports.rotation.rotation_used),
            mass is not None and bool(mass.mass_used),
            reports.rotation.rotation_nis,
            math.nan if mass is None else mass.mass_nis,
            reports.status is not None and bool(reports.status.alarm),
            None if reports.status is None else self._make_detection(reports.status, reports.own),
            reports.force @ self._unit_wrenches,
            reports.removed != 0.0,
            *self._probabilities(reports.own),
        )

    def _probabilities(self, report: Any) -> tuple[Array, float]:
        """Returns posterior probabilities of jet failures, shape (n_jets,), and of an unknown cause; zero: no such."""
        if report is None or math.isnan(report.none_probability):
            return np.zeros(len(self._vehicle.jets)), 0.0
        return report.fault_probability.copy(), float(report.unknown_probability)

    def _are_converged(self, estimate: Array, deviation: Array) -> bool:
        """Tests whether the 1-sigmas of the ten estimates are within their limits."""
        return bool(are_converged(deviation[None], estimate[None], self._params.limits, self._not_estimated)[0])

    def _make_detection(self, status: Any, report: Any) -> Detection | None:
        """Returns the `Detection` of a cycle by the detector's reports; None where nothing is declared or changed."""
        event = Verdict(int(status.detector_event))
        if event == Verdict.NOTHING:
            return None
        if event == Verdict.JUMP or math.isnan(status.suspected_jet):
            fields = {} if report is None else self._fields_without_jet(report)
            kind = (
                "mass_property_jump"
                if event == Verdict.JUMP
                else _event_kind(report, fields.get("sensor"), self._vehicle)
            )
            return Detection(kind, status.onset, None, None, False, 0.0, 0.0)._replace(**fields)
        jet = self._vehicle.jets[int(status.suspected_jet)]
        jets = [int(status.suspected_jet)] if status.jet_isolated else []
        if report is not None:
            jets, *_ = jets_by_declaration(report.verdict_group, report.verdict_place)
        kinds = {Verdict.DECLARED: "jet", Verdict.WITHDRAWN: "withdrawn"}
        erratic = report is not None and report.verdict[int(status.suspected_jet)] == Word.ERRATIC
        separability: dict[str, Any] = {}
        if report is not None and not status.jet_isolated:
            jet_index, after_s = report.verdict_apart_by[jets[0]], report.verdict_apart_after[jets[0]]
            name = None if math.isnan(jet_index) else self._vehicle.designations[int(jet_index)]
            separability = {"told_apart_by": name, "told_apart_s": float(after_s)}
        return Detection(
            kinds.get(event, "erratic" if erratic else "changed"),
            status.onset,
            jet.cluster,
            jet.designation,
            bool(status.jet_isolated),
            status.suspected_magnitude,
            status.suspected_magnitude_std,
            tuple(self._vehicle.jets[j].designation for j in jets),
            **separability,
        )

    def _fields_without_jet(self, report: Any) -> dict[str, Any]:
        """Maps fields of a `Detection` to values, for a faulty sensor, a disturbance or a jump of mass properties."""
        if math.isfinite(report.lying_component):
            named = locate_reading(
                int(report.lying_component), params.vector_sensor_names(self._scenario), self._vehicle
            )
            return dict(zip(("sensor", "axis"), named, strict=True))
        if math.isfinite(report.disturbed_since):
            return {"torque_std": report.disturbance_torque, "force_std": report.disturbance_force}
        is_known = bool(np.isfinite(report.jump_position).all())
        return {
            "mass": report.jump_mass,
            "mass_std": report.jump_mass_std,
            "position": tuple(report.jump_position.tolist()) if is_known else None,
            "position_std": tuple(report.jump_position_std.tolist()) if is_known else None,
        }


def _event_kind(report: Any, sensor: str | None, vehicle: Vehicle) -> str:
    """Returns the kind of a detector's event that concerns neither a jet nor a new jump, as `Detection` has it."""
    if not math.isnan(report.jump_measured):
        return "jump_measured"
    if not math.isnan(report.disturbed_since):
        return "disturbance"
    return "unexplained" if sensor is None else sensor_event_kind(sensor, vehicle)


def _tracked_readings(readings: Mapping[str, ArrayLike] | None, vehicle: Vehicle) -> Array | None:
    """Stacks readings of the vehicle's `tracked` sensors, NaN where missing, shape (columns,); None: it has none."""
    given = dict(readings or {})
    names = [sensor.name for sensor in vehicle.tracked]
    unknown, or_wheel = [name for name in given if name not in names], ", and no wheel" if vehicle.wheels else ""
    if unknown:
        raise ValueError(f"tracked: '{unknown[0]}' is no sensor in a fixed frame{or_wheel}; the vehicle has {names}")
    if not names:
        return None
    sizes = {sensor.name: len(sensor.columns) for sensor in vehicle.tracked}
    return np.concatenate([_copy_numbers(given.get(name, np.full(n, np.nan)), (n,), name) for name, n in sizes.items()])


def _package_readings(
    readings: ArrayLike | Mapping[str, ArrayLike] | None, packages: Sequence[SensorPackage], label: str
) -> Array:
    """Stacks readings of sensor packages, that in use first, NaN where missing or saturated, shape (s, 3)."""
    if readings is None:
        return np.full((len(packages), 3), np.nan)
    if not isinstance(readings, Mapping):
        if not packages:
            raise ValueError(f"{label}: the vehicle has none; give None")
        readings = {packages[0].name: readings}
    known = [package.name for package in packages]
    unknown = [name for name in readings if name not in known]
    if unknown or not readings:
        problem = f"'{unknown[0]}' is no package" if unknown else "no reading"
        raise ValueError(f"{label}: {problem}; the vehicle has {known}")
    result = np.full((len(packages), 3), np.nan)
    for row, package in zip(result, packages, strict=True):
        if package.name in readings:
            row[:] = mask_saturated(_copy_numbers(readings[package.name], (3,), label), package.limit)
    return result


def _copy_numbers(values: ArrayLike, shape: tuple[int, ...], label: str) -> Array:
    """Returns a float copy of the caller's numbers after a check of shape and size; NaN: a missing value."""
    try:
        numbers = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{label} must be numbers of shape {shape}, got {reprlib.repr(values)}") from None
    if numbers.shape != shape:
        raise ValueError(f"{label} must have shape {shape}, got {numbers.shape}")
    if (np.abs(numbers) > LARGEST).any():
        raise ValueError(f"{label} must be finite and at most {LARGEST:g}, got {reprlib.repr(values)}")
    return numbers
