"""Search for sensors among the columns of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from massprop_drake.inputs.units import si_factor
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records import mapping
from massprop_drake.records.jet_search import JetSearch
from massprop_drake.records.map_search import compact_name
from massprop_drake.records.names import WHEELS, WORDS, ColumnName, si_factor_or_none
from massprop_drake.records.topics import Topic

_UNIFORM = 1e-4  # of its median, by which steps of a clock that only counts may differ
_FEWEST = 20  # samples from which differences and repeated readings are told


class SensorSearch(JetSearch):
    """Search for sensors among the columns of a table."""

    def _find_sensors(self, topic: Topic, names: Sequence[ColumnName]) -> None:
        """Adds sensors to the map from a topic's columns, grouped by their names."""
        groups: dict[tuple[tuple[str, ...], str], dict[int, ColumnName]] = {}
        angles: dict[int, ColumnName] = {}
        for name in names:
            if name.turn_axis >= 0 and not set(name.words) & WORDS["gyro"]:
                angles.setdefault(name.turn_axis, name)
            elif name.turn_axis >= 0:
                groups.setdefault((("rate",), name.unit), {})[name.turn_axis] = name
            elif name.axis >= 0 and self._find_quantity(name):
                groups.setdefault((name.words, name.unit), {}).setdefault(name.axis, name)
        by_kind: dict[str, list[dict[int, ColumnName]]] = {}
        for members in map(_number_axes_from_zero, groups.values()):
            if set(members) <= set(range(4 if self._find_quantity(members[min(members)]) == "quaternion" else 3)):
                by_kind.setdefault(self._find_quantity(members[min(members)]), []).append(members)
        for kind, several in by_kind.items():
            several.sort(key=lambda one, kind=kind: self._sort_key(kind, one))  # type: ignore[misc]
        position = next(iter(by_kind.get("position", [])), {})
        pairs = self._find_differences(topic, position, angles, by_kind)
        for members in by_kind.get("gyro", []):
            self._add_gyro(topic, members)
        both = [(members, kind) for kind in ("increment", "accelerometer") for members in by_kind.get(kind, [])]
        for members, kind in sorted(both, key=lambda one: self._sort_key("accelerometer", one[0])):
            self._add_accelerometer(topic, members, kind == "increment")
        for members in by_kind.get("velocity", []):
            unit = self._unit(members, "velocity", "m/s")
            package = self._take_tracker(
                "velocity", "velocity", f"{_join_column_names(members)}, velocities by their names"
            )
            if package:
                self._add_sensor(package, {"kind": "velocity", "columns": _column_names(members), "unit": unit})
                self._say(f"{package}: {_join_column_names(members)}, by their names")
        self._add_wheels(names)
        self._add_engines(names)
        quaternion = next((one for one in by_kind.get("quaternion", []) if len(one) == 4), {})
        self._add_pose(position, angles, quaternion)
        if pairs:
            self._use_differences(topic, pairs)

    def _add_wheels(self, names: Sequence[ColumnName]) -> None:
        """Adds speeds of wheels to the map: columns named after them, or all wheel columns in order."""
        of_wheels = [one for one in names if set(one.words) & WHEELS or one.unit == "rpm"]
        by_name = {compact_name("".join(one.words)): one for one in names}
        is_complete = len(of_wheels) == len(self.vehicle.wheels)
        by_order = dict(zip(self._free["wheel"], of_wheels, strict=False)) if is_complete else {}
        for name in list(self._free["wheel"]):
            column = by_name.get(compact_name(name)) or by_name.get(compact_name(f"{name}speed")) or by_order.get(name)
            if column is None:
                continue
            unit = self._unit({0: column}, "rate", "rad/s")
            self._free["wheel"].remove(name)
            self._add_sensor(name, {"kind": "wheel", "speed": column.column, "unit": unit})
            self._say(f"{name}: {column.column}, in {unit}, by its name")

    def _add_engines(self, names: Sequence[ColumnName]) -> None:
        """Adds engines to the map whose level and gimbal angles have columns of these names."""
        by_name = {compact_name("".join(one.words)): one for one in names}
        for engine in self.vehicle.engines:
            columns = [by_name[name] for name in map(compact_name, engine.columns) if name in by_name]
            if len(columns) < len(engine.columns) or engine.name not in self._free["engine"]:
                continue
            level, *angles = columns
            entry: dict[str, Any] = {"kind": "engine", "level": level.column}
            if angles:
                entry |= {"gimbal": [one.column for one in angles], "unit": self._unit({0: angles[0]}, "angle", "rad")}
            self._free["engine"].remove(engine.name)
            self._add_sensor(engine.name, entry)
            self._say(f"{engine.name}: {', '.join(one.column for one in (level, *angles))}, by their names")

    def _sort_key(self, kind: str, members: Mapping[int, ColumnName]) -> tuple[bool, bool, bool]:
        """Returns a sort key of a group of columns: named as a package, all axes, readings before estimates."""
        words = members[min(members)].words
        is_package = kind in self._called and self._is_package_name(kind, words)
        return not is_package, len(members) < 3, bool(set(words) & {"true", "truth", "est", "estimated", "filtered"})

    def _find_differences(
        self,
        topic: Topic,
        position: Mapping[int, ColumnName],
        angles: Mapping[int, ColumnName],
        by_kind: dict[str, list[dict[int, ColumnName]]],
    ) -> list[tuple[dict[str, str], Array]]:
        """Returns pairs of value and rate columns with time steps where rates are differences; drops these groups."""
        pairs: list[tuple[dict[str, str], Array]] = []
        groups = []
        for kind, values, dimension, usual in (("velocity", position, "length", "m"), ("gyro", angles, "angle", "rad")):
            for members in by_kind.get(kind, []):
                rate_unit = self._unit(members, "velocity" if kind == "velocity" else "rate", f"{usual}/s")
                axis_pairs = []
                for axis in sorted(set(members) & set(values)):
                    unit = self._unit({0: values[axis]}, dimension, usual)
                    steps = _find_difference_steps(
                        topic, (values[axis].column, unit), (members[axis].column, rate_unit)
                    )
                    if steps is not None:
                        pair = {"value": values[axis].column, "rate": members[axis].column}
                        pair |= (
                            {} if (unit, rate_unit) == ("m", "m/s") else {"value_unit": unit, "rate_unit": rate_unit}
                        )
                        axis_pairs.append((pair, steps))
                if axis_pairs and len(axis_pairs) == len(set(members)):
                    groups.append((kind, members, axis_pairs))
                    pairs += axis_pairs
        if not pairs:
            return []
        with np.errstate(invalid="ignore"):
            disagree = mapping.step_disagreement(np.vstack([steps for _, steps in pairs]))
        if disagree > mapping.AGREE:
            columns = ", ".join(pair["rate"] for pair, _ in pairs)
            self._say(f"{columns} are no exact differences: they would have been taken over unlike steps in a row")
            return []
        for kind, members, axis_pairs in groups:
            by_kind[kind].remove(members)
            self._say(
                f"{_join_column_names(members)}: backward differences of "
                f"{', '.join(pair['value'] for pair, _ in axis_pairs)}, not "
                "measurements of their own: no sensor"
            )
        return pairs

    def _use_differences(self, topic: Topic, pairs: list[tuple[dict[str, str], Array]]) -> None:
        """Sets `time.differences` in the map to columns of values and rates, unless the logged clock is right."""
        steps = np.concatenate([steps[np.isfinite(steps)] for _, steps in pairs])
        typical = float(np.median(steps))
        time = self.data.setdefault("time", {})
        if "column" in time:
            logged = np.diff(topic.numbers(time["column"])) * si_factor(time.get("unit", "s"), "time")
            counted = float(np.median(logged))
            if float(np.median(np.abs(logged - counted))) > _UNIFORM * counted:
                return  # a clock that measures
            if abs(typical - counted) < 1e-3 * counted and float(np.std(steps)) < 1e-3 * counted:
                return
            self._say(
                f"time.differences: {time['column']} only counts, {counted:.6g} s a row, while the differences were "
                f"divided by {typical:.6g} s in the median, {np.percentile(steps, 5):.4g} to "
                f"{np.percentile(steps, 95):.4g} s: the true steps are taken from them"
            )
        time["differences"] = [pair for pair, _ in pairs]

    def _add_gyro(self, topic: Topic, members: Mapping[int, ColumnName]) -> None:
        """Adds a group of columns of rates to the map as a gyro, with unit and interval between readings."""
        package = self._take_package("gyro", members[min(members)].words)
        if not package:
            self._say(f"{_join_column_names(members)}: rates, but the vehicle has no further gyro")
            return
        unit, why = self._unit(members, "rate", ""), "by their names"
        if not unit:
            self._guessed[package] = ""
            sizes = np.concatenate([np.abs(topic.numbers(one.column)) for one in members.values()])
            limit = min(100.0, np.pi / self.vehicle.sample_period_s)
            size = float(np.nanpercentile(sizes, 99.0))
            fitting = (one for one in mapping.RATE_UNITS if not size * si_factor(one, "rate") > limit)
            unit = next(fitting, "deg/s")
            why = f"by their names; {unit} since nothing says otherwise" + (
                ""
                if unit == "rad/s"
                else f" but that they reach {float(np.nanmax(sizes)):.4g}, too much for larger units"
            )
        entry: dict[str, Any] = {"kind": "gyro", "columns": _column_names(members), "unit": unit}
        n_rows = _rows_per_reading(np.column_stack([topic.numbers(one.column) for one in members.values()]))
        if n_rows > 1:
            entry["every"] = n_rows
            why += f"; they change in every {n_rows} rows at the most, so rows between only repeat them"
        self._add_sensor(package, entry)
        self._say(f"{package}: rates {_join_column_names(members)} in {unit}, {why}")

    def _add_accelerometer(self, topic: Topic, members: Mapping[int, ColumnName], increments: bool) -> None:
        """Adds a group of columns to the map as an accelerometer, with unit and kind of reading."""
        first = members[min(members)]
        package = self._take_package("accelerometer", first.words)
        if not package:
            self._say(f"{_join_column_names(members)}: accelerations, but the vehicle has no further accelerometer")
            return
        usual = (
            f"{self.vehicle.unit_names['length']}/s" if self._is_package_name("accelerometer", first.words) else "m/s"
        )
        if increments:
            gives, unit, why = (
                "increment",
                self._unit(members, "velocity", "m/s"),
                "increments of velocity by their names",
            )
        elif si_factor_or_none(first.unit, "velocity") is not None or (
            compact_name("".join(first.words)) in self._called["accelerometer"]
            and si_factor_or_none(first.unit, "acceleration") is None
        ):
            gives, unit, why = "integral", self._unit(members, "velocity", usual), "as the vehicle's own, integrating"
            if si_factor_or_none(first.unit, "velocity") is None:
                self._guessed[package] = usual
        else:
            sizes = np.sqrt(sum(np.nan_to_num(topic.numbers(one.column)) ** 2 for one in members.values()))
            like_g = 0.9 < float(np.median(sizes)) < 1.1
            gives, unit = "mean", self._unit(members, "acceleration", "g" if like_g else "m/s^2")
            why = (
                "accelerations by their names; taken for the mean over the sample that ended, since one instant a row "
                "could not be integrated"
            )
            if abs(float(np.median(sizes)) * si_factor(unit, "acceleration") / 9.80665 - 1.0) < 0.1:
                why += "; they hold the reaction to the weight: give what they show at rest as `zero`"
            if si_factor_or_none(first.unit, "acceleration") is None:
                self._guessed[package] = usual
        entry = {"kind": "accelerometer", "columns": _column_names(members), "unit": unit, "gives": gives}
        self._add_sensor(package, entry)
        self._say(f"{package}: {_join_column_names(members)} in {unit}, {why}")

    def _add_pose(
        self, position: Mapping[int, ColumnName], angles: Mapping[int, ColumnName], quaternion: Mapping[int, ColumnName]
    ) -> None:
        """Adds columns of position, angles or a quaternion to the map as a pose or an attitude."""
        entry: dict[str, Any] = {}
        if quaternion:
            last = quaternion[0].indexed and quaternion[0].axis == 1  # counted from 1
            entry = {"quaternion": [quaternion[one].column for one in range(4)], "order": "xyzw" if last else "wxyz"}
            why = f"quaternion {_join_column_names(quaternion)}"
            guess = f", taken for scalar {'last' if last else 'first'}, body to world"
            why += guess if quaternion[0].indexed else ", body to world"
        elif set(angles) == {2}:
            entry, why = {"heading": angles[2].column}, f"heading {angles[2].column} alone: a planar vehicle"
        elif angles:
            entry, why = {"angles": _column_names(angles)}, f"angles {_join_column_names(angles)}"
        if angles and not quaternion:
            unit = self._unit(angles, "angle", "rad")
            entry |= {} if unit == "rad" else {"angle_unit": unit}
            why += f" in {unit}"
        if not position and not entry:
            return
        kind = "pose" if position else "attitude"
        if not position and not self._free["pose"]:
            self._say(f"{why}: the vehicle has no sensor of attitude that is not taken")
            return
        name = self._take_tracker("pose", kind, f"{_join_column_names(position)}, positions" if position else why)
        if not name:
            return
        if position:
            unit = self._unit(position, "length", "m")
            text = f"position {_join_column_names(position)} in {unit}" + (f", {why}" if entry else "")
            entry = {"position": _column_names(position), "unit": unit, **entry}
        else:
            text = why
        self._add_sensor(name, {"kind": kind, **entry})
        self._say(f"{name}: {text}")


def _number_axes_from_zero(members: dict[int, ColumnName]) -> dict[int, ColumnName]:
    """Maps axes to columns, counted from 0 also where the names count from 1."""
    indexed = all(one.indexed for one in members.values())
    return {axis - 1: one for axis, one in members.items()} if indexed and 0 not in members else members


def _column_names(members: Mapping[int, ColumnName]) -> list[str | None]:
    """Lists the column of each of three axes; None for an axis without."""
    return [members[axis].column if axis in members else None for axis in range(3)]


def _rows_per_reading(readings: Array) -> int:
    """Computes the number of rows for which each reading, shape (n, m), is repeated; 1: not repeated."""
    rows = mapping.find_changes(readings)
    return int(np.gcd.reduce(np.diff(rows))) if rows.size >= _FEWEST else 1


def _join_column_names(members: Mapping[int, ColumnName]) -> str:
    """Returns the columns' names in order of axes, separated by commas."""
    return ", ".join(members[axis].column for axis in sorted(members))


def _find_difference_steps(topic: Topic, value: tuple[str, str], rate: tuple[str, str]) -> Array | None:
    """Computes time steps, s, that make a rate the backward difference of a value; None if none do."""
    change = np.diff(topic.numbers(value[0])) * si_factor(value[1], "length", "angle")
    if si_factor_or_none(value[1], "angle") is not None:
        change = (change + np.pi) % (2.0 * np.pi) - np.pi
    speed = topic.numbers(rate[0])[1:] * si_factor(rate[1], "velocity", "rate")
    moving = (
        np.isfinite(speed)
        & np.isfinite(change)
        & (np.abs(speed) > mapping.MOVING * np.nanmax(np.abs(speed), initial=0.0))
    )
    if moving.sum() < _FEWEST:
        return None
    steps = np.full(change.size, np.nan)
    steps[moving] = change[moving] / speed[moving]
    typical = float(np.nanmedian(steps))
    scatter = float(np.nanmedian(np.abs(steps - typical)))
    return steps if typical > 0.0 and scatter < mapping.SCATTER * typical else None
