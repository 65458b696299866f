"""Records of the orbiter with faults of sensors, and with stamps off their ticks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from flights.flight import Array, Random, Record, setting
from massprop_drake import Run, load_scenario, simulate

_HAPPENING = ("failures", "jumps")  # blocks of a scenario besides its vehicle
_FINE_S = 1e-3
_PERIOD_S = 0.08


def as_flown(run: Run, random: Random | None = None) -> Record:
    """Returns telemetry of a run, unchanged."""
    velocities = {each.name: np.array(run[each.name]) for each in run.scenario.vehicle_data.accelerometers}
    return Record(np.array(run.time_s), np.array(run["gyro"]), velocities, np.array(run["command"]))


def _fired(run: Run, random: Random) -> int:
    """Draws a row after 30 s before which jets fired."""
    rows = np.flatnonzero((run.time_s[1:-20] > 30.0) & run["command"][:-21].any(axis=1)) + 1
    return int(random.choice(rows))


def false_reading(run: Run, random: Random) -> Record:
    """Makes one reading wrong: of the gyro by .02, .2 or 3 rad/s, of an accelerometer by 10 ft/s."""
    record, row, axis = as_flown(run), _fired(run, random), int(random.integers(3))
    kind = run.scenario.seed % 4
    if kind < 3:
        record.rates[row, axis] += (0.02, 0.2, 3.0)[kind]
    else:
        record.velocities["acc2"][row, axis] += 10.0
    return record


def still_axis(run: Run, random: Random) -> Record:
    """Freezes an axis of the gyro for a second while the vehicle turns."""
    record, axis = as_flown(run), int(random.integers(3))
    turning = np.flatnonzero(np.abs(np.diff(record.rates[:, axis])) > 1e-4)
    turning = turning[(record.time_s[turning] > 30.0) & (turning < len(record.time_s) - 30)]
    row = int(random.choice(turning))
    record.rates[row : row + 13, axis] = record.rates[row, axis]
    return record


def off_ticks(run: Run, random: Random) -> Record:
    """Reads sensors 1 ms off their ticks, 1 sigma, at most 2 ms, with true stamps.

    The commands are flown again with a sample each millisecond, and the readings next to those times are taken.
    """
    command, vehicle = np.array(run["command"]), run.scenario.vehicle_data
    pulses = []
    for jet, name in enumerate(vehicle.designations):
        edges = np.diff(np.concatenate(([0.0], command[:, jet], [0.0])))
        for begin, end in zip(np.flatnonzero(edges > 0.0), np.flatnonzero(edges < 0.0), strict=True):
            start_s = max(begin * _PERIOD_S - 1e-6, 0.0)
            pulses.append({"jet": name, "start_s": start_s, "end_s": end * _PERIOD_S - 1e-6})
    given = run.scenario.plant.mass_properties
    happening = [
        setting(key, [each.model_dump(mode="json") for each in getattr(run.scenario, key)]) for key in _HAPPENING
    ]
    settings = [
        *("estimation={filter: thesis}", "joint={}", "mass={}", "detector.kind=off", "maneuver=[]"),
        setting("jet_schedule", pulses),
        f"vehicle.sample_period_s={_FINE_S}",
        "plant.lag_factor=1.0",
        setting("plant.mass_properties", None if given is None else given.model_dump()),
        *(f"vehicle.jet_kinds.{kind}.time_constant_s={0.015 / 1.05}" for kind in ("primary", "vernier")),
        *("execution.engine=loop", setting("execution.compiled", run.scenario.execution.compiled)),
        *happening,
        *(f"duration_s={run.time_s[-1]}", f"seed={run.scenario.seed}"),
    ]
    fine = as_flown(simulate(load_scenario("orbiter_maneuver", settings)))
    off = np.round(np.clip(1e-3 * random.standard_normal(len(run.time_s)), -2e-3, 2e-3) / _FINE_S).astype(int)
    rows = np.clip(np.round(run.time_s / _FINE_S).astype(int) + off, 0, len(fine.time_s) - 1)
    velocities: dict[str, Array] = {name: values[rows] for name, values in fine.velocities.items()}
    return Record(fine.time_s[rows], fine.rates[rows], velocities, command)


def reversed_axis(run: Run, random: Random) -> Record:
    """Reverses the gyro's y axis."""
    record = as_flown(run)
    return record._replace(rates=record.rates * np.array([1.0, -1.0, 1.0]))


def late_readings(run: Run, random: Random) -> Record:
    """Reads the gyro 1 ms, 1 sigma, off the stamps."""
    record, quantum = as_flown(run), run.scenario.vehicle_data.gyros[0].quantum
    late = 1e-3 * random.standard_normal((len(record.rates), 1))
    slope = np.diff(run["rate"], axis=0) / _PERIOD_S
    after, before = np.vstack((slope, slope[-1:])), np.vstack((slope[:1], slope))
    moved = record.rates + late * np.where(late > 0.0, after, before)
    return record._replace(rates=np.round(moved / quantum) * quantum)


RECORDED: Mapping[str, Callable[[Run, Random], Record]] = {
    "as_flown": as_flown,
    "false_reading": false_reading,
    "late_readings": late_readings,
    "reversed_axis": reversed_axis,
    "still_axis": still_axis,
    "off_ticks": off_ticks,
}
