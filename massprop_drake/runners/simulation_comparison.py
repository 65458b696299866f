"""Comparison of a record with a simulation of the same commands, by the vehicle of another run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.errors import InputError, moment
from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.scenario import Scenario, load_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import MassPropertiesModel
from massprop_drake.maths.estimation.joint.burns import engine_impulse, make_burn, shut_engine_settings
from massprop_drake.maths.estimation.joint.modes import ERRORS, SIZE
from massprop_drake.maths.estimation.joint.wheels import interval_wheel_speeds
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, MASS_RECIPROCAL, join_ten_parameters
from massprop_drake.maths.signals import AGAINST
from massprop_drake.maths.vehicle import vehicle_cycle, wheel_motors
from massprop_drake.maths.vehicle.depletion import OutOfPropellantError
from massprop_drake.maths.vehicle.disturbance import move_to_center
from massprop_drake.maths.vehicle.engine_thrust import channel_mask
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    RATE,
    STRUCTURE,
    OutOfMassError,
    SpunUpError,
    add_wheel_momentum,
)
from massprop_drake.maths.vehicle.true_engines import draw_engine_errors
from massprop_drake.results.against import Against, SimulatedSide, declared_in_words, explain_differences, residuals
from massprop_drake.results.run_content import read_summary
from massprop_drake.results.spool import Spool, blocks
from massprop_drake.runners import pose_comparison

Array = NDArray[np.float64]


def compare_with_simulation(record: Run, folder: str | Path, *, spool_folder: Path | None = None) -> Run:
    """Adds to a record's run its residuals from a simulation of its commands, and what would explain them.

    The vehicle of the other run flies them: with its true mass properties, dispersions and failures where it was
    simulated, with its estimates where it is a record itself. Its times count from the record's first row. It begins,
    and begins anew after each gap, with the rate that the record read there, and is left to itself from then on; of a
    vehicle that is followed in a fixed frame it begins anew every ten seconds, with the motion that was estimated.

    Args:
        record: estimated from telemetry.
        folder: of the other run.
        spool_folder: where a temporary file with the signals may lie; default the system's place for such.

    Returns:
        The record's run with `against` in its results and, as signals `against.<package>`, what the simulation reads.

    Raises:
        InputError: when the folder holds no run, its vehicle is another one, or cannot fly these commands, or nothing
            tells what it is like.
    """
    require_comparable(record.scenario, folder)
    other_run = Run.load(folder)
    if record.scenario.estimation.filter == "pose":
        spool = Spool(spool_folder, index="time_s")
        found = pose_comparison.compare_in_fixed_frame(record, other_run, str(folder), spool)
        return Run(record.scenario, replace(record.results, against=found), None, spool, record.state)
    scenario = _make_scenario(other_run, str(folder))
    vehicle = _SimulatedVehicle(record.scenario, scenario, str(folder))
    spool = Spool(spool_folder, index="time_s")
    signals = record.signals
    columns = signals if isinstance(signals, Spool) else {"time_s": record.time_s, **signals}
    for block in blocks(columns, "time_s", *signals):
        onsets_s = block.get("command_onset", level_onsets(block["command"].shape))
        simulated = vehicle.simulate_readings((block["command"], onsets_s), block, block["time_s"])
        spool.append({**block, **{AGAINST + name: values for name, values in simulated.items()}})
    standing = [entry.onset_s for entry in record.results.detections if entry.withdrawn_s is None]
    onset_s = min(standing, default=None)
    reference = SimulatedSide(
        _parameters_before_jumps(other_run),
        _true_errors(scenario, record.scenario, rigid=bool(np.isfinite(other_run.results.truth).all())),
        params.plant_time_constants(scenario),
    )
    until_s = math.inf if onset_s is None else onset_s
    misfit, causes = explain_differences(record.scenario, spool, reference, until_s)
    declared = declared_in_words(record.results.detections, until_s, record.scenario.vehicle_data.unit_names)
    comparison = Against(str(folder), onset_s, misfit, residuals(record.scenario, spool), causes, declared)
    return Run(record.scenario, replace(record.results, against=comparison), None, spool, record.state)


def require_comparable(record: Scenario, folder: str | Path) -> None:
    """Raises InputError where a record cannot be compared with a simulation of another run's vehicle.

    Args:
        record: the scenario that it is estimated by.
        folder: of the other run.

    Raises:
        InputError: when the folder holds no run, or its vehicle is another one, or has joints.
    """
    read_summary(Path(folder))
    flown = load_scenario(Path(folder) / "scenario.yaml")
    if flown.plant.kind == "multibody":
        raise InputError(
            f"{folder}: its vehicle has joints, which a simulation beside a record lacks; give a run of a rigid one"
        )
    vehicle, other = record.vehicle_data, flown.vehicle_data
    alike: dict[str, tuple[Any, Any]] = {
        "jets": (vehicle.designations, other.designations),
        "sensors": (_sensor_names(vehicle), _sensor_names(other)),
        "units": (vehicle.units, other.units),
        "sample period": (vehicle.sample_period_s, other.sample_period_s),
    }
    if record.estimation.filter == "pose":
        alike |= {
            "motion": (vehicle.motion, other.motion),
            "places of jets": (_jet_geometry(vehicle), _jet_geometry(other)),
        }
    unlike = [name for name, (here, there) in alike.items() if here != there]
    if unlike:
        raise InputError(
            f"{folder}: is of vehicle '{other.name}', whose {' and '.join(unlike)} are not those of '{vehicle.name}'; "
            "give a run of the vehicle that the record is of"
        )


def _sensor_names(vehicle: Vehicle) -> list[str]:
    """Returns names of all sensors of a vehicle, those in a fixed frame last."""
    return vehicle.sensor_names() + [sensor.name for sensor in vehicle.tracked]


def _jet_geometry(vehicle: Vehicle) -> list[Any]:
    """Returns position and direction of every jet, by which two vehicles are compared."""
    return [(jet.position, jet.direction) for jet in vehicle.jets]


def _known_parameters(run: Run) -> Array:
    """Returns the ten parameters to simulate a run's vehicle with: truth, else estimate, else nominal, shape (10,)."""
    results = run.results
    known = np.where(np.isfinite(results.truth), results.truth, results.estimates)
    return np.where(np.isfinite(known), known, params.filter_setup(run.scenario).nominal)


def _parameters_before_jumps(run: Run) -> Array:
    """Returns the ten parameters before the first jump, the mass with propellant as at the end, shape (10,).

    What is explained are the readings before anything was declared, with what was simulated then.
    """
    known, period_s = _known_parameters(run), run.scenario.vehicle_data.sample_period_s
    jumps = [jump for jump in run.scenario.jumps if jump.time_s < run.time_s[-1]]
    if not jumps or not np.isfinite(run.results.truth).all():
        return known
    first_s = min(jump.time_s for jump in jumps)
    row = max(int(np.searchsorted(run.time_s, first_s - 0.5 * period_s)) - 1, 0)
    added_mass = sum(-jump.mass if jump.kind == "release" else jump.mass for jump in jumps)
    return join_ten_parameters(run["truth"][row, :MASS_RECIPROCAL], 1.0 / (1.0 / known[MASS_RECIPROCAL] - added_mass))


def _true_errors(scenario: Scenario, record: Scenario, *, rigid: bool) -> dict[str, Array]:
    """Maps groups of unknowns, as in `Columns`, to a simulated vehicle's true errors; `rigid`: its parts are locked.

    Args:
        scenario: of the simulation.
        record: of the record.
        rigid: whether parts that the file states to move are locked, as in a simulation.
    """
    vehicle = record.vehicle_data
    gyros, accelerometers = (
        [true_params.sensor_model(scenario, package) for package in packages(record)]
        for packages in (params.gyros, params.accelerometers)
    )
    sigmas, stated = np.repeat(vehicle.mounting_sigmas, 2, axis=1), np.array([one.propellant for one in vehicle.tanks])
    _, fill = true_params.true_tanks(scenario) or (None, stated)
    moving = params.filter_setup(record).modes.sigmas
    locked = -1.0 / np.where((np.arange(ERRORS) == SIZE) & (moving > 0.0) & rigid, moving, np.inf)
    disturbance = true_params.disturbance(scenario)
    torque, force = np.zeros((2, 3)) if disturbance is None else disturbance.mean.reshape(2, 3)
    acceleration = force / true_params.true_properties(scenario).mass
    return {
        "thrust": params.thrust_factors(scenario) - 1.0,
        "gyro_bias": np.mean([one.bias for one in gyros], axis=0),
        "acceleration_bias": np.ravel([one.bias + acceleration for one in accelerometers]),
        "torque": torque,
        "gyro_gain": np.ravel([one.scale_factor for one in gyros]),
        "accelerometer_gain": np.ravel([one.scale_factor for one in accelerometers]),
        "wheel": _true_wheel_inertias(scenario) / params.wheels(vehicle).inertias - 1.0,
        "engine": draw_engine_errors(true_params.true_engines(scenario), scenario.seed),
        "mount": (true_params.mounting_errors(scenario) / np.where(sigmas > 0.0, sigmas, np.inf))[sigmas > 0.0],
        "moving": locked.ravel(),
        "fill": fill - stated,
    }


def _true_wheel_inertias(scenario: Scenario) -> Array:
    """Draws the inertias of a simulated vehicle's wheels about their axes, shape (n_wheels,)."""
    return wheel_motors.draw_inertias(true_params.wheels_model(scenario), scenario.seed)


def _make_scenario(run: Run, folder: str) -> Scenario:
    """Returns the other run's scenario to simulate; of a record, with its estimates in place of the truth.

    Raises:
        InputError: when no rigid body can have these.
    """
    if np.isfinite(run.results.truth).all():
        return run.scenario
    derived, known = run.results.derived, _known_parameters(run)
    if derived.inertia is None or not derived.physically_possible:
        raise InputError(f"{folder}: no rigid body can have the inertia that it estimated: nothing to simulate")
    properties = MassPropertiesModel.model_construct(
        mass=1.0 / float(known[MASS_RECIPROCAL]),
        center_of_mass=tuple(known[CENTER_OF_MASS].tolist()),
        inertia=tuple(map(tuple, np.asarray(derived.inertia).tolist())),
    )
    transient = "vehicle" if params.estimator_time_constants(run.scenario).any() else "none"  # of the jets' lag
    plant = run.scenario.plant.model_copy(update={"mass_properties": properties, "thrust_transient": transient})
    return run.scenario.model_copy(update={"plant": plant})


class _Load(NamedTuple):
    """Loads on a vehicle over the interval before a row, besides its jets.

    Attributes:
        wrench: mean torque about the vehicle origin and force of engines and of known outside forces, shape (6,).
        used: propellant of the engines, slug or kg.
        wheels: angular momentum of the wheels at its beginning and its time derivative, body axes, shape (6,).
    """

    wrench: Array
    used: float
    wheels: Array


class _Interval(NamedTuple):
    """Interval from a row on: commands, sample number and draws, as `vehicle_cycle.step` takes them."""

    commands: tuple[Array, Array, Array]
    sample: int
    draw_row: tuple[vehicle_cycle.Ahead, int]


class _KnownLoads:
    """Loads of the wheels and engines of a simulated vehicle that turn and burn as a record reads them.

    Args:
        scenario: of the vehicle.
    """

    def __init__(self, scenario: Scenario):
        vehicle = self._vehicle = scenario.vehicle_data
        self._period_s = vehicle.sample_period_s
        self._wheels, self._motors = params.wheels(vehicle), true_params.wheels_model(scenario)
        self._inertias, self._engines = _true_wheel_inertias(scenario), params.engines(vehicle)
        self._errors = draw_engine_errors(true_params.true_engines(scenario), scenario.seed)
        self._speeds = np.full(len(vehicle.wheels), np.nan)
        self._settings, self._outside = shut_engine_settings(len(vehicle.engines)), np.zeros(6)

    def advance(self, readings: Mapping[str, Array]) -> _Load:
        """Advances to a row by its readings, NaN where nothing was read; returns the load since the row before."""
        read = np.array([readings[wheel.name][0] for wheel in self._vehicle.wheels])
        speeds, self._speeds = interval_wheel_speeds(self._speeds, read, self._period_s, self._wheels)
        accelerations = (speeds.end - speeds.start) / self._period_s
        wheels = wheel_motors.momentum(speeds.start, accelerations, self._inertias, self._motors)
        shown, has_channel = np.zeros(self._settings.now.shape), channel_mask(self._engines)
        for number, engine in enumerate(self._vehicle.engines):
            shown[number, has_channel[number]] = readings.get(engine.name, np.nan)
        burn, self._settings = make_burn(self._settings, shown, self._period_s, self._engines)
        burnt = engine_impulse(burn, self._errors, self._period_s, self._engines)
        wrench = self._outside + burnt.impulse / self._period_s
        self._outside = np.nan_to_num(readings.get("outside_wrench", self._outside))
        return _Load(wrench, burnt.used, wheels)


class _SimulatedVehicle:
    """Simulated vehicle that flies the commands of a record.

    Args:
        record: for the gyros that its rate is taken from.
        scenario: of the vehicle.
        source: what to call it in messages.
    """

    def __init__(self, record: Scenario, scenario: Scenario, source: str):
        self._true = true_params.vehicle_params(scenario)
        self._names = [package.name for package in self._true.packages]
        self._gyros = [package.name for package in params.gyros(record)]
        self._rates = [package.name for package in record.vehicle_data.gyros]
        self._truth = vehicle_cycle.pack_truth(self._true)
        self._sensor_errors = self._truth.packages.biases, self._truth.packages.scale_factors
        self._state = vehicle_cycle.initial_state(self._true)
        self._open = np.zeros(self._true.jets.forces.size)  # no manifold is closed
        self._known = _KnownLoads(scenario)
        self._coming: _Interval | None = None  # from the row before on
        self._source = source
        self._sample = 0
        self._has_begun = False  # whether it has begun with a rate of the record
        self._offsets: dict[str, Array] = {}

    def simulate_readings(
        self, commands: tuple[Array, Array], readings: Mapping[str, Array], time_s: Array
    ) -> dict[str, Array]:
        """Simulates a further block of rows; maps packages to readings, (n, 3), NaN where commands are unknown.

        Args:
            commands: from each row on, NaN where not known, and their onsets, see `maths.vehicle.on_times`, shape
                (n, n_jets) each.
            readings: of the record, by sensor, and known outside forces.
            time_s: of the rows.

        Raises:
            InputError: when it flies where nothing could follow.
        """
        simulated_readings = {name: np.full((time_s.size, 3), np.nan) for name in self._names}
        drawn = vehicle_cycle.draw_ahead(self._sample, time_s.size, self._true)
        for row, (command, onset_s) in enumerate(zip(*commands, strict=True)):
            recorded = {name: values[row] for name, values in readings.items()}
            load = self._known.advance(recorded)
            try:
                self._advance(load)
            except (OutOfMassError, OutOfPropellantError, SpunUpError) as error:
                raise InputError(
                    f"{self._source}: its vehicle cannot fly the record's commands: at t = {moment(time_s[row])} s it "
                    "runs out of propellant or makes over a turn in a sample; give a run of the vehicle of the record"
                ) from error
            if not self._has_begun:
                self._take_recorded_rate(recorded)
            simulated, memories = vehicle_cycle.sense(self._state, row, drawn, self._truth)
            self._state = self._state._replace(memories=memories)
            for name, values in zip(self._names, simulated, strict=True):
                offset = self._offset(name, values, recorded[name])
                simulated_readings[name][row] = values + offset if self._has_begun else np.nan
            if drawn.jumps[row]:
                self._state = vehicle_cycle.apply_sample_jumps(self._state, self._sample, self._true)
            self._coming = _Interval((np.nan_to_num(command), onset_s, self._open), self._sample, (drawn, row))
            self._sample += 1
            self._has_begun = self._has_begun and not np.isnan(command).all()
        return simulated_readings

    def _advance(self, load: _Load) -> None:
        """Advances the vehicle from the row before to this one, under its jets and what is known to act besides."""
        if self._coming is None:
            return
        truth, half_used = self._truth, np.zeros_like(self._state.body)
        if load.wrench.any():
            center, push = STRUCTURE.read(self._state.structure).center_of_mass, truth.push
            mean = push.mean + move_to_center(load.wrench, center)
            truth = truth._replace(pushed=True, push=push._replace(mean=mean))
        half_used[MASS] = 0.5 * load.used  # before and after the step, so that it has the mean mass
        constants = add_wheel_momentum(self._state.constants, load.wheels)
        state = self._state._replace(body=self._state.body - half_used, constants=constants)
        commands, sample, draw_row = self._coming
        state, _ = vehicle_cycle.step(state, commands, sample, draw_row, truth)
        self._state = state._replace(body=state.body - half_used)

    def _take_recorded_rate(self, readings: Mapping[str, Array]) -> None:
        """Sets the rate to the recorded one less the gyro's errors, if any is read; clears accelerometer offsets."""
        rates = np.array([readings[name] for name in self._gyros])
        is_read = np.isfinite(rates).all(axis=1)
        if is_read.any():
            body, first = self._state.body.copy(), int(np.flatnonzero(is_read)[0])
            bias, gain = (part[self._names.index(self._gyros[first])] for part in self._sensor_errors)
            body[RATE] = (rates[first] - bias) / (1.0 + gain)
            self._state = self._state._replace(body=body)
            self._has_begun, self._offsets = True, {}

    def _offset(self, name: str, simulated: Array, recorded: Array) -> Array:
        """Returns recorded minus simulated velocity, (3,): NaN until read, zero for gyros or before the first rate."""
        if name in self._rates or not self._has_begun:
            return _NOTHING
        if name not in self._offsets and np.isfinite(recorded).all():
            self._offsets[name] = recorded - simulated
        return self._offsets.get(name, _UNKNOWN)


_NOTHING, _UNKNOWN = np.zeros(3), np.full(3, np.nan)
