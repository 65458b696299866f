"""Sensor readings and jet commands, and rows of telemetry, from a recording and a map.

`apply_map` gives every channel of the map at its own times, in the vehicle's units and axes: poses and attitudes as
well as rates. `table` makes of them the rows that the estimators read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs import plausible
from massprop_drake.inputs.record_map import (
    AccelerometerMap,
    AttitudeMap,
    CommandMap,
    EngineMap,
    GyroMap,
    PoseMap,
    RecordMap,
    RecordTime,
    VelocityMap,
    WheelMap,
    rotation_of,
)
from massprop_drake.inputs.units import is_unit_of, si_factor
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.blocks import LARGEST
from massprop_drake.records.channels import HOLE, SAME_S, TOLERANCE, Channel, HeldValues, Mapped, Places
from massprop_drake.records.reader import JITTER
from massprop_drake.records.topics import Recording, Topic

_EPOCH_S = 1e8  # stamps beyond this count from a day in history, and are made to count from their first
_FASTEST = 100.0  # rad/s, beyond which no gyro of a vehicle measures
RATE_UNITS = ("rad/s", "deg/s", "mrad/s", "mdeg/s")  # of gyros, the largest first
_SHARE = 0.01  # of the samples that must be impossible before the unit is
_SPIKES = 2  # that there may be, however few samples
_UNIT_NORM = 0.02  # by which a quaternion's length may differ from 1
_UNSURE = 0.02  # of a step that is taken from differences, above which the median step is better
_MOST_UNSURE = 0.5  # share of steps that may be so
AGREE = 2e-3  # of steps by several pairs, relative: rounding leaves less
MOVING = 0.05  # of its largest, below which a rate tells no step by itself
SCATTER = 0.3  # of steps from differences, relative, beyond which they are none
_NEAR_A_TURN = 15.0  # of 360, by which an angle in degrees jumps where it is wrapped
_DECIMALS = 12  # to which logs are rounded at the most
_KINDS = {
    **{"gyros": "gyro", "accelerometers": "accelerometer", "velocities": "velocity"},
    "poses": "pose",
    "wheels": "wheel",
    "engines": "engine",
}  # of a map, by what the vehicle calls them; an attitude is a pose without position
_ESTIMATED_FROM = ("gyro", "accelerometer", "wheel", "engine")  # kinds that are of no use but for that


def apply_map(
    recording: Recording, by: RecordMap, vehicle: Vehicle, source: str = "map", *, limits: bool = True
) -> Mapped:
    """Applies a map to a recording: returns readings and commands in the vehicle's units and body axes.

    Args:
        recording: what was read.
        by: the map.
        vehicle: whose sensors and jets it names.
        source: what to call the map in messages.
        limits: refuse rates and accelerations that cannot be.

    Raises:
        InputError: when map, recording and vehicle do not belong together, a clock goes back, or a unit cannot be.
    """
    _require_vehicle_parts(by, vehicle, source)
    work = _Mapping(recording, by, vehicle, source)
    work.limits = limits
    channels = {name: work.channel(name, sensor) for name, sensor in by.sensors.items()}
    commands = work.commands(by.commands)
    force, torque = (None if part is None else work.force_or_torque(part) for part in (by.known_force, by.known_torque))
    notes = (*recording.notes, *dict.fromkeys(work.notes))
    information = (*recording.information, *dict.fromkeys(work.information))
    return Mapped(recording, by, source, vehicle, channels, commands, force, torque, notes, information)


def _require_vehicle_parts(record_map: RecordMap, vehicle: Vehicle, source: str) -> None:
    """Raises InputError where sensors or jets in a map do not match the vehicle's."""
    problems = []
    kinds = {package.name: kind for key, kind in _KINDS.items() for package in getattr(vehicle, key)}
    for name, sensor in record_map.sensors.items():
        kind = "pose" if sensor.kind == "attitude" else sensor.kind
        if kinds.get(name) == kind:
            continue
        if name in kinds:
            problems.append(
                f"{source}: sensors.{name}: is a {kinds[name]} of the vehicle, and the map has a {sensor.kind}"
            )
        elif kind in _ESTIMATED_FROM or kind in kinds.values() or vehicle.needs_pose_filter:
            known = [one for one, of in kinds.items() if of == kind]
            hint = suggestion(name, known) or f"; it has no {kind}"
            problems.append(f"{source}: sensors.{name}: vehicle '{vehicle.name}' has no {kind} of this name{hint}")
    map_jets = record_map.commands.jets
    if map_jets is not None:
        jets = list(vehicle.designations)
        unknown = [jet for jet in map_jets if jet not in jets]
        lacking = [jet for jet in jets if jet not in map_jets]
        if unknown:
            problems.append(
                f"{source}: commands: '{unknown[0]}' is no jet of vehicle '{vehicle.name}'"
                f"{suggestion(unknown[0], jets)}"
            )
        elif lacking:
            problems.append(f"{source}: commands: does not say where to find jet {', '.join(lacking)}")
    if problems:
        raise InputError(*problems)


class _Mapping:
    """Conversion of parts of a map into channels."""

    def __init__(self, recording: Recording, record_map: RecordMap, vehicle: Vehicle, source: str):
        self._recording, self._by, self._vehicle, self._source = recording, record_map, vehicle, source
        self._length = plausible.FOOT if vehicle.units == "us" else 1.0  # m, of the vehicle's unit
        self._force = plausible.SLUG * plausible.FOOT if vehicle.units == "us" else 1.0
        self._timed: dict[tuple[str, str], tuple[Array, Places]] = {}
        self._zero_s: float | None = None
        self.limits = True  # of rates and accelerations
        self.notes: list[str] = []
        self.information: list[str] = []
        self._stamps(record_map.sensors[record_map.row_sensor])  # whose first stamp others count from

    # ------------------------------------------------------------------------------------ time

    def _stamps(self, entry: Any) -> tuple[Array, Places]:
        """Returns times, s, and topic rows of the samples of a sensor or commands; rows without a time are left out."""
        name, time = self._by.topic_of(entry), entry.time or self._by.time
        key = name, time.model_dump_json()
        if key not in self._timed:
            self._timed[key] = self._timed_rows(self._recording.topic(name), time)
        return self._timed[key]

    def _timed_rows(self, topic: Topic, time: RecordTime) -> tuple[Array, Places]:
        """Returns a topic's increasing times, s, and the rows that have them; notes rows that it leaves out."""
        logged = self._logged_times(topic, time)
        if not logged.size:
            raise InputError(f"{topic.source}: is empty: it has no row of data")
        rows = np.flatnonzero(np.isfinite(logged))
        if not rows.size:
            raise InputError(f"{topic.source}: no row has a time")
        if rows.size < logged.size:
            self.notes.append(f"{topic.source}: {logged.size - rows.size} rows left out that have no time")
        found = logged[rows]
        if (wild := np.abs(found) > LARGEST).any():
            at = int(np.argmax(wild))
            raise InputError(f"{topic.where(int(rows[at]))}: its time, {found[at]:g} s, is too large to mean anything")
        backward = np.flatnonzero(np.diff(found) < -SAME_S)
        if backward.size:
            at = int(backward[0])
            raise InputError(
                f"{topic.where(int(rows[at + 1]))}: time goes back, from {found[at]:.9g} to {found[at + 1]:.9g} s; "
                "has the clock been set? Give the parts one by one"
            )
        advances = np.concatenate([[True], np.diff(found) > SAME_S])
        if advances.sum() < 0.5 * advances.size:
            hint = "" if time.column is None else f"; does {time.column} hold the time, in {time.unit}?"
            raise InputError(f"{topic.source}: most rows have the time of the row before{hint}")
        if not advances.all():
            self.notes.append(
                f"{topic.source}: {int((~advances).sum())} rows left out whose time is that of the row before"
            )
            rows, found = rows[advances], found[advances]
        if time.differences:
            found = self._recover_times(topic, time, found, rows)
        found = found[0] + (found - found[0]) / (1.0 + time.drift) + time.offset_s
        if self._zero_s is None:
            self._zero_s = float(np.floor(found[0])) if abs(found[0]) > _EPOCH_S else 0.0
            if self._zero_s:
                self.information.append(f"{topic.source}: times count from {self._zero_s:.0f} s of its clock")
        return found - self._zero_s, rows

    def _logged_times(self, topic: Topic, time: RecordTime) -> Array:
        """Returns a topic's times as logged, s, NaN where missing: a column's, its stamps, or row numbers."""
        if time.column is not None:
            whole = topic.times_s(time.column, si_factor(time.unit, "time"), time.date)
            if time.fraction is None:
                return whole
            return whole + topic.numbers(time.fraction) * si_factor(time.fraction_unit, "time")
        if topic.stamps_s is not None:
            return topic.stamps_s
        if time.differences:  # without any stamp: the steps alone
            return np.arange(topic.rows, dtype=float)
        raise InputError(
            f"{self._source}: {topic.source} has no stamps of its own: name the column, `time: {{column: ...}}`"
        )

    def _recover_times(self, topic: Topic, time: RecordTime, logged_s: Array, rows: Places) -> Array:
        """Recovers the times of rows, s, from the true steps, by which logged rates were differenced."""
        if logged_s.size < 2:
            raise InputError(f"{topic.source}: has one row, and times are to come from differences")
        weight, product = np.zeros(logged_s.size - 1), np.zeros(logged_s.size - 1)
        steps_by_pair = []
        for pair in time.differences:
            value, size = topic.numbers(pair.value)[rows], si_factor(pair.value_unit, "length", "angle")
            quantum, value = _rounding_step(value) * size, value * size
            rate = topic.numbers(pair.rate)[rows[1:]] * si_factor(pair.rate_unit, "velocity", "rate")
            step = np.diff(value)
            if is_unit_of(pair.value_unit, "angle"):
                step = (step + np.pi) % (2.0 * np.pi) - np.pi
            both = np.isfinite(step) & np.isfinite(rate)
            # each in units of its rounding, so that pairs of unlike quantities weigh alike
            weight += np.where(both, (rate / quantum) ** 2, 0.0)
            product += np.where(both, rate * step / quantum**2, 0.0)
            well = both & (np.abs(rate) > MOVING * np.nanmax(np.abs(rate), initial=0.0))
            steps_by_pair.append(np.divide(step, rate, out=np.full(step.size, np.nan), where=well))
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = product / weight
            spread = 0.5 / np.sqrt(weight) / np.abs(steps)  # of two roundings, relative
        sure = np.isfinite(steps) & (steps > 0.0) & (spread < _UNSURE)
        if sure.mean() < 1.0 - _MOST_UNSURE:
            raise InputError(
                f"{self._source}: time.differences: {100.0 * (1.0 - sure.mean()):.0f} % of the steps cannot be taken "
                f"from {', '.join(f'{pair.value} and {pair.rate}' for pair in time.differences)}: they do not move, or "
                "the rate is no backward difference"
            )
        typical = float(np.median(steps[sure]))
        if float(np.median(np.abs(steps[sure] / typical - 1.0))) > SCATTER:
            raise InputError(
                f"{self._source}: time.differences: the steps scatter by more than {100.0 * SCATTER:g} % about "
                f"{typical:.4g} s: the rate is no backward difference of the value, or its unit is another"
            )
        if step_disagreement(np.array(steps_by_pair)) > AGREE:
            raise InputError(
                f"{self._source}: time.differences: {', '.join(pair.rate for pair in time.differences)} would have "
                "been taken over unlike steps in the same row: one is no backward difference, or of another unit"
            )
        nominal = np.diff(logged_s)
        usual = float(np.median(nominal))
        # where several rows are lacking the nominal time knows by how many
        steps = np.where(sure, steps, typical * nominal / usual)
        text = f", where the log says {usual:.6g} s" if abs(typical - usual) > 1e-3 * typical and usual != 1.0 else ""
        self.notes.append(
            f"{topic.source}: steps are taken from differences, {typical:.6g} s in the median{text}; "
            f"{int((~sure).sum())} of {sure.size} are the median step"
        )
        return logged_s[0] + np.concatenate([[0.0], np.cumsum(steps)])

    # --------------------------------------------------------------------------------- sensors

    def channel(self, name: str, sensor: Any) -> Channel:
        """Makes the channel of a sensor: values in the vehicle's units and body axes, with their times."""
        time_s, rows = self._stamps(sensor)
        topic = self._recording.topic(self._by.topic_of(sensor))
        gives = ""
        if isinstance(sensor, GyroMap):
            values = self._vector(topic, sensor, si_factor(sensor.unit, "rate"), rows)
            self._require_plausible_rates(name, topic, sensor.unit, values)
        elif isinstance(sensor, AccelerometerMap):
            gives = sensor.gives
            values = self._vector(
                topic, sensor, si_factor(sensor.unit, "velocity", "acceleration") / self._length, rows
            )
            self._require_plausible_accelerations(name, topic, sensor, values, time_s)
        elif isinstance(sensor, VelocityMap):
            values = self._vector(topic, sensor, si_factor(sensor.unit, "velocity") / self._length, rows)
        elif isinstance(sensor, WheelMap):
            values = topic.numbers(sensor.speed)[rows, None] * si_factor(sensor.unit, "rate")
        elif isinstance(sensor, EngineMap):
            values = topic.numbers(sensor.level)[rows, None] / sensor.full
            if sensor.gimbal is not None:
                angles = np.stack([topic.numbers(one)[rows] for one in sensor.gimbal], axis=1)
                values = np.hstack((values, angles * si_factor(sensor.unit, "angle")))
        else:
            values = self._quaternions(topic, sensor, rows)
            self._require_plausible_turns(name, topic, sensor, values, time_s)
            if isinstance(sensor, PoseMap):
                position = self._three_columns(topic, sensor.position, rows) * (
                    si_factor(sensor.unit, "length") / self._length
                )
                values = np.hstack([_rotate_vectors(position, rotation_of(sensor.world_axes)), values])
        if not np.isfinite(values).any():
            raise InputError(f"{topic.source}: sensor '{name}' has no reading: every value is missing")
        if sensor.every > 1:
            values = self._drop_repeats(name, topic, values, sensor.every)
        return Channel(name, sensor.kind, time_s, values, rows, gives)

    def _drop_repeats(self, name: str, topic: Topic, values: Array, every: int) -> Array:
        """Replaces readings by NaN in all but one of `every` rows, as they repeat the reading before."""
        rows = find_changes(values)
        off = rows[(rows - rows[:1]) % every != 0]
        if off.size:
            raise InputError(
                f"{self._source}: sensors.{name}.every: {every} does not fit {topic.source}, where its reading changes "
                f"in rows {rows[0] + 1} and {off[0] + 1}"
            )
        fresh = (np.arange(len(values)) - (rows[0] if rows.size else 0)) % every == 0
        self.information.append(f"{topic.source}: sensor '{name}' has a reading in every {every} rows, as the map says")
        return np.where(fresh[:, None], values, np.nan)

    def _three_columns(self, topic: Topic, columns: Sequence[str | None], rows: Places) -> Array:
        """Returns three columns' numbers at rows of a topic, NaN for an axis without a column, shape (n, 3)."""
        nothing = np.full(rows.size, np.nan)
        return np.column_stack([nothing if column is None else topic.numbers(column)[rows] for column in columns])

    def _vector(self, topic: Topic, entry: Any, scale: float, rows: Places) -> Array:
        """Returns vectors from three columns, less their zero, scaled and turned to body axes, shape (n, 3)."""
        return _rotate_vectors(
            (self._three_columns(topic, entry.columns, rows) - np.array(entry.zero)) * scale, entry.matrix
        )

    def _quaternions(self, topic: Topic, sensor: AttitudeMap | PoseMap, rows: Places) -> Array:
        """Computes quaternions that turn body to world, scalar first, NaN where missing, shape (n, 4)."""
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 (slow to load)

        quaternions = np.full((rows.size, 4), np.nan)
        if not sensor.forms:  # a position alone
            return quaternions
        if sensor.quaternion is not None:
            logged = np.column_stack([topic.numbers(one)[rows] for one in sensor.quaternion])
            self._require_unit_quaternions(topic, sensor.quaternion, logged, rows)
            logged = logged if sensor.order == "xyzw" else np.roll(logged, -1, axis=1)
            finite = np.isfinite(logged).all(axis=1)
            turns = Rotation.from_quat(logged[finite])
        else:
            size = si_factor(sensor.angle_unit, "angle")
            if sensor.heading is not None:
                logged = topic.numbers(sensor.heading)[rows, None] * size * np.array([0.0, 0.0, 1.0])
            else:
                assert sensor.angles is not None  # one form is given
                logged = self._three_columns(topic, sensor.angles, rows) * size
            jumps = np.abs(np.abs(np.diff(logged, axis=0)) - 360.0) < _NEAR_A_TURN
            if size == 1.0 and jumps.any():
                raise InputError(
                    f"{topic.source}: {sensor.heading or 'an angle'} jumps by 360, and the map has it in radians: give "
                    "`angle_unit: deg`"
                )
            finite = np.isfinite(logged).all(axis=1)
            turns = Rotation.from_euler("ZYX", logged[finite][:, ::-1])
        if not finite.any():
            return quaternions
        matrices = turns.inv().as_matrix() if sensor.rotates == "world_to_body" else turns.as_matrix()
        matrices = rotation_of(sensor.world_axes) @ matrices @ rotation_of(sensor.axes).T
        quaternion = np.roll(Rotation.from_matrix(matrices).as_quat(), 1, axis=1)
        quaternions[finite] = quaternion * np.where(quaternion[:, :1] < 0.0, -1.0, 1.0) + 0.0  # no minus zero
        return quaternions

    # ----------------------------------------------------------------- what units cannot be

    def _require_unit_quaternions(self, topic: Topic, columns: Sequence[str], quats: Array, rows: Places) -> None:
        """Raises InputError where quaternions, but for a few spikes, are not of length 1."""
        off = np.abs(np.linalg.norm(quats, axis=1) - 1.0) > _UNIT_NORM
        if _exceeds_spikes(off):
            row = int(np.argmax(off))
            raise InputError(
                f"{topic.where(int(rows[row]))}: {', '.join(columns)} have length {np.linalg.norm(quats[row]):.4g}, "
                "and a quaternion that turns has length 1: these are other columns"
            )

    def _require_plausible_rates(self, name: str, topic: Topic, unit: str, values: Array) -> None:
        """Raises InputError for rates beyond half a turn a sample or any gyro, and suggests a unit."""
        period_s = self._vehicle.sample_period_s
        limit = min(_FASTEST, math.pi / period_s)
        size = np.nan_to_num(np.abs(values)).max(axis=1)
        if not self.limits or not _exceeds_spikes(size > limit):
            return
        largest = float(size.max())
        as_read = largest / si_factor(unit, "rate")
        like = [one for one in RATE_UNITS if unit == "rad/s" or ("rad" in one) == ("rad" in unit)]
        fits = next((one for one in like if as_read * si_factor(one, "rate") <= limit), "")
        hint = "; it looks like degrees: `unit: deg/s`" if unit == "rad/s" and fits == "deg/s" else ""
        if fits and not hint:
            smaller = si_factor(unit, "rate") / si_factor(fits, "rate")
            hint = f"; a unit {smaller:.4g} times smaller would fit: `unit: {fits}`"
        raise InputError(
            f"{topic.source}: sensor '{name}' turns at up to {largest:.4g} rad/s as {unit}, more than half a turn "
            f"in a sample of {period_s:g} s or than any gyro measures{hint}"
        )

    def _require_plausible_turns(self, name: str, topic: Topic, sensor: Any, values: Array, time_s: Array) -> None:
        """Raises InputError for attitudes that turn faster from sample to sample than vehicles do."""
        cosine = np.abs((values[1:] * values[:-1]).sum(axis=1))
        rates = 2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)) / np.diff(time_s)
        rates = rates[np.isfinite(rates)]
        if _exceeds_spikes(rates > _FASTEST):
            hint = "" if sensor.quaternion is not None else f"; is {sensor.angle_unit} the unit of its angles?"
            raise InputError(
                f"{topic.source}: sensor '{name}' turns at up to {rates.max():.4g} rad/s from sample to sample, which "
                f"no vehicle does{hint}"
            )

    def _require_plausible_accelerations(
        self, name: str, topic: Topic, sensor: AccelerometerMap, values: Array, time_s: Array
    ) -> None:
        """Raises InputError for accelerations that no vehicle has, as in a wrong unit."""
        limit = plausible.ACCELERATION.most / self._length
        sizes = np.abs(values)
        if sensor.gives in ("integral", "increment") and time_s.size > 1:
            steps = np.diff(time_s)[:, None]
            sizes = (np.abs(np.diff(values, axis=0)) if sensor.gives == "integral" else sizes[1:]) / steps
        sizes = sizes[np.isfinite(sizes).all(axis=1)]
        if self.limits and _exceeds_spikes(sizes.max(axis=1, initial=0.0) > limit):
            raise InputError(
                f"{topic.source}: sensor '{name}' accelerates at up to {sizes.max():.4g} "
                f"{self._vehicle.unit_names['length']}/s^2 as {sensor.unit}, more than {plausible.ACCELERATION.why}; "
                "check its unit, and what it `gives`"
            )

    # -------------------------------------------------------------------------------- commands

    def commands(self, entry: CommandMap) -> HeldValues:
        """Reads the commands to the jets as fractions of 0 to 1, with the intervals in which they hold."""
        time_s, rows = self._stamps(entry)
        topic = self._recording.topic(self._by.topic_of(entry))
        if entry.listed is not None:
            values = self._commands_from_list(topic, entry, rows)
        elif entry.mask is not None:
            values = self._commands_from_mask(topic, entry, rows)
        else:
            assert entry.columns is not None  # one form is given
            values = self._commands_from_columns(topic, entry, entry.columns, rows)
        if entry.missing == "off":
            values = np.nan_to_num(values, nan=0.0)
        return _hold_values(time_s, values, backward=entry.acts == "until_row", on_change=entry.on_change)

    def force_or_torque(self, entry: Any) -> HeldValues:
        """Reads a known outside force or torque in body axes; it holds from its row until the next."""
        time_s, rows = self._stamps(entry)
        topic = self._recording.topic(self._by.topic_of(entry))
        force = is_unit_of(entry.unit, "force")
        size = si_factor(entry.unit, "force", "torque") / (self._force if force else self._force * self._length)
        return _hold_values(time_s, self._vector(topic, entry, size, rows))

    def _commands_from_columns(
        self, topic: Topic, entry: CommandMap, columns: Mapping[str, str], rows: Places
    ) -> Array:
        """Reads commands from a column per jet: fractions of 0 to 1, NaN where missing, shape (n, n_jets)."""
        timed = is_unit_of(entry.unit, "time")
        size = si_factor(entry.unit, "time", "number")
        full = self._vehicle.sample_period_s if timed else 1.0
        on = full if entry.on is None else entry.on * size
        off = entry.off * size
        if on == off:
            raise InputError(f"{self._source}: commands.off: {entry.off:g} is what `on` is, too: they must differ")
        names = [columns[jet] for jet in self._vehicle.designations]
        logged = np.column_stack([topic.numbers(name)[rows] for name in names])
        values = (logged * size - off) / (on - off)
        if entry.threshold is not None:
            return np.where(np.isnan(values), np.nan, np.where(values >= entry.threshold, 1.0, 0.0))
        low = 0.0 if off == 0.0 else -math.inf  # a level may be undershot, an amount is not negative
        high = 1.0 + (JITTER if timed else 0.0)  # the interval of an on-time may be longer by so much
        wrong = (values < low - TOLERANCE) | (values > high + TOLERANCE)
        if wrong.any():
            row, jet = np.argwhere(wrong)[0]
            levels = f"open for {on:g} s at the most" if timed else f"{off / size:g} closed and {on / size:g} open"
            raise InputError(
                f"{topic.where(int(rows[row]))}, column {names[jet]}: {logged[row, jet]:g} is no command between "
                f"closed and open, as the map has it ({levels}); see commands.unit, off, on and threshold"
            )
        return np.clip(values, 0.0, 1.0)

    def _commands_from_mask(self, topic: Topic, entry: CommandMap, rows: Places) -> Array:
        """Reads commands from the bits of a column: 0 or 1, NaN where missing, shape (n, n_jets)."""
        assert entry.mask is not None  # the form that is given
        column = entry.mask.column
        logged = topic.numbers(column)[rows]
        wrong = (logged < 0.0) | (logged != np.round(logged)) | (logged >= 2.0**53)
        wrong &= np.isfinite(logged)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(f"{topic.where(int(rows[row]))}, column {column}: {logged[row]:g} is no bit mask")
        whole = np.nan_to_num(logged).astype(np.int64)
        known = sum(1 << bit for bit in set(entry.mask.bits.values()))
        extra = int(np.bitwise_or.reduce(whole)) & ~known
        if extra:
            self.notes.append(f"{topic.source}: column {column} has bit {extra.bit_length() - 1}, which is no jet's")
        bits = np.array([entry.mask.bits[jet] for jet in self._vehicle.designations])
        values = ((whole[:, None] >> bits) & 1).astype(float)
        values[np.isnan(logged)] = np.nan
        return values

    def _commands_from_list(self, topic: Topic, entry: CommandMap, rows: Places) -> Array:
        """Reads commands from texts that list the jets that fire: 0 or 1, shape (n, n_jets)."""
        assert entry.listed is not None  # the form that is given
        jets = self._vehicle.designations
        names = {(entry.listed.names.get(jet) or jet).lower(): index for index, jet in enumerate(jets)}
        texts = topic.texts(entry.listed.column)
        values = np.zeros((rows.size, len(jets)))
        for row, logged in enumerate(rows):
            for word in split_jet_list(texts[logged]):
                if word.lower() not in names:
                    known = [entry.listed.names.get(jet) or jet for jet in jets]
                    raise InputError(
                        f"{topic.where(int(logged))}, column {entry.listed.column}: '{word}' is no jet's name"
                        f"{suggestion(word, known)}"
                    )
                values[row, names[word.lower()]] = 1.0
        return values


def step_disagreement(steps: Array) -> float:
    """Computes the median relative spread of time steps found from several pairs; 0 for one pair.

    Args:
        steps: by each pair, NaN where it tells none, shape (n_pairs, n).
    """
    shared = steps[:, np.isfinite(steps).sum(axis=0) > 1]
    if not shared.size:
        return 0.0
    spread = np.nanmax(shared, axis=0) - np.nanmin(shared, axis=0)
    return float(np.median(spread) / np.abs(np.nanmedian(shared)))


def find_changes(values: Array) -> Places:
    """Returns indices of rows in which any value differs from that of the row before; values of shape (n, m)."""
    with np.errstate(invalid="ignore"):
        return np.flatnonzero((np.abs(np.diff(values, axis=0)) > 0.0).any(axis=1)) + 1


def split_jet_list(text: str) -> list[str]:
    """Splits a text into designations of jets, at all but letters, digits and underscores."""
    return "".join(letter if letter.isalnum() or letter == "_" else " " for letter in text).split()


def _exceeds_spikes(flags: NDArray[np.bool_]) -> bool:
    """Tests whether more samples are flagged than a few spikes account for (1 %, at least 2)."""
    return bool(flags.sum() > min(max(_SHARE * flags.size, _SPIKES), 0.5 * flags.size))


def _rotate_vectors(vectors: Array, matrix: Array) -> Array:
    """Rotates vectors by a matrix, shape (n, 3); NaN in components that depend on a missing one."""
    missing = np.isnan(vectors) @ (np.abs(matrix.T) > 1e-12)
    return np.where(missing > 0, np.nan, np.nan_to_num(vectors) @ matrix.T)


def _rounding_step(values: Array) -> float:
    """Returns the power of ten to which values are rounded; 1e-12 of the largest where they have more decimals."""
    values = values[np.isfinite(values)]
    largest = float(np.abs(values).max(initial=0.0))
    for decimals in range(_DECIMALS):
        scaled = values * 10.0**decimals
        if (np.abs(scaled - np.round(scaled)) < 1e-3).all():
            return 10.0**-decimals
    return max(1e-12 * largest, 1e-300)


def _hold_values(time_s: Array, values: Array, *, backward: bool = False, on_change: bool = False) -> HeldValues:
    """Makes held values: each from its time until the next, or, with `backward`, from the previous time to its own."""
    if time_s.size == 1 and on_change and not backward:
        return HeldValues(time_s, np.array([math.inf]), values)
    if time_s.size < 2:
        return HeldValues(time_s[:0], time_s[:0], values[:0])
    steps = np.diff(time_s)
    longest = math.inf if on_change else HOLE * float(np.median(steps))
    if backward:
        return HeldValues(np.maximum(time_s[:-1], time_s[1:] - longest), time_s[1:], values[1:])
    end = np.append(time_s[1:], time_s[-1] + (math.inf if on_change else float(np.median(steps))))
    return HeldValues(time_s, np.minimum(end, time_s + longest), values)
