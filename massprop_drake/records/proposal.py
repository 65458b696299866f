"""Map proposed for a recording, with its reasons: names of columns, their numbers, known topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records.clocks import TopicClock, clock_fault, find_clock
from massprop_drake.records.names import ColumnName, read_name
from massprop_drake.records.rows import jet_columns, onset_columns
from massprop_drake.records.sensor_search import SensorSearch
from massprop_drake.records.stamps import is_number
from massprop_drake.records.topics import Recording, Topic

ROWS = 4000  # of each topic that are looked at
_MOSTLY_NUMBERS = 0.5  # share of cells above which text in a column is an error
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


def make_proposal(recording: Recording, vehicle: Vehicle) -> Proposal:
    """Proposes a map from a recording's columns to a vehicle's sensors and jets, with reasons for each choice.

    Args:
        recording: as `open_recording` gives it; some thousand rows are enough.
        vehicle: whose sensors and jets are sought.
    """
    work = RecordingSearch(recording, vehicle)
    if recording.kind == "ulog":
        work.search_px4()
    elif recording.kind in ("ros1", "ros2"):
        work.search_bag()
    else:
        work.search_tables()
    work.search_by_jets()
    work.report_unused()
    if not work.data["sensors"]:
        work.lacking.append("no sensor was found: name its columns under `sensors`")
    if "commands" not in work.data:
        work.lacking.append(
            "no commands were found: name a column for each jet, a bit mask or a list under `commands`"
            + work.partial_commands
        )
    return Proposal(work.data, work.reasons, work.lacking, work.left_out, work.warnings)


class RecordingSearch(SensorSearch):
    """Search for sensors and commands in tables, in topics of PX4, and in bags."""

    def search_tables(self) -> None:
        """Adds sensors, commands and times of tables or .mat files to the map, by columns' names and values."""
        form = self.recording.form.model_dump(exclude_defaults=True)
        if form:
            self.data["csv"] = form
            self._say(f"csv: {', '.join(f'{key} {value!r}' for key, value in form.items())}, as its first lines show")
        topics = self.recording.topics
        names_by_topic = {
            name: [read_name(column, topic.units.get(column, "")) for column in topic.columns]
            for name, topic in topics.items()
        }
        numeric = {
            name: [one for one in names if _has_numbers(topics[name].columns[one.column])]
            for name, names in names_by_topic.items()
        }
        for topic in topics.values():
            self._recognize_telemetry(topic)
            self._warn_of_text_cells(topic)
        kinds = {
            name: {self._find_quantity(one) for one in names if one.axis >= 0} - {""} for name, names in numeric.items()
        }
        ordered = sorted(topics, key=lambda name: ("gyro" not in kinds[name], -len(kinds[name])))
        for name in ordered:
            if kinds[name] or len(topics) == 1:
                self._set_topic(name, names_by_topic[name])
                switched = self._switched_columns(topics[name])
                self._find_sensors(topics[name], [one for one in numeric[name] if one.column not in switched])
        for name in sorted(topics, key=lambda name: -len(self._jet_columns(topics[name]))):
            self._set_topic(name, names_by_topic[name], silent=True)
            if self._find_commands(topics[name]):
                self._set_topic_and_time(self.data["commands"])
                break
        if "time" not in self.data and not any(clock is not None for clock in self._clocks.values()):
            period_s = self.vehicle.sample_period_s
            faults = [fault for name in topics if (fault := clock_fault(topics[name], names_by_topic[name], period_s))]
            self.lacking.insert(0, "; ".join(["no column of time was found: name it, `time: {column: ...}`", *faults]))

    def _recognize_telemetry(self, topic: Topic) -> None:
        """Says that a table with the columns of telemetry needs no map; warns where a map would lose its onsets."""
        present = set(topic.columns)
        if {"time_s", *jet_columns(self.vehicle, present)} <= present:
            has_onsets = not present.isdisjoint(onset_columns(self.vehicle))
            lost = ", while by a map it loses when jets open within samples" if has_onsets else ""
            (self._warn if lost else self._say)(
                f"{topic.source}: its columns are those of telemetry: 'massprop estimate' reads it without a map{lost}"
            )

    def _warn_of_text_cells(self, topic: Topic) -> None:
        """Warns of columns of numbers that cannot be used because some cells hold text."""
        for column, values in topic.columns.items():
            numeric = sum(map(is_number, values)) if values.dtype == object else 0
            if not _MOSTLY_NUMBERS * values.size < numeric < values.size:
                continue
            try:
                topic.numbers(column)
            except InputError as error:
                self._warn(f"{error}, as the rest of its column is: nothing is made of it")

    def _set_topic(self, name: str, names: Sequence[ColumnName], *, silent: bool = False) -> None:
        """Makes a topic the current one, with its clock; the first topic and clock become the map's own."""
        clock = self._clock(name, names)
        self._here = name, clock.data if clock is not None and clock.data else None
        if "time" not in self.data and "topic" not in self.data:
            if name:
                self.data["topic"] = name
                self._say(f"topic {name}: it has rates, or most of the sensors")
            if clock is not None and clock.data:
                self.data["time"] = clock.data
                self._say(clock.reason)
            if clock is not None and clock.coarse and clock.coarse not in (*self.reasons, *self.lacking):
                (self._say if clock.data else self.lacking.append)(clock.coarse)
        elif clock is not None and not silent and self._here[1] != self.data.get("time"):
            self._say(f"{name}: {clock.reason}")

    def _clock(self, name: str, names: Sequence[ColumnName]) -> TopicClock | None:
        """Returns the clock of a topic, found once and stored; None where it has none."""
        if name not in self._clocks:
            self._clocks[name] = find_clock(self.recording.topics[name], names, self.vehicle.sample_period_s)
        return self._clocks[name]

    def search_px4(self) -> None:
        """Adds rates, accelerations, pose and commands to the map from the topics that PX4 logs."""
        topics = {_base_topic(name): name for name in reversed(list(self.recording.topics))}
        for base, column, text in _PX4_RATES:
            if self._add_px4_vector(topics, (base, column), "gyro", {"unit": "rad/s"}, text):
                break
        for base, column, gives, text in _PX4_ACCELERATIONS:
            meaning = self._instant_or_mean(topics[base]) if base in topics and gives == "instant" else gives
            keys = {"unit": "m/s" if meaning == "increment" else "m/s^2", "gives": meaning}
            guess = "; one a sample is taken for the mean over it: a guess" if meaning != gives else ""
            if self._add_px4_vector(topics, (base, column), "accelerometer", keys, text + guess):
                break
        for base in _PX4_POSE:
            if base in topics and {"position[0]", "q[0]"} <= set(self.recording.topics[topics[base]].columns):
                name = self._take_tracker("pose", "mocap", f"{topics[base]}, poses")
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
            columns = self.recording.topics[topics[base]].columns if base in topics else {}
            if all(f"{column}[{index}]" in columns for index in range(count)):
                block: dict[str, Any] = {"topic": topics[base]}
                block["columns"] = {jet: f"{column}[{index}]" for index, jet in enumerate(self.vehicle.designations)}
                block["missing"] = "off"
                self.data["commands"] = block
                self._say(f"commands: {topics[base]}, {column}[0] the vehicle's first jet and so on; NaN is disarmed")
                self._find_scale(self.recording.topics[topics[base]], block["columns"])
                break

    def _add_px4_vector(
        self, topics: Mapping[str, str], field: tuple[str, str], kind: str, keys: dict[str, Any], text: str
    ) -> bool:
        """Adds a PX4 topic's vector to the map as a gyro or accelerometer; False without topic or package."""
        base, column = field
        columns = [f"{column}[{axis}]" for axis in range(3)]
        if base not in topics or not set(columns) <= set(self.recording.topics[topics[base]].columns):
            return False
        package = self._take_package(kind)
        if package:
            self.data["sensors"][package] = {"kind": kind, "topic": topics[base], "columns": columns, **keys}
            self._say(f"{package}: {topics[base]}, {text}")
        return bool(package)

    def search_bag(self) -> None:
        """Adds sensors and commands of a ROS bag to the map, by the types of its messages."""
        self.search_px4()
        axes = ("x", "y", "z")
        for name, topic in self.recording.topics.items():
            kind = self.recording.types.get(name, "").rpartition("/")[2]
            if kind == "Imu":
                self._add_imu(name)
            prefix = {"PoseStamped": "pose.", "Odometry": "pose.pose.", "PoseWithCovarianceStamped": "pose.pose."}.get(
                kind
            )
            names = ("position", "orientation")
            if kind == "TransformStamped":
                prefix, names = "transform.", ("translation", "rotation")
            known = any(one["kind"] == "pose" for one in self.data["sensors"].values())
            sensor = "" if prefix is None or known else self._take_tracker("pose", "pose", f"{name}, poses")
            if sensor:
                self.data["sensors"][sensor] = {
                    "kind": "pose",
                    "topic": name,
                    "position": [f"{prefix}{names[0]}.{axis}" for axis in axes],
                    "quaternion": [f"{prefix}{names[1]}.{part}" for part in (*axes, "w")],
                    "order": "xyzw",
                }
                self._say(f"{sensor}: {name}, a {kind}")
            if "commands" not in self.data:
                self._find_bag_commands(name, topic)
        if any(one["kind"] in ("gyro", "accelerometer") for one in self.data["sensors"].values()):
            self._say(
                "axes: as they are logged; ROS has forward, left, up, so that a vehicle of forward, right, down needs "
                "`axes: [x, -y, -z]`"
            )

    def _add_imu(self, name: str) -> None:
        """Adds the rates and accelerations of a topic of Imu messages to the map, as packages of the vehicle."""
        for kind, field, keys in (
            ("gyro", "angular_velocity", {"unit": "rad/s"}),
            ("accelerometer", "linear_acceleration", {"unit": "m/s^2", "gives": self._instant_or_mean(name)}),
        ):
            package = self._take_package(kind)
            if package:
                columns = [f"{field}.{axis}" for axis in ("x", "y", "z")]
                self.data["sensors"][package] = {"kind": kind, "topic": name, "columns": columns, **keys}
                guess = ", taken for the mean over the sample that ended" if keys.get("gives") == "mean" else ""
                self._say(f"{package}: {name}, {field} of an Imu, in {keys['unit']}{guess}")

    def _find_bag_commands(self, name: str, topic: Topic) -> None:
        """Adds a topic's columns named after the jets, or its array of as many numbers, as commands."""
        count = len(self.vehicle.jets)
        columns = self._jet_columns(topic)
        arrays = {column.partition("[")[0] for column in topic.columns if column.endswith(f"[{count - 1}]")}
        for array in arrays:
            if not columns and f"{array}[{count}]" not in topic.columns and "ovariance" not in array:
                columns = {jet: f"{array}[{index}]" for index, jet in enumerate(self.vehicle.designations)}
        if columns:
            self.data["commands"] = {"topic": name, "columns": columns}
            self._say(f"commands: {name}, of as many numbers as there are jets, in the vehicle's order")
            self._find_scale(topic, columns)


def _has_numbers(values: NDArray[Any]) -> bool:
    """Tests whether a column holds numbers, at least one of them finite."""
    return bool(values.dtype.kind in "biuf" and np.isfinite(values).any())


def _base_topic(topic: str) -> str:
    """Returns the last word of a topic's path, or a PX4 topic's name without the number of its instance."""
    return topic.rpartition("/")[2] if topic.startswith("/") else topic.partition("/")[0]
