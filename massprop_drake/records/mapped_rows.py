"""Rows a sample period apart, or at any time, of a record that a map explains."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.attitude import propagate_attitude
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.signals import AXES
from massprop_drake.maths.vehicle.on_times import onsets
from massprop_drake.records.blocks import Block, Table, require_meaningful
from massprop_drake.records.channels import (
    COMPONENTS,
    HOLE,
    SAME_S,
    TOLERANCE,
    Channel,
    HeldValues,
    Mapped,
    Places,
)
from massprop_drake.records.completeness import Loss, Ragged
from massprop_drake.records.reader import JITTER
from massprop_drake.records.rows import WRENCH, onset_columns

FEWEST_INSTANTS = 4  # samples of an acceleration a row from which its integral can be told
_SLOWER = 1.5  # times the rates' interval, above which PX4 is taken to have left out commands


class MappedTable(Table):
    """Rows of telemetry made by a map, as `records.reader.Reader` takes them."""

    def __init__(self, header: list[str], values: Array, lines: Places, record: Mapped, notes: list[str]):
        self.source = record.recording.source
        self.header, self.notes, self.information = header, notes, record.information
        self._values, self._lines, self._recording = values, lines, record.recording
        self.place = record.recording.topic(record.by.topic_of(record.by.sensors[record.by.row_sensor])).place
        self.ragged: Ragged = record.recording.ragged
        self.losses: Sequence[Loss] = record.recording.losses
        self._read = 0

    @property
    def done(self) -> float:
        """Fraction of the rows that have been read so far, 0 to 1."""
        return self._read / max(len(self._lines), 1)

    def blocks(self, indices: list[int]) -> Iterator[Block]:
        """Yields blocks of up to 1024 rows: line numbers, and values of the columns at these indices."""
        for start in range(0, len(self._lines), 1024):
            part = slice(start, start + 1024)
            self._read = min(start + 1024, len(self._lines))
            block = Block(self._lines[part], self._values[part][:, indices])
            require_meaningful(block, [self.header[column] for column in indices], self.source, self.place)
            yield block

    def sha256(self) -> str:
        """Returns SHA-256 of the recording's file, hexadecimal."""
        return self._recording.sha256


def row_indices(record: Mapped) -> Places:
    """Returns indices of a channel's samples that become rows: all, or of a faster channel one a sample period.

    Raises:
        InputError: when the sample period is no multiple of the channel's.
    """
    time_s, period_s = record.rows.time_s, record.vehicle.sample_period_s
    step = record.rows.interval_s
    if record.recording.kind == "ulog" and step > period_s * (1.0 + JITTER):
        raise InputError(
            f"{record.recording.source}: '{record.rows.name}' is logged every {step:.4g} s, too slowly for the sample "
            f"period of {period_s:g} s of vehicle '{record.vehicle.name}'; ask for more by SDLOG_PROFILE, or set "
            "sample_period_s"
        )
    if not step < period_s * (1.0 - JITTER):
        return np.arange(time_s.size)
    count = round(period_s / step)
    if count < 2 or abs(count * step - period_s) > JITTER * period_s:
        lower = max(math.floor(period_s / step), 1) * step
        raise InputError(
            f"{record.recording.source}: samples of '{record.rows.name}' are {step:.6g} s apart, and the sample "
            f"period of vehicle '{record.vehicle.name}' is {period_s:g} s, no multiple of it; set sample_period_s to "
            f"{lower:.6g} or {lower + step:.6g}"
        )
    indices = [0]
    while True:
        target = time_s[indices[-1]] + count * step
        index = int(np.searchsorted(time_s, target))
        if index >= time_s.size:
            final = [index - 1] if index - 1 > indices[-1] and target - time_s[-1] < 0.5 * step else []
            return np.array([*indices, *final])
        before = index - 1 > indices[-1] and target - time_s[index - 1] < time_s[index] - target
        indices.append(index - 1 if before else index)


def is_oversampled(record: Mapped) -> bool:
    """Tests whether the channel of the rows has several samples in a sample period of the vehicle."""
    return bool(record.rows.interval_s < record.vehicle.sample_period_s * (1.0 - JITTER))


def make_table(record: Mapped, gyro: str | None, *, own_times: bool = False) -> MappedTable:
    """Makes the table of telemetry rows that the estimators read, from the channels of a mapped record.

    Of a vehicle that is followed in a fixed frame, or with times of their own, there is a row whenever anything was
    read or commanded, and every reading stands at its own time. Of others:

    A reading that was not taken at the time of a row, within 5 % of the sample period, is missing in it. An attitude
    goes to the row that is nearest in time, turned there by the rate. Accelerations and increments are added up from
    row to row. Commands are the share of a row's interval for which a jet was open.

    Args:
        record: mapped.
        gyro: name of the package that the estimators need; None: of a vehicle that is followed in a fixed frame.
        own_times: whether every reading is wanted at its own time, also where rows are no samples.

    Raises:
        InputError: when the record has not what the estimators need.
    """
    if gyro is None:
        return _make_table_at_own_times(record)
    _require_gyro_and_axes(record, gyro)
    if own_times:
        return _make_table_at_own_times(record)
    indices = row_indices(record)
    time_s = record.rows.time_s[indices]
    vehicle, notes = record.vehicle, list(record.notes)
    names, parts = ["time_s"], [time_s[:, None]]
    trackers = {tracker.name for tracker in vehicle.poses}
    for name, channel in record.channels.items():
        if channel.kind in ("wheel", "engine"):
            names += [f"{name}_{part}" for part in COMPONENTS[channel.kind][: channel.values.shape[1]]]
            parts.append(_readings_at(channel, time_s, vehicle.sample_period_s))
            continue
        if name in trackers and channel.time_s.size:
            rates = _readings_at(record.channels[gyro], time_s, vehicle.sample_period_s)
            names += [f"{name}_{part.replace('_', '')}" for part in COMPONENTS["attitude"]]
            parts.append(_attitudes_at_rows(channel, rates, time_s, vehicle.sample_period_s))
            continue
        if channel.kind not in ("gyro", "accelerometer"):
            notes.append(
                f"{channel.kind} '{name}' of the map is not estimated from: vehicle '{vehicle.name}' has no such sensor"
            )
            continue
        if channel.gives in ("", "integral"):
            values, suffix = _readings_at(channel, time_s, vehicle.sample_period_s), ""
        else:
            values, suffix = _mean_acceleration(channel, time_s, vehicle, notes), "_accel"
        if not np.isfinite(values).all(axis=1).any():
            raise InputError(
                f"{record.recording.source}: no sample of '{name}' was taken within {100.0 * JITTER:g} % of a sample "
                f"period of a row, which is a sample of '{record.rows.name}'; name another in `rows`, or log faster"
            )
        names += [f"{name}{suffix}_{axis}" for axis in AXES]
        parts.append(values)
    fractions = _open_fractions(record, time_s)
    commands = _command_columns(record, time_s, fractions)
    names += commands
    parts += commands.values()
    notes += _describe_command_gaps(record, time_s, fractions)
    _add_known(record, time_s, names, parts)
    values = np.hstack(parts)
    topic = record.recording.topic(record.by.topic_of(record.by.sensors[record.by.row_sensor]))
    rows = record.rows.places[indices]
    lines = rows + 1 if topic.lines is None else topic.lines[rows]
    return MappedTable(names, values, lines, record, list(dict.fromkeys(notes)))


def _add_known(record: Mapped, time_s: Array, names: list[str], columns: list[Array]) -> None:
    """Appends the record's known outside force and torque, means over each interval, to names and columns."""
    for quantity, held_values in (("force", record.known_force), ("torque", record.known_torque)):
        if held_values is not None:
            names += [name for name in WRENCH if name.startswith(f"known_{quantity}")]
            columns.append(mean_over(held_values, time_s))


def _make_table_at_own_times(record: Mapped) -> MappedTable:
    """Makes the table of telemetry with a row at each time at which a sensor or a command has a sample."""
    vehicle, held = record.vehicle, record.commands
    channels = {name: channel for name, channel in record.channels.items() if channel.time_s.size}
    if not channels:
        raise InputError(f"{record.recording.source}: no sensor of the map has a sample")
    times = [*(channel.time_s for channel in channels.values()), held.begin_s, held.end_s]
    first = min(float(channel.time_s[0]) for channel in channels.values())
    last = max(float(channel.time_s[-1]) for channel in channels.values())
    stamps_s = np.unique(np.concatenate(times))
    stamps_s = stamps_s[(stamps_s >= first) & (stamps_s <= last)]
    time_s = stamps_s[np.append(True, np.diff(stamps_s) > SAME_S)]
    names, parts, notes = ["time_s"], [time_s[:, None]], list(record.notes)
    for name, channel in channels.items():
        values = np.full((time_s.size, channel.values.shape[1]), np.nan)
        values[np.searchsorted(time_s, channel.time_s - SAME_S)] = channel.values
        if channel.kind == "accelerometer" and channel.gives != "integral":
            values = _integrate_channel(channel, values, notes)
        names += [f"{name}_{part.replace('_', '')}" for part in COMPONENTS[channel.kind]]
        parts.append(values)
    names += [f"jet_{jet}" for jet in vehicle.designations]
    interval = np.searchsorted(held.begin_s, time_s + SAME_S, side="right") - 1
    known = (interval >= 0) & (time_s < held.end_s[np.maximum(interval, 0)] - SAME_S)
    if record.by.commands.is_timed:  # an on-time is of the interval that begins with it
        known &= np.append(True, np.diff(interval) > 0)
    commands = np.where(known[:, None], held.values[np.maximum(interval, 0)], np.nan)
    parts.append(commands)
    if record.by.commands.is_timed:
        names += onset_columns(vehicle)
        parts.append(onsets(commands, record.by.commands.at or vehicle.jet_commands.at, vehicle.sample_period_s))
    _add_known(record, time_s, names, parts)
    rows = np.clip(np.searchsorted(record.rows.time_s, time_s + SAME_S, side="right") - 1, 0, None)
    topic = record.recording.topic(record.by.topic_of(record.by.sensors[record.by.row_sensor]))
    logged_rows = record.rows.places[rows]
    lines = logged_rows + 1 if topic.lines is None else topic.lines[logged_rows]
    table = MappedTable(names, np.hstack(parts), lines, record, list(dict.fromkeys(notes)))
    table.own_times = True
    return table


def _integrate_channel(channel: Channel, values: Array, notes: list[str]) -> Array:
    """Integrates an accelerometer's samples to velocity; NaN in rows without a sample, shape (n, 3)."""
    complete = np.isfinite(values).all(axis=1)
    added = values[complete]
    if channel.gives != "increment":
        steps = np.diff(channel.time_s, prepend=channel.time_s[0] - channel.interval_s)
        steps = steps[np.isfinite(channel.values).all(axis=1)]
        if channel.gives == "instant":
            added = 0.5 * (added + np.vstack([added[:1], added[:-1]]))
            notes.append(f"'{channel.name}' is integrated from instants: approximate while jets switch")
        added = added * steps[:, None]
    result = np.full_like(values, np.nan)
    result[complete] = np.cumsum(added, axis=0)
    return result


def _require_gyro_and_axes(record: Mapped, gyro: str) -> None:
    """Raises InputError if the gyro in use is not mapped, or a gyro or accelerometer lacks an axis."""
    channel = record.channels.get(gyro)
    if channel is None:
        mapped = ", ".join(f"{one.kind} '{name}'" for name, one in record.channels.items())
        raise InputError(
            f"{record.source}: names {mapped}, and no gyro '{gyro}'; the estimators take rates from a gyro and "
            "velocities from integrating accelerometers; poses, attitudes and velocities are estimated from where the "
            "vehicle's file names their sensors, under `poses` and `velocities`"
        )
    for name, one in record.channels.items():
        lacking = [axis for axis, values in zip(AXES, one.values.T, strict=False) if not np.isfinite(values).any()]
        if one.kind in ("gyro", "accelerometer") and lacking:
            raise InputError(
                f"{record.source}: sensors.{name}: has no {', '.join(lacking)}; the estimators take a package of three "
                "axes, and cannot hold one still yet"
            )


def _readings_at(channel: Channel, time_s: Array, period_s: float) -> Array:
    """Returns a channel's readings at given times, NaN where none is within 5 % of a sample period, shape (n, m)."""
    nearest = np.clip(np.searchsorted(channel.time_s, time_s), 0, channel.time_s.size - 1)
    before = np.maximum(nearest - 1, 0)
    closer = np.abs(channel.time_s[before] - time_s) < np.abs(channel.time_s[nearest] - time_s)
    nearest = np.where(closer, before, nearest)
    is_near = np.abs(channel.time_s[nearest] - time_s) <= JITTER * period_s
    return np.where(is_near[:, None], channel.values[nearest], np.nan)


def _attitudes_at_rows(channel: Channel, rates: Array, time_s: Array, period_s: float) -> Array:
    """Returns quaternions at rows, nearest reading turned there by the rate, NaN if none is near, shape (n, 4)."""
    readings, attitudes = channel.values[:, -4:], np.full((time_s.size, 4), np.nan)
    after = np.clip(np.searchsorted(time_s, channel.time_s), 1, max(time_s.size - 1, 1))
    rows = np.where(channel.time_s - time_s[after - 1] < time_s[after] - channel.time_s, after - 1, after)
    off_s = time_s[rows] - channel.time_s
    for index in np.argsort(-np.abs(off_s), kind="stable").tolist():
        row, turn_s = rows[index], float(off_s[index])
        if abs(turn_s) <= SAME_S:
            attitudes[row] = readings[index]
        elif abs(turn_s) <= 0.5 * period_s * (1.0 + JITTER):
            attitudes[row] = propagate_attitude(readings[index], rates[row], turn_s)
    return attitudes


def _mean_acceleration(channel: Channel, time_s: Array, vehicle: Vehicle, notes: list[str]) -> Array:
    """Computes mean acceleration in the interval before each row, NaN if a sample is missing, shape (n, 3)."""
    period_s = vehicle.sample_period_s
    interval_s, steps = channel.interval_s, np.diff(channel.time_s, prepend=np.nan)
    if math.isnan(interval_s):
        return np.full((time_s.size, 3), np.nan)
    count = round(period_s / interval_s)
    steps[0] = interval_s
    steps = steps[:, None]
    if channel.gives == "instant":
        if count < FEWEST_INSTANTS:
            raise InputError(
                f"sensor '{channel.name}': an acceleration taken at an instant, {count or 'less than one'} times a "
                f"sample period of {period_s:g} s, does not tell what the jets gave in between; log it "
                f"{FEWEST_INSTANTS} times a period at least, or log increments, or say `gives: mean` if it averages"
            )
        before = np.vstack([np.full((1, 3), np.nan), channel.values[:-1]])
        added = 0.5 * (before + channel.values) * steps
        notes.append(
            f"'{channel.name}' is integrated from {count} instants a row: approximate while jets switch, and late by "
            "what the recorder's filter delays"
        )
    else:
        added = channel.values * (steps if channel.gives == "mean" else 1.0)
    is_hole = np.isnan(added) | (steps > HOLE * interval_s)
    integral = np.cumsum(np.where(is_hole, 0.0, added), axis=0)
    holes = np.cumsum(is_hole, axis=0)
    at_rows = _readings_at(channel._replace(values=np.hstack([integral, holes])), time_s, period_s)
    change = np.diff(at_rows, axis=0, prepend=np.full((1, 6), np.nan))
    mean = np.where(change[:, 3:] == 0.0, change[:, :3], np.nan) / period_s
    if count <= 1 and not is_hole[0].any():  # what the first sample gives is of the time before it
        mean[0] = added[0] / period_s
    return mean


def mean_over(held_values: HeldValues, time_s: Array) -> Array:
    """Computes time means of commands or a wrench from each row to the next, NaN where unknown, shape (n, m)."""
    count, width = time_s.size, held_values.values.shape[1]
    if not held_values.begin_s.size or count < 2:
        return np.full((count, width), np.nan)
    typical = float(np.median(np.diff(time_s)))
    ends = np.minimum(np.append(time_s[1:], time_s[-1] + typical), time_s + HOLE * typical)
    known = np.isfinite(held_values.values)
    edges = np.stack([held_values.begin_s, held_values.end_s], axis=1).ravel()
    edges = np.where(np.isfinite(edges), edges, max(float(ends[-1]), float(held_values.begin_s[-1])) + typical)
    lengths = np.diff(edges)[::2, None]

    def integral(density: Array) -> Array:
        """Integrates a density to each edge of the holding intervals; zero density between them."""
        summed = np.cumsum(density * lengths, axis=0)
        return np.repeat(np.vstack([np.zeros((1, width)), summed]), 2, axis=0)[1:-1]

    amounts, covers = integral(np.where(known, held_values.values, 0.0)), integral(known.astype(float))
    result = np.full((count, width), np.nan)
    for column in range(width):
        amount, cover = (
            np.interp(ends, edges, total[:, column]) - np.interp(time_s, edges, total[:, column])
            for total in (amounts, covers)
        )
        whole = cover >= (ends - time_s) * (1.0 - 1e-3)
        result[whole, column] = amount[whole] / cover[whole]
    return result


def _open_fractions(record: Mapped, time_s: Array) -> Array:
    """Computes fractions of the interval from each row in which each jet is open, shape (n, n_jets)."""
    shares = mean_over(record.commands, time_s)
    whole = np.round(shares)  # what is exact stays exact
    return np.where(np.abs(shares - whole) < TOLERANCE, whole, shares)


def _command_columns(record: Mapped, time_s: Array, fractions: Array) -> dict[str, Array]:
    """Maps column names to commands, shape (n, 1): fractions, and onsets of jets that switch within rows."""
    vehicle, part = record.vehicle, record.by.commands
    period_s, opening = vehicle.sample_period_s, None
    columns = {f"jet_{jet}": fraction for jet, fraction in zip(vehicle.designations, fractions.T, strict=True)}
    if part.is_timed and _partly_open(fractions).any():
        opening = onsets(fractions, part.at or vehicle.jet_commands.at, period_s)
    elif _switches_within(record, fractions):
        opening = _centered_onsets(record.commands, time_s, fractions, period_s)
    if opening is not None:
        columns |= dict(zip(onset_columns(vehicle), opening.T, strict=True))
    return {name: values[:, None] for name, values in columns.items()}


def _partly_open(fractions: Array) -> NDArray[np.bool_]:
    """Flags fractions strictly between 0 and 1, in the shape given."""
    return (fractions > 0.0) & (fractions < 1.0)


def _switches_within(record: Mapped, fractions: Array) -> bool:
    """Tests whether jets logged as open or closed switch between one row and the next."""
    values = record.commands.values
    whole = np.isin(values, (0.0, 1.0)) | np.isnan(values)
    return bool(whole.all() and _partly_open(fractions).any())


def _centered_onsets(held_values: HeldValues, time_s: Array, fractions: Array, period_s: float) -> Array:
    """Computes onsets that center each jet's on-time in a row, s, NaN where not partly open, shape (n, n_jets)."""
    ends_s = np.append(time_s[1:], time_s[-1] + period_s)
    onsets_s = np.full_like(fractions, np.nan)
    for row, jet in np.argwhere(_partly_open(fractions)).tolist():
        begin_s, end_s = np.clip((held_values.begin_s, held_values.end_s), time_s[row], ends_s[row])
        on_s = (end_s - begin_s) * (held_values.values[:, jet] > 0.0)
        middle_s = float(on_s @ (0.5 * (begin_s + end_s))) / float(on_s.sum()) - time_s[row]
        length_s = fractions[row, jet] * period_s
        onsets_s[row, jet] = min(max(middle_s - 0.5 * length_s, 0.0), period_s - length_s)
    return onsets_s


def _describe_command_gaps(record: Mapped, time_s: Array, fractions: Array) -> list[str]:
    """Returns a sentence for each way in which commands are logged too seldom, or are unknown or ambiguous."""
    found = []
    commands, period_s = record.commands, record.vehicle.sample_period_s
    every = float(np.median(np.diff(commands.begin_s))) if commands.begin_s.size > 1 else math.nan
    if every > period_s * (1.0 + JITTER) and not record.by.commands.on_change:
        found.append(
            f"commands are logged every {every:.4g} s, and a sample is {period_s:g} s: firings in between are lost"
        )
    elif record.recording.kind == "ulog" and every > _SLOWER * record.rows.interval_s:  # PX4 logs what it likes of them
        found.append(
            f"commands are logged every {every:.4g} s, and '{record.rows.name}' every {record.rows.interval_s:.4g} s: "
            "what happened in between is not in the log; ask for more by SDLOG_PROFILE"
        )
    if _switches_within(record, fractions):
        rows = int(_partly_open(fractions).any(axis=1).sum())
        found.append(
            f"in {rows} of {time_s.size} rows a jet switches within the row: one that opens more than once there is "
            "taken to be open for as long in one piece"
        )
    unknown = np.isnan(fractions[:-1]).any(axis=1) if len(fractions) > 1 else np.zeros(0, dtype=bool)
    if unknown.any():
        found.append(f"in {int(unknown.sum())} of {time_s.size} rows a command is not known")
    return found


def preview_rows(record: Mapped, max_rows: int = 5) -> list[dict[str, Any]]:
    """Returns the first rows of a mapped record as dicts of time, readings and open jets, for display.

    Returns:
        For each `time_s`, `sensors` (values by component, by name; None where missing), and `jets` (fraction by
        designation, of those that are open; None where not known).
    """
    at_any_time = record.vehicle.needs_pose_filter or is_oversampled(record)  # each sample is a row then
    time_s = record.rows.time_s if at_any_time else record.rows.time_s[row_indices(record)]
    times = time_s[:max_rows]
    fractions = _open_fractions(record, time_s)[:max_rows]
    readings = {
        name: _readings_at(channel, times, record.vehicle.sample_period_s) for name, channel in record.channels.items()
    }
    rows = []
    for index, time in enumerate(times.tolist()):
        sensors = {}
        for name, channel in record.channels.items():
            values = [None if math.isnan(one) else one for one in readings[name][index].tolist()]
            sensors[name] = dict(zip(COMPONENTS[channel.kind], values, strict=False))  # an engine may have no angles
        commands = dict(zip(record.vehicle.designations, fractions[index].tolist(), strict=True))
        jets = {jet: None if math.isnan(share) else share for jet, share in commands.items() if share != 0.0}
        rows.append({"time_s": time, "sensors": sensors, "jets": jets})
    return rows
