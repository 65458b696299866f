"""Comparison of a record in a fixed frame with a simulation of its commands.

The simulation is the estimator's own prediction with another run's vehicle: its truth where it was simulated, what was
learned of it where it is a record. A position is the sum of a sum of what jets give, so small errors grow fast: the
simulation begins anew every few seconds, where the record's own reading is and with the motion that it estimates there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.errors import InputError
from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_sensors import SensorPackage
from massprop_drake.maths import attitude
from massprop_drake.maths.estimation.filters.pose import PoseFilterParams, collect_readings
from massprop_drake.maths.estimation.pose import delays, pose_hindsight, setting
from massprop_drake.maths.estimation.pose.pose_hindsight import Assumed, PoseRecord
from massprop_drake.maths.estimation.pose.pose_hypotheses import SETTLING_S
from massprop_drake.maths.estimation.pose.pose_layout import PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.estimation.pose.pose_measurement import predict_readings
from massprop_drake.maths.estimation.pose.pose_prediction import predict_bank
from massprop_drake.maths.estimation.pose.pose_start import can_initialize, first_pose_sensor, tracked_point
from massprop_drake.maths.estimation.pose.turning import rotation_vectors
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, INVERSE_INERTIA, MASS_RECIPROCAL
from massprop_drake.maths.signals import AGAINST
from massprop_drake.maths.vehicle import true_failures
from massprop_drake.maths.vehicle.on_times import level_onsets, split_sample
from massprop_drake.results.against import Against, declared_in_words
from massprop_drake.results.against_followed import explain_differences, residuals
from massprop_drake.results.spool import Spool, blocks
from massprop_drake.results.stored import STATE_FILE
from massprop_drake.runners.logs import state_from_json

Array = NDArray[np.float64]

SPAN_S = 10.0  # after which the simulation begins anew
_MOST_ROWS = 5_000  # in which an explanation is sought


def compare_in_fixed_frame(record: Run, other_run: Run, folder: str, spool: Spool) -> Against:
    """Compares a record in a fixed frame with a simulation of its commands: residuals and possible causes.

    Args:
        record: estimated from telemetry.
        other_run: the run whose vehicle is simulated.
        folder: of it.
        spool: takes the record's signals, and what the simulation reads.

    Raises:
        InputError: when the other run does not tell what to simulate.
    """
    scenario = record.scenario
    filter_params: PoseFilterParams = params.estimation_params(scenario).filter_params
    vehicle = _assumed_vehicle(other_run, scenario, filter_params.pose, folder)
    pose_record = _pose_record(record, filter_params, other_run)
    simulated = _simulate_readings(pose_record, vehicle, filter_params.pose, record)
    signals, first = record.signals, 0
    columns = signals if isinstance(signals, Spool) else {"time_s": record.time_s, **signals}
    for block in blocks(columns, "time_s", *signals):
        rows = slice(first, first + block["time_s"].size)
        spool.append({**block, **{AGAINST + name: values[rows] for name, values in simulated.items()}})
        first = rows.stop
    until_s = _comparison_end_s(record, pose_record.time_s)
    misfit, causes = explain_differences(scenario, pose_record.until(until_s), vehicle, filter_params.pose)
    declared = declared_in_words(record.results.detections, until_s, scenario.vehicle_data.unit_names)
    limit_s = until_s if math.isfinite(until_s) else None
    return Against(folder, limit_s, misfit, residuals(scenario, spool), causes, declared)


def _comparison_end_s(record: Run, time_s: Array) -> float:
    """Returns when the comparison ends, s: at the first declared onset or after the most rows; infinity: no limit."""
    begun_s = [one.onset_s for one in record.results.detections if one.withdrawn_s is None]
    late = [onset_s for onset_s in begun_s if onset_s > time_s[0]]  # what was so all along is to be explained
    return float(min([*late, *time_s[_MOST_ROWS : _MOST_ROWS + 1]], default=math.inf))


# ------------------------------------------------------------------------------ what is simulated


def _assumed_vehicle(run: Run, scenario: Scenario, pose_params: PoseParams, folder: str) -> Assumed:
    """Returns the other run's vehicle to simulate, with thrust factors relative to the record's vehicle.

    Raises:
        InputError: when nothing tells it.
    """
    vehicle = (
        _true_vehicle(run, pose_params, folder)
        if np.isfinite(run.results.truth).all()
        else _estimated_vehicle(run, folder)
    )
    ratio = np.linalg.norm(run.scenario.vehicle_data.thrusts, axis=1)
    unknowns = vehicle.at.copy()
    unknowns[pose_params.parts.thrust] *= ratio / np.linalg.norm(scenario.vehicle_data.thrusts, axis=1)
    return vehicle._replace(at=unknowns)


def _true_vehicle(run: Run, pose_params: PoseParams, folder: str) -> Assumed:
    """Returns the true vehicle of a simulated run, with valves that act at once and without disturbance."""
    if run.scenario.jumps:
        raise InputError(
            f"{folder}: payloads come or leave in its simulation (jumps), which cannot be simulated beside a record "
            "that is followed in a fixed frame; give a run without"
        )
    parts, truth = pose_params.parts, run.results.truth
    unknowns = np.zeros(parts.size)
    unknowns[parts.thrust] = params.thrust_factors(run.scenario)
    unknowns[parts.common], unknowns[parts.spin], unknowns[parts.center] = (
        truth[part] for part in (MASS_RECIPROCAL, INVERSE_INERTIA, CENTER_OF_MASS)
    )
    unknowns[parts.lag][pose_params.kinds] = params.plant_time_constants(run.scenario)
    unknowns[parts.point] = np.ravel([pose.point for pose in run.scenario.vehicle_data.poses])
    return Assumed(unknowns)


def _estimated_vehicle(run: Run, folder: str) -> Assumed:
    """Returns the vehicle of a record by the last filter state: mass properties, thrusts and delays."""
    if run.scenario.estimation.filter != "pose" or not run.state:
        raise InputError(
            f"{folder}: neither simulated nor estimated by the filter of vehicles that are followed in a fixed frame "
            "(estimation.filter: pose), with its filter state beside it: nothing tells what to simulate"
        )
    run_params = params.estimation_params(run.scenario)
    state = state_from_json(run.state["states"], run_params, f"{folder}/{STATE_FILE}").filter
    bank = delays.merge_delays(state.tried, run_params.filter_params.pose)
    unknowns = pose_hindsight.unknowns_from_state(
        bank.mean[0], float(state.estimate[MASS_RECIPROCAL]), run_params.filter_params.pose
    )
    return Assumed(unknowns, max(int(bank.opens[0]), -1))


def _pose_record(record: Run, filter_params: PoseFilterParams, simulated_run: Run) -> PoseRecord:
    """Collects a record's readings and commands, and the levels that the other run's jets would deliver."""
    scenario, time_s = record.scenario, record.time_s
    sensors = scenario.vehicle_data.tracked
    tracked = np.hstack([record[sensor.name] for sensor in sensors]) if sensors else np.empty((time_s.size, 0))
    rates, velocities = (
        np.stack([_mask_saturated(record[package.name], package) for package in packages], axis=1)
        if packages
        else np.empty((time_s.size, 0, 3))
        for packages in (params.gyros(scenario), params.accelerometers(scenario))
    )
    readings = [collect_readings(*row, filter_params) for row in zip(tracked, rates, velocities, strict=True)]
    outside = record["outside_wrench"] if "outside_wrench" in record.signals else None
    commands = record["command"]
    onsets_s = record["command_onset"] if "command_onset" in record.signals else level_onsets(commands.shape)
    return PoseRecord(time_s, commands, readings, outside, _delivered_levels(commands, onsets_s, time_s, simulated_run))


def _mask_saturated(readings: Array, package: SensorPackage) -> Array:
    """Returns readings, shape (n, 3), with NaN in rows of which a component is saturated."""
    return np.where(np.all(np.abs(readings) < package.limit, axis=1, keepdims=True), readings, np.nan)


def _delivered_levels(commands: Array, onsets_s: Array, time_s: Array, simulated_run: Run) -> tuple[Array, Array]:
    """Computes times, s, and levels that a simulated vehicle's jets deliver for commands, failures included.

    Args:
        commands: commands from each row on, shape (n, n_jets).
        onsets_s: their onsets, s, see `maths.vehicle.on_times`, shape (n, n_jets).
        time_s: of the rows, shape (n,).
        simulated_run: the run of that vehicle.

    Returns:
        Times at which levels change, s, shape (k,), and the levels from then on, shape (k, n_jets).
    """
    failures = true_params.jet_failures(simulated_run.scenario) if simulated_run.scenario.failures else ()
    table, period_s = true_failures.failure_table(failures), simulated_run.scenario.vehicle_data.sample_period_s
    times_s, levels = [], []
    for row, since_s in enumerate((time_s - time_s[0]).tolist()):
        lengths_s, sample_levels = split_sample(commands[row], onsets_s[row], period_s, (0.0, period_s))
        begins_s = np.cumsum(lengths_s) - lengths_s
        if failures:
            strikes = true_failures.draw_strikes(failures, row, period_s, simulated_run.scenario.seed)
            for piece, level in enumerate(sample_levels):
                now_s, length_s = since_s + float(begins_s[piece]), float(lengths_s[piece])
                sample_levels[piece] = true_failures.apply_failures(level, now_s, length_s, strikes, table)
        times_s.append(time_s[row] + begins_s)
        levels.append(sample_levels)
    return np.concatenate(times_s), np.concatenate(levels)


# ------------------------------------------------------------------------------ what it then reads


def _simulate_readings(
    pose_record: PoseRecord, vehicle: Assumed, pose_params: PoseParams, record: Run
) -> dict[str, Array]:
    """Maps sensors to readings simulated from commands, a row per sample, NaN before the simulation has begun."""
    scenario, n_rows = record.scenario, pose_record.time_s.size
    movable = setting.movable_indices(params.filter_setup(scenario), pose_params.parts)
    known = pose_hindsight.known_vehicle_params(vehicle, movable, pose_params)
    first = next((row for row in range(n_rows) if can_initialize(pose_record.readings[row], known)), n_rows)
    first = int(np.searchsorted(pose_record.time_s, pose_record.time_s[min(first, n_rows - 1)] + SETTLING_S))
    motion = [record[f"{name}_estimate"] for name in ("position", "attitude", "velocity", "rate")]
    lost: np.ndarray = np.array(np.isnan(pose_record.levels).any(axis=1))
    readings = _empty_readings(scenario, n_rows)
    began_s = -math.inf
    for row in range(first, n_rows):
        now_s = float(pose_record.time_s[row])
        if row == first or now_s - began_s >= SPAN_S or lost[row - 1]:
            bank = _start_certain_filter([part[row] for part in motion], pose_record.readings[row], vehicle, known)
            began_s = now_s
        else:
            bank = predict_bank(bank, pose_record.commands(row), float(pose_record.time_s[row - 1]), now_s, known).bank
        _fill_readings(readings, row, predict_readings(bank, known), scenario)
    return readings


def _start_certain_filter(
    motion: list[Array], readings: PoseReadings, vehicle: Assumed, pose_params: PoseParams
) -> PoseBank:
    """Makes a filter with zero covariance at a motion, its position set by the first tracked point read."""
    (position, quaternion, velocity, rate), parts = motion, pose_params.parts
    mean, rotation, size = pose_params.start.copy(), attitude.rotation_matrix(quaternion), pose_params.free.size
    mean[parts.position], mean[parts.velocity], mean[parts.rate] = position, velocity, rate
    place = first_pose_sensor(readings)
    if place is not None:
        read_position = readings.positions[place] - rotation @ (mean[tracked_point(place, parts)] - mean[parts.center])
        mean[parts.position] = np.where(np.isfinite(read_position), read_position, position)
    mean[parts.gathered] = readings.gathered.ravel()
    opens = np.array([vehicle.opens])
    return PoseBank(
        mean[None], np.zeros((1, size, size)), rotation[None], opens, rate[None].copy(), np.zeros((1, 3, 3))
    )


def _empty_readings(scenario: Scenario, n_rows: int) -> dict[str, Array]:
    """Maps sensors to arrays of NaN, with a row per sample, for readings to be written into."""
    vehicle = scenario.vehicle_data
    readings = {sensor.name: np.full((n_rows, len(sensor.columns)), np.nan) for sensor in vehicle.tracked}
    return readings | {package.name: np.full((n_rows, 3), np.nan) for package in vehicle.sensors}


def _fill_readings(readings: dict[str, Array], row: int, ideal: PoseReadings, scenario: Scenario) -> None:
    """Writes ideal readings of all sensors into a row; of a pose sensor only the quantities that it measures."""
    vehicle = scenario.vehicle_data
    for place, pose in enumerate(vehicle.poses):
        turn = attitude.from_rotation_vector(rotation_vectors(ideal.rotations[place : place + 1])[0])
        measured = np.repeat((pose.position_std is not None, pose.attitude_std is not None), (3, 4))
        readings[pose.name][row] = np.where(measured, np.concatenate((ideal.positions[place], turn)), np.nan)
    packages = [sensor.name for sensor in (*params.gyros(scenario), *params.accelerometers(scenario))]
    names = [sensor.name for sensor in vehicle.velocities] + packages
    for name, reading in zip(names, (*ideal.velocities, *ideal.rates, *ideal.gathered), strict=True):
        readings[name][row] = reading
