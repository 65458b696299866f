"""Map proposed for a recording, with its reasons: names of columns, their numbers, known topics."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.units import factor
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records import channels, evidence, mapped_rows, mapping
from massprop_drake.records.clocks import TopicClock, clock_fault, find_clock
from massprop_drake.records.command_scales import CommandScale, Levels, possible_scales, two_levels, without_rare
from massprop_drake.records.names import (
    WHEELS,
    WORDS,
    ColumnName,
    JetColumns,
    factor_or_none,
    jet_families,
    kind_of,
    read_name,
)
from massprop_drake.records.stamps import is_number
from massprop_drake.records.topics import Recording, Topic

Array = NDArray[np.float64]

ROWS = 4000  # of each topic that are looked at

_UNIFORM = 1e-4  # of its median, by which steps of a clock that only counts may differ
_MOSTLY_NUMBERS = 0.5  # share of cells above which text in a column is an error
_FEWEST = 20  # samples from which differences and repeated readings are told
_OFF = 2.5  # factor by which the true rates may differ from those predicted with the nominal mass properties
_DISFAVOR = 0.1  # of the log of a factor, by which a likelier scale may fit worse
_RATE_UNITS = ("rad/s", "deg/s", "mrad/s", "deg/h")  # that are farther apart than the true rates may be
_FARTHEST = 20  # intervals that commands may be logged early or late: a budget of time
_AGAINST = -0.3  # correlation below which rates go against the jets
_PULSES = (500.0, 2600.0)  # us, between which widths of pulses lie
_CLOSED_PULSE = 950.0  # us, below which a width means disarmed
_FOLDED = 4  # elements of an array that are listed as from the first to the last

# of PX4: columns, and what they are
_PX4_RATES = (
    ("vehicle_angular_velocity", "xyz", "rates in body axes"),
    ("sensor_combined", "gyro_rad", "rates in body axes, means over the sample"),
)
_PX4_ACCELERATIONS = (
    ("vehicle_imu", "delta_velocity", "increment", "increments of velocity, which lose nothing between samples"),
    ("sensor_combined", "accelerometer_m_s2", "mean", "accelerations, means over the sample"),
    (
        "vehicle_acceleration",
        "xyz",
        "instant",
        "accelerations, filtered by IMU_ACCEL_CUTOFF; vehicle_imu with its delta_velocity would be better",
    ),
)
_PX4_POSE = ("vehicle_visual_odometry", "vehicle_mocap_odometry")
_PX4_COMMANDS = (("actuator_motors", "control"), ("actuator_outputs", "output"))


class Proposal(NamedTuple):
    """Proposed map, and the reasons for it.

    Attributes:
        data: of the map, as its file has it.
        reasons: a sentence each.
        lacking: what could not be found, a sentence each; the map is not whole then.
        left_out: columns, and topics, of which nothing is made.
        warnings: the reasons that call the map in question.
    """

    data: dict[str, Any]
    reasons: list[str]
    lacking: list[str]
    left_out: list[str]
    warnings: Sequence[str] = ()


def propose(recording: Recording, vehicle: Vehicle) -> Proposal:
    """Proposes a map.

    Args:
        recording: as `open_recording` gives it; some thousand rows are enough.
        vehicle: whose sensors and jets are sought.
    """
    work = _Search(recording, vehicle)
    if recording.kind == "ulog":
        work.in_px4()
    elif recording.kind in ("ros1", "ros2"):
        work.in_a_bag()
    else:
        work.in_a_table()
    work.look_at_the_jets()
    work.tell_what_is_left()
    if not work.data["sensors"]:
        work.lacking.append("no sensor was found: name its columns under `sensors`")
    if "commands" not in work.data:
        work.lacking.append(
            "no commands were found: name a column for each jet, a bit mask or a list under `commands`"
            + work.partial_commands
        )
    return Proposal(work.data, work.reasons, work.lacking, work.left_out, work.warnings)


class _Search:
    """Search for a vehicle's sensors and jets in a recording."""

    def __init__(self, recording: Recording, vehicle: Vehicle):
        self.recording, self.vehicle = recording, vehicle
        self.data: dict[str, Any] = {"sensors": {}}
        self.reasons: list[str] = []
        self.warnings: list[str] = []
        self.lacking: list[str] = []
        self._here: tuple[str, dict[str, Any] | None] = "", None  # the topic that is looked at, and its time
        self._free = {"gyro": [one.name for one in vehicle.gyros]}
        self._free["accelerometer"] = [one.name for one in vehicle.accelerometers]
        self._free |= {
            "pose": [one.name for one in vehicle.poses],
            "velocity": [one.name for one in vehicle.velocities],
            "wheel": [one.name for one in vehicle.wheels],
            "engine": [one.name for one in vehicle.engines],
        }
        self._called = {kind: {_plainly(one) for one in self._free[kind]} for kind in ("gyro", "accelerometer")}
        self._scales: list[dict[str, Any]] = []  # of the commands, as a map has them, the likelier first
        self._is_scale_sure = True  # told by names, or reached exactly
        self._guessed: dict[str, str] = {}  # sensors whose unit no name tells, and that of a velocity of theirs
        self.partial_commands = ""  # what is lacking of commands that were nearly found
        self.left_out: list[str] = []
        self._clocks: dict[str, TopicClock | None] = {}

    def _say(self, reason: str) -> None:
        self.reasons.append(reason)

    def _warn(self, reason: str) -> None:
        self._say(reason)
        self.warnings.append(reason)

    def _kind(self, name: ColumnName) -> str:
        """Finds the quantity of a column, by its words or a package's name; "": not known."""
        called = _plainly("".join(name.words))
        return next((kind for kind, names in self._called.items() if called in names), kind_of(name))

    def _is_own(self, kind: str, words: Sequence[str]) -> bool:
        """Tests whether words name a package of the vehicle."""
        return bool({*map(_plainly, words), _plainly("".join(words))} & self._called[kind])

    def _package(self, kind: str, words: Sequence[str] = ()) -> str:
        """Returns a package of the vehicle that is not taken yet, one of that name first; "": none is left."""
        free = self._free[kind]
        said = {*map(_plainly, words), _plainly("".join(words))}
        name = next((one for one in free if _plainly(one) in said), free[0] if free else "")
        if name:
            free.remove(name)
        return name

    def _tracker(self, kind: str, shown_as: str, what: str) -> str:
        """Finds the place of a sensor in a fixed frame: one of the vehicle's, or, if none is needed, a display name.

        Args:
            kind: of the vehicle's packages.
            shown_as: name for a vehicle that is not followed so.
            what: the columns, for the reason why there is no place, which is "".
        """
        name = self._package(kind) or ("" if self.vehicle.needs_pose_filter else shown_as)
        if not name:
            self._say(f"{what}: the vehicle has no further {kind} sensor")
        return name

    def tell_what_is_left(self) -> None:
        """Reports packages of the vehicle without columns, and every column that is not used."""
        missing = [name for free in self._free.values() for name in free]
        if missing:
            self._say(f"no columns were found for {', '.join(missing)}: name them under `sensors` if they were logged")
        used = _used(self.data)
        for name, topic in self.recording.topics.items():
            left = _folded([column for column in topic.columns if column not in used.get(name, ())])
            if name in used or not name:
                self.left_out += left
                if left:
                    self._say(f"not used{f' of {name}' if name else ''}: {', '.join(left)}")
        topics = [name for name in self.recording.topics if name and name not in used]
        if topics:
            self.left_out += topics
            self._say(f"topics not used: {', '.join(topics)}")

    # ---------------------------------------------------------------------------------- tables

    def in_a_table(self) -> None:
        """Looks in tables and .mat files, by names and numbers; of several parts in the one with rates first."""
        form = self.recording.form.model_dump(exclude_defaults=True)
        if form:
            self.data["csv"] = form
            self._say(f"csv: {', '.join(f'{key} {value!r}' for key, value in form.items())}, as its first lines show")
        topics = self.recording.topics
        read = {
            name: [read_name(column, topic.units.get(column, "")) for column in topic.columns]
            for name, topic in topics.items()
        }
        numeric = {
            name: [one for one in names if _has_numbers(topics[name].columns[one.column])]
            for name, names in read.items()
        }
        for topic in topics.values():
            self._tell_spoilt(topic)
        kinds = {name: {self._kind(one) for one in names if one.axis >= 0} - {""} for name, names in numeric.items()}
        ordered = sorted(topics, key=lambda name: ("gyro" not in kinds[name], -len(kinds[name])))
        for name in ordered:
            if kinds[name] or len(topics) == 1:
                self._enter(name, read[name])
                self._sensors(topics[name], numeric[name])
        for name in sorted(topics, key=lambda name: -len(self._jet_columns(topics[name]))):
            self._enter(name, read[name], quietly=True)
            if self._commands(topics[name]):
                self._put_in_its_topic(self.data["commands"])
                break
        if "time" not in self.data and not any(clock is not None for clock in self._clocks.values()):
            faults = [fault for name in topics if (fault := clock_fault(topics[name], read[name]))]
            self.lacking.insert(0, "; ".join(["no column of time was found: name it, `time: {column: ...}`", *faults]))

    def _tell_spoilt(self, topic: Topic) -> None:
        """Warns of columns that are not numbers because a few cells hold text."""
        for column, values in topic.columns.items():
            numeric = sum(map(is_number, values)) if values.dtype == object else 0
            if not _MOSTLY_NUMBERS * values.size < numeric < values.size:
                continue
            try:
                topic.numbers(column)
            except InputError as error:
                self._warn(f"{error}, as the rest of its column is: nothing is made of it")

    def _enter(self, name: str, names: Sequence[ColumnName], *, quietly: bool = False) -> None:
        """Continues in a topic: the first one, and its time, are those of the map."""
        found = self._clock(name, names)
        self._here = name, found.data if found is not None and found.data else None
        if "time" not in self.data and "topic" not in self.data:
            if name:
                self.data["topic"] = name
                self._say(f"topic {name}: it has rates, or most of the sensors")
            if found is not None and found.data:
                self.data["time"] = found.data
                self._say(found.reason)
            if found is not None and found.coarse and found.coarse not in (*self.reasons, *self.lacking):
                (self._say if found.data else self.lacking.append)(found.coarse)
        elif found is not None and not quietly and self._here[1] != self.data.get("time"):
            self._say(f"{name}: {found.reason}")

    def _clock(self, name: str, names: Sequence[ColumnName]) -> TopicClock | None:
        """Returns the clock of a topic, looked for once."""
        if name not in self._clocks:
            self._clocks[name] = find_clock(self.recording.topics[name], names, self.vehicle.sample_period_s)
        return self._clocks[name]

    def _put_in_its_topic(self, entry: dict[str, Any]) -> None:
        """Names topic and time of parts that do not lie where the map begins."""
        name, time = self._here
        if name != self.data.get("topic", ""):
            entry["topic"] = name
            if time is not None and time != self.data.get("time"):
                entry["time"] = time

    def _sensors(self, topic: Topic, names: Sequence[ColumnName]) -> None:
        groups: dict[tuple[tuple[str, ...], str], dict[int, ColumnName]] = {}
        angles: dict[int, ColumnName] = {}
        for name in names:
            if name.turning >= 0 and not set(name.words) & WORDS["gyro"]:
                angles.setdefault(name.turning, name)
            elif name.turning >= 0:
                groups.setdefault((("rate",), name.unit), {})[name.turning] = name
            elif name.axis >= 0 and self._kind(name):
                groups.setdefault((name.words, name.unit), {}).setdefault(name.axis, name)
        found: dict[str, list[dict[int, ColumnName]]] = {}
        for members in map(_from_zero, groups.values()):
            if set(members) <= set(range(4 if self._kind(members[min(members)]) == "quaternion" else 3)):
                found.setdefault(self._kind(members[min(members)]), []).append(members)
        for kind, several in found.items():
            several.sort(key=lambda one, kind=kind: self._order(kind, one))  # type: ignore[misc]
        position = next(iter(found.get("position", [])), {})
        pairs = self._differences(topic, position, angles, found)
        for members in found.get("gyro", []):
            self._add_gyro(topic, members)
        both = [(members, kind) for kind in ("increment", "accelerometer") for members in found.get(kind, [])]
        for members, kind in sorted(both, key=lambda one: self._order("accelerometer", one[0])):
            self._add_accelerometer(topic, members, kind == "increment")
        for members in found.get("velocity", []):
            unit = self._unit(members, "velocity", "m/s")
            package = self._tracker("velocity", "velocity", f"{_listed(members)}, velocities by their names")
            if package:
                self._add(package, {"kind": "velocity", "columns": _columns(members), "unit": unit})
                self._say(f"{package}: {_listed(members)}, by their names")
        self._add_wheels(names)
        self._add_engines(names)
        quaternion = next((one for one in found.get("quaternion", []) if len(one) == 4), {})
        self._add_pose(position, angles, quaternion)
        if pairs:
            self._use_differences(topic, pairs)

    def _add_wheels(self, names: Sequence[ColumnName]) -> None:
        """Adds speeds of the vehicle's wheels: columns of their names, or else all that are of wheels."""
        of_wheels = [one for one in names if set(one.words) & WHEELS or one.unit == "rpm"]
        called = {_plainly("".join(one.words)): one for one in names}
        by_order = dict(zip(self._free["wheel"], of_wheels, strict=False)) if self._numbered(of_wheels) else {}
        for name in list(self._free["wheel"]):
            column = called.get(_plainly(name)) or called.get(_plainly(f"{name}speed")) or by_order.get(name)
            if column is None:
                continue
            unit = self._unit({0: column}, "rate", "rad/s")
            self._free["wheel"].remove(name)
            self._add(name, {"kind": "wheel", "speed": column.column, "unit": unit})
            self._say(f"{name}: {column.column}, in {unit}, by its name")

    def _add_engines(self, names: Sequence[ColumnName]) -> None:
        """Adds engines that columns are named after."""
        called = {_plainly("".join(one.words)): one for one in names}
        for engine in self.vehicle.engines:
            columns = [called[name] for name in map(_plainly, engine.columns) if name in called]
            if len(columns) < len(engine.columns) or engine.name not in self._free["engine"]:
                continue
            level, *angles = columns
            entry: dict[str, Any] = {"kind": "engine", "level": level.column}
            if angles:
                entry |= {"gimbal": [one.column for one in angles], "unit": self._unit({0: angles[0]}, "angle", "rad")}
            self._free["engine"].remove(engine.name)
            self._add(engine.name, entry)
            self._say(f"{engine.name}: {', '.join(one.column for one in (level, *angles))}, by their names")

    def _numbered(self, columns: Sequence[ColumnName]) -> bool:
        """Tests whether there is a column for every wheel of the vehicle."""
        return len(columns) == len(self.vehicle.wheels)

    def _order(self, kind: str, members: Mapping[int, ColumnName]) -> tuple[bool, bool, bool]:
        """Orders groups of columns: those called as a package first, whole ones, readings before estimates."""
        words = members[min(members)].words
        own = kind in self._called and self._is_own(kind, words)
        return not own, len(members) < 3, bool(set(words) & {"true", "truth", "est", "estimated", "filtered"})

    def _add(self, name: str, entry: dict[str, Any]) -> None:
        """Adds a sensor, the first of its name."""
        if name not in self.data["sensors"]:
            self._put_in_its_topic(entry)
            self.data["sensors"][name] = entry

    def _unit(self, members: Mapping[int, ColumnName], kind: str, otherwise: str) -> str:
        unit = members[min(members)].unit
        return unit if unit and factor_or_none(unit, kind) is not None else otherwise

    def _differences(
        self,
        topic: Topic,
        position: Mapping[int, ColumnName],
        angles: Mapping[int, ColumnName],
        found: dict[str, list[dict[int, ColumnName]]],
    ) -> list[tuple[dict[str, str], Array]]:
        """Finds pairs of a value and its backward difference; groups of such rates are no sensors, and are removed."""
        pairs: list[tuple[dict[str, str], Array]] = []
        groups = []
        for kind, values, dimension, usual in (("velocity", position, "length", "m"), ("gyro", angles, "angle", "rad")):
            for members in found.get(kind, []):
                rate_unit = self._unit(members, "velocity" if kind == "velocity" else "rate", f"{usual}/s")
                here = []
                for axis in sorted(set(members) & set(values)):
                    unit = self._unit({0: values[axis]}, dimension, usual)
                    steps = _steps(topic, (values[axis].column, unit), (members[axis].column, rate_unit))
                    if steps is not None:
                        pair = {"value": values[axis].column, "rate": members[axis].column}
                        pair |= (
                            {} if (unit, rate_unit) == ("m", "m/s") else {"value_unit": unit, "rate_unit": rate_unit}
                        )
                        here.append((pair, steps))
                if here and len(here) == len(set(members)):
                    groups.append((kind, members, here))
                    pairs += here
        if not pairs:
            return []
        with np.errstate(invalid="ignore"):
            disagree = mapping.disagreement(np.vstack([steps for _, steps in pairs]))
        if disagree > mapping.AGREE:
            columns = ", ".join(pair["rate"] for pair, _ in pairs)
            self._say(f"{columns} are no exact differences: they would have been taken over unlike steps in a row")
            return []
        for kind, members, here in groups:
            found[kind].remove(members)
            self._say(
                f"{_listed(members)}: backward differences of {', '.join(pair['value'] for pair, _ in here)}, not "
                "measurements of their own: no sensor"
            )
        return pairs

    def _use_differences(self, topic: Topic, pairs: list[tuple[dict[str, str], Array]]) -> None:
        steps = np.concatenate([steps[np.isfinite(steps)] for _, steps in pairs])
        typical = float(np.median(steps))
        time = self.data.setdefault("time", {})
        if "column" in time:
            logged = np.diff(topic.numbers(time["column"])) * factor(time.get("unit", "s"), "time")
            usual = float(np.median(logged))
            if float(np.median(np.abs(logged - usual))) > _UNIFORM * usual:
                return  # a clock that measures
            if abs(typical - usual) < 1e-3 * usual and float(np.std(steps)) < 1e-3 * usual:
                return
            self._say(
                f"time.differences: {time['column']} only counts, {usual:.6g} s a row, while the differences were "
                f"divided by {typical:.6g} s in the median, {np.percentile(steps, 5):.4g} to "
                f"{np.percentile(steps, 95):.4g} s: the true steps are taken from them"
            )
        time["differences"] = [pair for pair, _ in pairs]

    def _add_gyro(self, topic: Topic, members: Mapping[int, ColumnName]) -> None:
        package = self._package("gyro", members[min(members)].words)
        if not package:
            self._say(f"{_listed(members)}: rates, but the vehicle has no further gyro")
            return
        unit, why = self._unit(members, "rate", ""), "by their names"
        if not unit:
            self._guessed[package] = ""
            sizes = np.concatenate([np.abs(topic.numbers(one.column)) for one in members.values()])
            limit = min(100.0, np.pi / self.vehicle.sample_period_s)
            unit = "deg/s" if float(np.nanpercentile(sizes, 99.0)) > limit else "rad/s"
            why = f"by their names; {unit} since nothing says otherwise" + (
                "" if unit == "rad/s" else f" but that they reach {float(np.nanmax(sizes)):.4g}, too much for rad/s"
            )
        entry: dict[str, Any] = {"kind": "gyro", "columns": _columns(members), "unit": unit}
        every = _every(np.column_stack([topic.numbers(one.column) for one in members.values()]))
        if every > 1:
            entry["every"] = every
            why += f"; they change in every {every} rows at the most, so rows between only repeat them"
        self._add(package, entry)
        self._say(f"{package}: rates {_listed(members)} in {unit}, {why}")

    def _add_accelerometer(self, topic: Topic, members: Mapping[int, ColumnName], increments: bool) -> None:
        first = members[min(members)]
        package = self._package("accelerometer", first.words)
        if not package:
            self._say(f"{_listed(members)}: accelerations, but the vehicle has no further accelerometer")
            return
        own = f"{self.vehicle.unit_names['length']}/s" if self._is_own("accelerometer", first.words) else "m/s"
        if increments:
            gives, unit, why = (
                "increment",
                self._unit(members, "velocity", "m/s"),
                "increments of velocity by their names",
            )
        elif factor_or_none(first.unit, "velocity") is not None or (
            _plainly("".join(first.words)) in self._called["accelerometer"]
            and factor_or_none(first.unit, "acceleration") is None
        ):
            gives, unit, why = "integral", self._unit(members, "velocity", own), "as the vehicle's own, integrating"
            if factor_or_none(first.unit, "velocity") is None:
                self._guessed[package] = own
        else:
            sizes = np.sqrt(sum(np.nan_to_num(topic.numbers(one.column)) ** 2 for one in members.values()))
            like_g = 0.9 < float(np.median(sizes)) < 1.1
            gives, unit = "mean", self._unit(members, "acceleration", "g" if like_g else "m/s^2")
            why = (
                "accelerations by their names; taken for the mean over the sample that ended, since one instant a row "
                "could not be integrated"
            )
            if abs(float(np.median(sizes)) * factor(unit, "acceleration") / 9.80665 - 1.0) < 0.1:
                why += "; they hold the reaction to the weight: give what they show at rest as `zero`"
            if factor_or_none(first.unit, "acceleration") is None:
                self._guessed[package] = own
        entry = {"kind": "accelerometer", "columns": _columns(members), "unit": unit, "gives": gives}
        self._add(package, entry)
        self._say(f"{package}: {_listed(members)} in {unit}, {why}")

    def _add_pose(
        self, position: Mapping[int, ColumnName], angles: Mapping[int, ColumnName], quaternion: Mapping[int, ColumnName]
    ) -> None:
        entry: dict[str, Any] = {}
        if quaternion:
            last = quaternion[0].indexed and quaternion[0].axis == 1  # counted from 1
            entry = {"quaternion": [quaternion[one].column for one in range(4)], "order": "xyzw" if last else "wxyz"}
            why = f"quaternion {_listed(quaternion)}"
            guess = f", taken for scalar {'last' if last else 'first'}, body to world"
            why += guess if quaternion[0].indexed else ", body to world"
        elif set(angles) == {2}:
            entry, why = {"heading": angles[2].column}, f"heading {angles[2].column} alone: a planar vehicle"
        elif angles:
            entry, why = {"angles": _columns(angles)}, f"angles {_listed(angles)}"
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
        name = self._tracker("pose", kind, f"{_listed(position)}, positions" if position else why)
        if not name:
            return
        if position:
            unit = self._unit(position, "length", "m")
            said = f"position {_listed(position)} in {unit}" + (f", {why}" if entry else "")
            entry = {"position": _columns(position), "unit": unit, **entry}
        else:
            said = why
        self._add(name, {"kind": kind, **entry})
        self._say(f"{name}: {said}")

    # -------------------------------------------------------------------------------- commands

    def _families(self, topic: Topic) -> list[JetColumns]:
        """Returns columns of one kind for the jets, the likelier to be commands first."""
        numeric = [column for column, values in topic.columns.items() if values.dtype != object]
        return jet_families(numeric, [(jet.designation, jet.number) for jet in self.vehicle.jets])

    def _jet_columns(self, topic: Topic) -> dict[str, str]:
        """Returns a column for each jet, by designation; empty where not all are found."""
        for family in self._families(topic):
            columns = list(family.columns.values())
            if family.lacking or (not family.named and not self._scaled(topic, columns)):
                continue
            if any(_varies(topic.numbers(column)) for column in family.beside):
                self.partial_commands = (
                    f"; {', '.join([*columns, *family.beside])} are more than the vehicle's {len(columns)} jets"
                )
                continue
            return family.columns
        return {}

    def _commands(self, topic: Topic) -> bool:
        """Looks for commands to the jets; returns whether there are any."""
        columns = self._jet_columns(topic)
        if columns:
            self.data["commands"] = {"columns": columns}
            self._say(f"commands: a column for each of the {len(columns)} jets, by their names")
            self._scale(topic, columns)
            return True
        families = self._families(topic)
        part = next((one for one in families if one.named and 2 * len(one.columns) > len(self.vehicle.jets)), None)
        if part is not None and part.lacking:
            self.partial_commands = (
                f"; {', '.join(part.columns.values())} look like them, but there is none for jet "
                f"{', '.join(part.lacking)}"
            )
        for column, values in topic.columns.items():
            if values.dtype == object:
                texts = {word.lower() for text in topic.texts(column) for word in mapping.words(text)}
                if texts and texts <= {jet.lower() for jet in self.vehicle.designations}:
                    self.data["commands"] = {"listed": {"column": column}}
                    self._say(f"commands: column {column} lists designations of jets, such as {sorted(texts)[0]}")
                    return True
        counted = {column for one in families for column in (*one.columns.values(), *one.beside)}
        for column, values in topic.columns.items():
            if values.dtype == object or column in counted or not read_name(column).may_be_mask:
                continue
            numbers = topic.numbers(column)
            numbers = numbers[np.isfinite(numbers)]
            whole = numbers.size and (numbers == np.round(numbers)).all() and numbers.min() >= 0.0
            if whole and 1.0 < numbers.max() < 2.0 ** len(self.vehicle.jets):
                bits = {jet: bit for bit, jet in enumerate(self.vehicle.designations)}
                self.data["commands"] = {"mask": {"column": column, "bits": bits}}
                self._say(
                    f"commands: column {column} has whole numbers below 2^{len(bits)}: a bit mask; that bit 0 is "
                    f"{self.vehicle.designations[0]} and so on is a guess"
                )
                return True
        return False

    def _scaled(self, topic: Topic, columns: Sequence[str]) -> bool:
        """Tests whether columns that are only numbered hold values of commands: widths of pulses."""
        values = np.concatenate([topic.numbers(column) for column in columns])
        return bool(np.nanmin(values) > _PULSES[0] and np.nanmax(values) < _PULSES[1] and _varies(values))

    def _scale(self, topic: Topic, columns: Mapping[str, str]) -> None:
        """Finds the scales that the numbers of the jets' columns may have, and takes the likeliest."""
        values = np.concatenate([topic.numbers(column) for column in columns.values()])
        values = values[np.isfinite(values)]
        name = read_name(next(iter(columns.values())), topic.units.get(next(iter(columns.values())), ""))
        if not values.size:
            return
        is_timed = name.is_on_time or factor_or_none(name.unit, "time") is not None
        is_told = is_timed or factor_or_none(name.unit, "number") is not None
        levels = two_levels(values)
        if levels is not None and not is_told and (levels.closed != 0.0 or levels.scatters):
            self._take_levels(levels)
            return
        if np.isin(values, (0.0, 1.0)).all() and not is_timed:
            return
        if values.min() > _PULSES[0] and values.max() < _PULSES[1]:
            off, on = _pulse_widths(values)
            self.data["commands"] |= {"off": off, "on": on}
            self._say(
                f"commands: they lie between {values.min():g} and {values.max():g}, like widths of pulses in us, "
                f"{off:g} closed and {on:g} open: a guess"
            )
            return
        period_s, usual = self.vehicle.sample_period_s, without_rare(values)
        scales = possible_scales(values, period_s)
        if usual.size < values.size:
            scales += [one for one in possible_scales(usual, period_s) if one not in scales]
            most = float(values.max()), float(usual.max())
            scales.sort(key=lambda one: not any(map(one.is_reached, most)))
        told = [one for one in scales if name.unit and _is_unit_of(name.unit, one)]
        if not told and name.is_on_time:
            told = [one for one in scales if one.is_timed]
        if not scales and values.any():
            self.lacking.append(
                f"commands, {', '.join(columns.values())}, go from {values.min():g} to {values.max():g}, which is "
                "neither a share, percent, an on-time within the sample period nor the width of a pulse: give "
                "commands.unit, off, on"
            )
        self._scales = [_as_data(one) for one in told or scales]
        if self._scales:
            best = (told or scales)[0]
            self._is_scale_sure = bool(told) or (usual.size == values.size and best.is_reached(float(values.max())))
            self.data["commands"] |= self._scales[0]
            why = "as their names say" if told else f"since they reach {values.max():g}"
            self._say(f"commands: {best.words}, {why}")

    def _take_levels(self, levels: Levels) -> None:
        """Takes the two levels that commands have for closed and open, the more frequent one for closed."""
        off, on = levels[:2]
        if "missing" in self.data["commands"]:  # disarmed jets are closed besides
            off, on = min(off, on), max(off, on)
        if (off, on) != (0.0, 1.0):
            self.data["commands"] |= {"off": off, "on": on}
        why = "the only two values"
        if levels.scatters or levels.beside:
            why = "about the only two values"
        if levels.scatters and not levels.beside:
            self.data["commands"]["threshold"] = 0.5
        self._say(f"commands: {off:g} closed and {on:g} open, {why}; which one is closed is a guess")
        if levels.beside:
            shown = ", ".join(f"{one:g}" for one in levels.beside[:3])
            self._say(f"commands: {shown} {'is' if len(levels.beside) == 1 else 'are'} rare, and neither of them")

    # ---------------------------------------------------------------------- evidence of the jets

    def look_at_the_jets(self) -> None:
        """Finds, by the jets' effects on sensors, when commands act, their scale, and the meaning of readings."""
        if "commands" not in self.data or not self.data["sensors"]:
            return
        commands, usual = self.data["commands"], "a row's command acts from the row on"
        commands["acts"] = "from_row"
        inertial = [name for name, one in self.data["sensors"].items() if one["kind"] in ("gyro", "accelerometer")]
        by = {acts: self._understood(acts) for acts in ("from_row", "until_row")}
        before, after = by["until_row"], by["from_row"]
        gyro = next((name for name in inertial if self.data["sensors"][name]["kind"] == "gyro"), "")
        if not gyro or before is None or after is None:
            self._say(f"commands.acts: from_row, since nothing here tells: {usual}")
            return
        alike = [evidence.followed(one, gyro) for one in (after, before)]
        if any(math.isnan(one.correlation) for one in alike):
            self._say("commands.acts: from_row, since too few jets fire to tell")
            shown = after
        else:
            later = alike[1].explained > alike[0].explained + evidence.ODDS
            commands["acts"] = "until_row" if later else "from_row"
            shown = before if later else after
            self._say(
                f"commands.acts: {commands['acts']}, since the rates follow a row's command with a correlation of "
                f"{alike[0].correlation:.2f} in the interval after the row and {alike[1].correlation:.2f} in the one "
                "before"
            )
            self._look_for_a_lag(gyro, alike[0], alike[later])
            if max(one.explained for one in alike) <= evidence.ODDS and alike[later].correlation < _AGAINST:
                self._warn(
                    f"{gyro}: the rates go against what the jets should do: look at its axes, signs and `off`, `on`"
                )
            self._tell_scale(gyro, alike[later])
        for name in inertial:
            if self.data["sensors"][name]["kind"] == "accelerometer":
                self._tell_sums(name, shown)

    def _look_for_a_lag(self, gyro: str, after: evidence.JetEvidence, taken: evidence.JetEvidence) -> None:
        """Warns where neither interval next to a row fits: of the lag that does, or that none is known.

        Args:
            gyro: whose rates are followed.
            after: evidence of the interval after the row.
            taken: evidence of the interval that is proposed.
        """
        farthest = min(_FARTHEST, len(after.meant) // 2)
        lags = {lag: after.shifted(lag) for lag in range(-farthest, farthest + 1)}
        best = max(lags, key=lambda lag: np.nan_to_num(lags[lag].explained))
        odds = evidence.ODDS + math.log(len(lags))  # any of them may be the one
        if lags[best].explained > taken.explained + odds and not lags[best].is_poor:
            rows = f"{abs(best)} row{'s' if abs(best) > 1 else ''} {'after' if best > 0 else 'before'}"
            offset_s = float(f"{best * self.vehicle.sample_period_s:.9g}")
            self._warn(
                f"{gyro}: the rates follow commands best, with a correlation of {lags[best].correlation:.2f}, that act "
                f"from {rows} their own on, which neither interval next to a row is: give these a clock of their own, "
                f"`commands: {{acts: from_row, time: {{..., offset_s: {offset_s:g}}}}}`"
            )
        elif taken.is_poor and taken.explained > evidence.ODDS:
            self._warn(
                f"{gyro}: the rates follow the commands poorly, with a correlation of {taken.correlation:.2f}, and not "
                "better with another lag: look at axes, signs, units and which jet is which"
            )

    def _understood(self, acts: str) -> channels.Mapped | None:
        """Returns the record as the map has it so far; None where the map cannot be applied."""
        try:
            by = RecordMap.model_validate({**self.data, "commands": {**self.data["commands"], "acts": acts}})
            return mapping.mapped(self.recording, by, self.vehicle)
        except ValueError:  # said when the map is shown
            return None

    def _tell_scale(self, gyro: str, shown: evidence.JetEvidence) -> None:
        """Chooses the scale of commands, and a unit of rates that no name gives, by how the jets turn the vehicle.

        One of both may change, the unit only where the scale is sure; the likelier scale may fit a little worse.
        """
        if not shown.explained > evidence.ODDS or not shown.slope > 0.0:
            return
        entry = self.data["sensors"][gyro]
        period_s = self.vehicle.sample_period_s
        full = [_full(one, period_s) for one in self._scales] or [1.0]
        units = _RATE_UNITS if gyro in self._guessed and self._is_scale_sure else (entry["unit"],)

        def misfit(scale: int, unit: str) -> float:
            times = full[scale] / full[0] * factor(unit, "rate") / factor(entry["unit"], "rate")
            return abs(math.log(shown.slope * times))

        scale, unit = min(
            ((index, unit) for index in range(len(full)) for unit in units if not index or unit == entry["unit"]),
            key=lambda one: misfit(*one) + _DISFAVOR * (one[0] + (one[1] != entry["unit"])),
        )
        if misfit(scale, unit) > math.log(_OFF):
            self._warn(
                f"{gyro}: the rates change {shown.slope:.3g} times as much as the jets should make them, as units and "
                "commands are taken: look there first"
            )
            return
        if unit != entry["unit"]:
            self._say(
                f"{gyro}: {unit}, since as {entry['unit']} it would turn {shown.slope:.3g} times as much as the jets "
                "can make it"
            )
            entry["unit"] = unit
        if scale:
            for key in ("unit", "on"):
                self.data["commands"].pop(key, None)
            self.data["commands"] |= self._scales[scale]
            said = ", ".join(f"{key} {value}" for key, value in self._scales[scale].items()) or "fractions"
            self._say(
                f"commands: {said}, since else the rates would change {shown.slope:.3g} times as much as the jets can "
                "make them"
            )

    def _tell_sums(self, name: str, by: channels.Mapped) -> None:
        """Distinguishes sums of velocity, increments and accelerations, by the jets' effects on them."""
        entry = self.data["sensors"][name]
        if entry["gives"] in ("mean", "instant") and name not in self._guessed:
            return  # their unit is that of an acceleration
        sums, values = (evidence.followed(by, name, gives=gives) for gives in ("integral", "increment"))
        if sums.explained > values.explained + evidence.ODDS:
            gives, followed = "integral", "differences"
        elif values.explained > sums.explained + evidence.ODDS:
            gives, followed = self._of_values(name, by, values), "values"
        elif (
            entry["gives"] == "increment"
            and not values.explained > evidence.ODDS
            and evidence.keeps_its_level(by, name)
        ):
            entry["gives"] = "integral"
            self._say(f"{name}: sums of increments, since they keep their level while no jet fires")
            return
        else:
            return
        if gives == entry["gives"]:
            return
        entry["gives"] = gives
        if name in self._guessed:
            entry["unit"] = f"{self._guessed[name]}^2" if gives == "mean" else self._guessed[name]
        called = {"integral": "sums of increments", "increment": "increments of velocity", "mean": "accelerations"}
        self._say(
            f"{name}: {called[gives]}, since their {followed} follow the commands with a correlation of "
            f"{max(sums.correlation, values.correlation):.2f}, their "
            f"{'values' if followed == 'differences' else 'differences'} with "
            f"{min(sums.correlation, values.correlation):.2f}"
        )

    def _of_values(self, name: str, by: channels.Mapped, values: evidence.JetEvidence) -> str:
        """Distinguishes increments from accelerations, where sums do not follow the jets, by how much they change."""
        usual = "mean" if self.data["sensors"][name]["gives"] == "mean" else "increment"
        if name not in self._guessed:
            return usual
        misfit = {"increment": abs(math.log(values.slope))}
        misfit["mean"] = abs(math.log(evidence.followed(by, name, gives="mean").slope))
        misfit[usual] -= _DISFAVOR
        return min(misfit, key=lambda gives: misfit[gives])

    # ------------------------------------------------------------------------------------- PX4

    def in_px4(self) -> None:
        """Takes the topics that PX4 logs, in its frame: forward, right, down."""
        topics = {_base(name): name for name in reversed(list(self.recording.topics))}
        for base, column, what in _PX4_RATES:
            if self._px4_vector(topics, (base, column), "gyro", {"unit": "rad/s"}, what):
                break
        for base, column, gives, what in _PX4_ACCELERATIONS:
            taken = self._gives(topics[base]) if base in topics and gives == "instant" else gives
            more = {"unit": "m/s" if taken == "increment" else "m/s^2", "gives": taken}
            guess = "; one a sample is taken for the mean over it: a guess" if taken != gives else ""
            if self._px4_vector(topics, (base, column), "accelerometer", more, what + guess):
                break
        for base in _PX4_POSE:
            if base in topics and {"position[0]", "q[0]"} <= set(self.recording.topics[topics[base]].columns):
                name = self._tracker("pose", "mocap", f"{topics[base]}, poses")
                if not name:
                    break
                self.data["sensors"][name] = {
                    "kind": "pose",
                    "topic": topics[base],
                    "position": [f"position[{axis}]" for axis in range(3)],
                    "quaternion": [f"q[{part}]" for part in range(4)],
                    "order": "wxyz",
                }
                self._say(
                    f"{name}: {topics[base]}, position in m and a quaternion that turns body to world, scalar first"
                )
                break
        count = len(self.vehicle.jets)
        for base, column in _PX4_COMMANDS:
            there = self.recording.topics[topics[base]].columns if base in topics else {}
            if all(f"{column}[{index}]" in there for index in range(count)):
                block: dict[str, Any] = {"topic": topics[base]}
                block["columns"] = {jet: f"{column}[{index}]" for index, jet in enumerate(self.vehicle.designations)}
                block["missing"] = "off"
                self.data["commands"] = block
                self._say(f"commands: {topics[base]}, {column}[0] the vehicle's first jet and so on; NaN is disarmed")
                self._scale(self.recording.topics[topics[base]], block["columns"])
                break

    def _px4_vector(
        self, topics: Mapping[str, str], where: tuple[str, str], kind: str, more: dict[str, Any], what: str
    ) -> bool:
        base, column = where
        columns = [f"{column}[{axis}]" for axis in range(3)]
        if base not in topics or not set(columns) <= set(self.recording.topics[topics[base]].columns):
            return False
        package = self._package(kind)
        if package:
            self.data["sensors"][package] = {"kind": kind, "topic": topics[base], "columns": columns, **more}
            self._say(f"{package}: {topics[base]}, {what}")
        return bool(package)

    # ------------------------------------------------------------------------------------ bags

    def in_a_bag(self) -> None:
        """Takes topics by the types of their messages."""
        self.in_px4()
        axes = ("x", "y", "z")
        for name, topic in self.recording.topics.items():
            kind = self.recording.types.get(name, "").rpartition("/")[2]
            if kind == "Imu":
                self._of_imu(name)
            before = {"PoseStamped": "pose.", "Odometry": "pose.pose.", "PoseWithCovarianceStamped": "pose.pose."}.get(
                kind
            )
            names = ("position", "orientation")
            if kind == "TransformStamped":
                before, names = "transform.", ("translation", "rotation")
            known = any(one["kind"] == "pose" for one in self.data["sensors"].values())
            sensor = "" if before is None or known else self._tracker("pose", "pose", f"{name}, poses")
            if sensor:
                self.data["sensors"][sensor] = {
                    "kind": "pose",
                    "topic": name,
                    "position": [f"{before}{names[0]}.{axis}" for axis in axes],
                    "quaternion": [f"{before}{names[1]}.{part}" for part in (*axes, "w")],
                    "order": "xyzw",
                }
                self._say(f"{sensor}: {name}, a {kind}")
            if "commands" not in self.data:
                self._bag_commands(name, topic)
        if any(one["kind"] in ("gyro", "accelerometer") for one in self.data["sensors"].values()):
            self._say(
                "axes: as they are logged; ROS has forward, left, up, so that a vehicle of forward, right, down needs "
                "`axes: [x, -y, -z]`"
            )

    def _of_imu(self, name: str) -> None:
        for kind, field, more in (
            ("gyro", "angular_velocity", {"unit": "rad/s"}),
            ("accelerometer", "linear_acceleration", {"unit": "m/s^2", "gives": self._gives(name)}),
        ):
            package = self._package(kind)
            if package:
                columns = [f"{field}.{axis}" for axis in ("x", "y", "z")]
                self.data["sensors"][package] = {"kind": kind, "topic": name, "columns": columns, **more}
                guess = ", taken for the mean over the sample that ended" if more.get("gives") == "mean" else ""
                self._say(f"{package}: {name}, {field} of an Imu, in {more['unit']}{guess}")

    def _gives(self, topic: str) -> str:
        """Takes accelerations of a topic for instants, where there are enough to be integrated, or for means."""
        stamps = self.recording.topics[topic].stamps_s
        if stamps is None or stamps.size < 2:
            return "mean"
        every = float(np.median(np.diff(stamps)))
        return "instant" if mapped_rows.FEWEST_INSTANTS * every <= self.vehicle.sample_period_s * 1.01 else "mean"

    def _bag_commands(self, name: str, topic: Topic) -> None:
        count = len(self.vehicle.jets)
        columns = self._jet_columns(topic)
        arrays = {column.partition("[")[0] for column in topic.columns if column.endswith(f"[{count - 1}]")}
        for array in arrays:
            if not columns and f"{array}[{count}]" not in topic.columns and "ovariance" not in array:
                columns = {jet: f"{array}[{index}]" for index, jet in enumerate(self.vehicle.designations)}
        if columns:
            self.data["commands"] = {"topic": name, "columns": columns}
            self._say(f"commands: {name}, of as many numbers as there are jets, in the vehicle's order")
            self._scale(topic, columns)


def _has_numbers(values: NDArray[Any]) -> bool:
    return bool(values.dtype.kind in "biuf" and np.isfinite(values).any())


def _base(topic: str) -> str:
    return topic.rpartition("/")[2] if topic.startswith("/") else topic.partition("/")[0]


def _texts(data: Any) -> Iterator[str]:
    """Returns all texts in the data of a map, keys aside."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        yield from chain.from_iterable(map(_texts, data.values()))
    elif isinstance(data, list):
        yield from chain.from_iterable(map(_texts, data))


def _used(data: Mapping[str, Any]) -> dict[str, set[str]]:
    """Returns the columns that a map names, by topic."""
    usual = data.get("topic", "")
    used: dict[str, set[str]] = {}
    for entry in (*data.get("sensors", {}).values(), *filter(None, [data.get("commands")])):
        topic = entry.get("topic", usual)
        used.setdefault(topic, set()).update(_texts(entry), _texts({} if "time" in entry else data.get("time", {})))
    if not used:
        used[usual] = set(_texts(data.get("time", {})))
    return used


def _folded(columns: Sequence[str]) -> list[str]:
    """Joins names of columns: elements of an array that follow each other are one entry."""
    split = [re.fullmatch(r"(.*\[)(\d+)(\].*)", column) for column in columns]
    found: list[str] = []
    runs = groupby(
        enumerate(columns),
        key=lambda one: (
            one[1] if (part := split[one[0]]) is None else (part.group(1), part.group(3), int(part.group(2)) - one[0])
        ),
    )
    for _, run in runs:
        names = [name for _, name in run]
        found += [f"{names[0]} to {names[-1]}"] if len(names) >= _FOLDED else names
    return found


def _plainly(name: str) -> str:
    """Returns a name in small letters, without signs."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _from_zero(members: dict[int, ColumnName]) -> dict[int, ColumnName]:
    """Renumbers axes from zero, where they are counted from 1."""
    indexed = all(one.indexed for one in members.values())
    return {axis - 1: one for axis, one in members.items()} if indexed and 0 not in members else members


def _varies(values: Array) -> bool:
    values = values[np.isfinite(values)]
    return bool(values.size) and bool((values != values[0]).any())


def _pulse_widths(values: Array) -> tuple[float, float]:
    """Returns widths of closed and open, us: the two found, or the usual ones; below closed is disarmed."""
    armed = values[values >= _CLOSED_PULSE]
    levels = np.unique(armed)
    if levels.size == 2:
        return float(levels[0]), float(levels[1])
    least, most = (float(armed.min()), float(armed.max())) if armed.size else (1000.0, 2000.0)
    off, on = (1100.0, 1900.0) if least >= 1100.0 and most <= 1900.0 else (1000.0, 2000.0)
    return min(off, least), max(on, most)


def _as_data(scale: CommandScale) -> dict[str, Any]:
    """Returns keys of a map's commands for a scale."""
    if scale.unit != "1":
        return {"unit": scale.unit}
    return {} if scale.full == 1.0 else {"on": scale.full}


def _full(scale: Mapping[str, Any], period_s: float) -> float:
    """Returns the number that stands for a jet that is open all the time."""
    unit = scale.get("unit", "1")
    if unit == "%":
        return 100.0
    return float(scale.get("on", 1.0)) if unit == "1" else period_s / factor(unit, "time")


def _is_unit_of(unit: str, scale: CommandScale) -> bool:
    """Tests whether a unit that a name has is that of a scale."""
    kind = "time" if scale.is_timed else "number"
    own, wanted = factor_or_none(unit, kind), factor_or_none(scale.unit, kind)
    return own is not None and own == wanted


def _columns(members: Mapping[int, ColumnName]) -> list[str | None]:
    return [members[axis].column if axis in members else None for axis in range(3)]


def _every(readings: Array) -> int:
    """Returns rows for each reading, shape (n, m), where rows repeat one until there is another; else 1."""
    rows = mapping.changes(readings)
    return int(np.gcd.reduce(np.diff(rows))) if rows.size >= _FEWEST else 1


def _listed(members: Mapping[int, ColumnName]) -> str:
    return ", ".join(members[axis].column for axis in sorted(members))


def _steps(topic: Topic, value: tuple[str, str], rate: tuple[str, str]) -> Array | None:
    """Finds the steps by which a rate would be the backward difference of a value; None where it is none."""
    change = np.diff(topic.numbers(value[0])) * factor(value[1], "length", "angle")
    if factor_or_none(value[1], "angle") is not None:
        change = (change + np.pi) % (2.0 * np.pi) - np.pi
    speed = topic.numbers(rate[0])[1:] * factor(rate[1], "velocity", "rate")
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
