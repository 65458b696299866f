"""State that the searches for sensors and commands share: the map so far, and the reasons for it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, groupby
from typing import Any

import numpy as np

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records import mapped_rows
from massprop_drake.records.clocks import TopicClock
from massprop_drake.records.names import ColumnName, column_quantity, si_factor_or_none
from massprop_drake.records.topics import Recording

_FOLDED = 4  # elements of an array that are listed as from the first to the last


class MapSearch:
    """State of a search for a vehicle's sensors and jets: the map so far, and the reasons for it."""

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
        self._called = {kind: {compact_name(one) for one in self._free[kind]} for kind in ("gyro", "accelerometer")}
        self._scales: list[dict[str, Any]] = []  # of the commands, as a map has them, the likelier first
        self._is_scale_sure = True  # told by names, or reached exactly
        self._guessed: dict[str, str] = {}  # sensors whose unit no name tells, and that of a velocity of theirs
        self.partial_commands = ""  # what is lacking of commands that were nearly found
        self.left_out: list[str] = []
        self._clocks: dict[str, TopicClock | None] = {}

    def _say(self, reason: str) -> None:
        """Adds a sentence to the reasons for the proposed map."""
        self.reasons.append(reason)

    def _warn(self, reason: str) -> None:
        """Adds a sentence to the reasons for the proposed map and to its warnings."""
        self._say(reason)
        self.warnings.append(reason)

    def _find_quantity(self, name: ColumnName) -> str:
        """Returns the quantity that a column measures, by the words of its name or a package's name; "": not known."""
        joined = compact_name("".join(name.words))
        return next((kind for kind, names in self._called.items() if joined in names), column_quantity(name))

    def _is_package_name(self, kind: str, words: Sequence[str]) -> bool:
        """Tests whether words of a column's name are the name of a package of the vehicle, of a kind such as "gyro"."""
        return bool({*map(compact_name, words), compact_name("".join(words))} & self._called[kind])

    def _take_package(self, kind: str, words: Sequence[str] = ()) -> str:
        """Returns and removes a package that has no columns yet, one of that name first; "": none."""
        free = self._free[kind]
        names = {*map(compact_name, words), compact_name("".join(words))}
        name = next((one for one in free if compact_name(one) in names), free[0] if free else "")
        if name:
            free.remove(name)
        return name

    def _take_tracker(self, kind: str, display_name: str, description: str) -> str:
        """Returns the vehicle's next pose or velocity sensor, or a name for display; "": neither."""
        name = self._take_package(kind) or ("" if self.vehicle.needs_pose_filter else display_name)
        if not name:
            self._say(f"{description}: the vehicle has no further {kind} sensor")
        return name

    def report_unused(self) -> None:
        """Adds reasons that name packages without columns, and columns and topics that the map does not use."""
        missing = [name for free in self._free.values() for name in free]
        if missing:
            self._say(f"no columns were found for {', '.join(missing)}: name them under `sensors` if they were logged")
        used = _used_columns(self.data)
        for name, topic in self.recording.topics.items():
            left = _fold_array_names([column for column in topic.columns if column not in used.get(name, ())])
            if name in used or not name:
                self.left_out += left
                if left:
                    self._say(f"not used{f' of {name}' if name else ''}: {', '.join(left)}")
        topics = [name for name in self.recording.topics if name and name not in used]
        if topics:
            self.left_out += topics
            self._say(f"topics not used: {', '.join(topics)}")

    def _set_topic_and_time(self, entry: dict[str, Any]) -> None:
        """Writes the current topic and its time into an entry of the map, where they differ from the map's own."""
        name, time = self._here
        if name != self.data.get("topic", ""):
            entry["topic"] = name
            if time is not None and time != self.data.get("time"):
                entry["time"] = time

    def _add_sensor(self, name: str, entry: dict[str, Any]) -> None:
        """Adds a sensor's entry to the map, unless one of this name is there."""
        if name not in self.data["sensors"]:
            self._set_topic_and_time(entry)
            self.data["sensors"][name] = entry

    def _unit(self, members: Mapping[int, ColumnName], kind: str, default: str) -> str:
        """Returns the unit in the first column's name if it measures this kind of quantity, else the default."""
        unit = members[min(members)].unit
        return unit if unit and si_factor_or_none(unit, kind) is not None else default

    def _instant_or_mean(self, topic: str) -> str:
        """Returns "instant" for accelerations logged densely enough to be integrated, else "mean"."""
        stamps = self.recording.topics[topic].stamps_s
        if stamps is None or stamps.size < 2:
            return "mean"
        interval_s = float(np.median(np.diff(stamps)))
        return "instant" if mapped_rows.FEWEST_INSTANTS * interval_s <= self.vehicle.sample_period_s * 1.01 else "mean"


def _texts(data: Any) -> Iterator[str]:
    """Yields all texts among the values in the data of a map, at any depth."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        yield from chain.from_iterable(map(_texts, data.values()))
    elif isinstance(data, list):
        yield from chain.from_iterable(map(_texts, data))


def _used_columns(data: Mapping[str, Any]) -> dict[str, set[str]]:
    """Maps each topic to the columns that the data of a map use."""
    default_topic = data.get("topic", "")
    used: dict[str, set[str]] = {}
    for entry in (*data.get("sensors", {}).values(), *filter(None, [data.get("commands")])):
        topic = entry.get("topic", default_topic)
        used.setdefault(topic, set()).update(_texts(entry), _texts({} if "time" in entry else data.get("time", {})))
    if not used:
        used[default_topic] = set(_texts(data.get("time", {})))
    return used


def _fold_array_names(columns: Sequence[str]) -> list[str]:
    """Returns names of columns with successive elements of an array folded: "a[0] to a[7]"."""
    split = [re.fullmatch(r"(.*\[)(\d+)(\].*)", column) for column in columns]
    folded: list[str] = []
    runs = groupby(
        enumerate(columns),
        key=lambda one: (
            one[1] if (part := split[one[0]]) is None else (part.group(1), part.group(3), int(part.group(2)) - one[0])
        ),
    )
    for _, run in runs:
        names = [name for _, name in run]
        folded += [f"{names[0]} to {names[-1]}"] if len(names) >= _FOLDED else names
    return folded


def compact_name(name: str) -> str:
    """Returns a name in small letters, with letters and digits alone."""
    return re.sub(r"[^a-z0-9]", "", name.lower())
