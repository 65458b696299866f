"""A map proposed for a recording, with its reasons: by names of columns, by what the numbers are, by known topics."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.units import factor, parsed
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.records import mapping
from massprop_drake.records.recording import Recording, Topic

Array = NDArray[np.float64]

ROWS = 4000  # of each topic that are looked at

# what a name's last part says of the unit
_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **{name: name for name in ("ms", "us", "ns", "mm", "cm", "m", "rad", "deg", "rpm", "g", "mg", "dps", "mrad")},
    **dict.fromkeys(("msec", "millis"), "ms"),
    **dict.fromkeys(("usec", "micros"), "us"),
    **dict.fromkeys(("nsec", "nanos"), "ns"),
    **dict.fromkeys(("radps", "rads", "radpers", "radsec"), "rad/s"),
    **dict.fromkeys(("degps", "degs", "degpers", "degsec"), "deg/s"),
    **dict.fromkeys(("mps", "mpers"), "m/s"),
    "mmps": "mm/s",
    **dict.fromkeys(("mps2", "mpss", "ms2", "mpers2"), "m/s^2"),
    **dict.fromkeys(("pct", "percent"), "%"),
    "fps": "ft/s",
    "ft": "ft",
}
_QUOTIENTS = {  # two parts of a name that are a unit
    (length, time): f"{length}/{'s^2' if time == 's2' else 's'}"
    for length in ("m", "mm", "cm", "ft", "rad", "mrad", "deg")
    for time in ("s", "s2")
}
_WORDS: Mapping[str, frozenset[str]] = {
    "gyro": frozenset({"gyro", "gyr", "gyroscope", "omega", "w", "rate", "rates", "angvel", "angular", "pqr"}),
    "accelerometer": frozenset({"acc", "accel", "a", "acceleration", "accelerometer", "sf"}),
    "increment": frozenset({"dv", "deltav", "dvel"}),
    "velocity": frozenset({"v", "vel", "velocity", "speed"}),
    "position": frozenset({"p", "pos", "position", "r", "xyz", "translation"}),
    "quaternion": frozenset({"q", "quat", "quaternion", "orientation", "attitude", "att", "rotation"}),
}
_TIME_WORDS = {"time", "t", "timestamp", "stamp", "clock", "tstamp", "utc", "epoch"}
_ANGLE_WORDS = {"roll": 0, "pitch": 1, "yaw": 2, "heading": 2, "psi": 2, "hdg": 2}
_JET_WORDS = {"jet", "jets", "thr", "thruster", "thrusters", "valve", "valves", "cmd", "command", "u", "nozzle", "rcs"}
_MASK_WORDS = _JET_WORDS | {"mask", "bits", "bitmask", "fire", "firing", "on"}
_ON_WORDS = {"on", "ton", "duration", "width", "pulse", "ontime"}
_AXES = {**{axis: index for index, axis in enumerate("xyz")}, "p": 0, "q": 1, "r": 2}
_QUATERNION = re.compile(r"(?:.*_)?(?:q|quat|quaternion|orientation)_?([wxyz0-3]?)")
_UNIFORM = 1e-4  # of its median, by which steps of a clock that only counts may differ
_CLEARLY = 0.2  # by which one correlation must exceed the other
_LISTED = 12  # columns that are named at the most
_FEWEST = 20  # samples in which jets fire, from which units and intervals are told

# of PX4: columns, and what they are
_PX4_GYRO = ("vehicle_angular_velocity", "xyz")
_PX4_INCREMENTS, _PX4_INSTANTS = ("vehicle_imu", "delta_velocity"), ("vehicle_acceleration", "xyz")
_PX4_POSE = ("vehicle_visual_odometry", "vehicle_mocap_odometry")
_PX4_COMMANDS = (("actuator_motors", "control"), ("actuator_outputs", "output"))


class Proposal(NamedTuple):
    """A map, and why it is so.

    Attributes:
        data: of the map, as its file has it.
        reasons: a sentence each.
        lacking: what could not be found, a sentence each; the map is not whole then.
    """

    data: dict[str, Any]
    reasons: list[str]
    lacking: list[str]


class _Name(NamedTuple):
    """What the name of a column says.

    Attributes:
        column: the name.
        words: of it, without unit and axis.
        axis: 0 to 2, 3 of a quaternion's fourth; -1: none.
        unit: as `inputs.units` has it; "": it says none.
        indexed: whether the axis is a number.
    """

    column: str
    words: tuple[str, ...]
    axis: int
    unit: str
    indexed: bool = False


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
        work.lacking.append("no commands were found: name a column for each jet, a bit mask or a list under `commands`")
    return Proposal(work.data, work.reasons, work.lacking)


def read_name(column: str) -> _Name:
    """Reads the name of a column: `gyro_x_dps`, `wx [deg/s]`, `q[0]`, `angularVelocity.z`."""
    rest, unit = column, ""
    bracket = re.search(r"\s*[\[(]([^\])]*)[\])]\s*$", rest)
    if bracket and not bracket.group(1).isdigit():
        unit, rest = _known_unit(bracket.group(1)), rest[: bracket.start()]
    indexed = re.search(r"\[(\d+)\]", rest)
    rest = re.sub(r"\[\d+\]", "", rest)
    rest = re.sub(r"([a-z])([A-Z])", r"\1_\2", rest)
    words = [word for word in re.split(r"[^A-Za-z0-9µ°]+", rest.lower()) if word]
    if not unit and len(words) > 2 and (words[-2], words[-1]) in _QUOTIENTS:
        unit = _QUOTIENTS[words[-2], words[-1]]
        del words[-2:]
    elif not unit and len(words) > 1 and words[-1] in _UNITS:
        unit = _UNITS[words.pop()]
    axis = -1
    turn = _QUATERNION.fullmatch("_".join(words[-2:]) if len(words) > 1 else "".join(words))
    if turn is not None and not (words == ["q"] and not indexed):
        part = turn.group(1) or (indexed.group(1) if indexed else "")
        if part:
            return _Name(column, ("q",), "wxyz".index(part) if part in "wxyz" else int(part), unit, part.isdigit())
    if words in (["p"], ["q"], ["r"]) and not indexed:
        return _Name(column, ("pqr",), _AXES[words[0]], unit)
    if indexed:
        axis = int(indexed.group(1)) if int(indexed.group(1)) < 4 else -1
    elif words:
        last = words[-1]
        if last in _AXES or last in ("0", "1", "2"):
            axis = _AXES[last] if last in _AXES else int(last)
            words.pop()
        elif len(last) > 1 and last[-1] in "xyz" and last[:-1] in set().union(*_WORDS.values()) | {"g"}:
            axis = _AXES[last[-1]]
            words[-1] = {"g": "gyro"}.get(last[:-1], last[:-1])
    return _Name(column, tuple(words), axis, unit, indexed is not None)


def _known_unit(text: str) -> str:
    try:
        parsed(text)
    except InputError:
        return ""
    return text


def _kind(name: _Name) -> str:
    """What a column measures, by its words; "": not known."""
    said = set(name.words)
    if "angular" in said and "acceleration" in said:
        return ""
    for kind in ("increment", "gyro", "accelerometer", "quaternion", "velocity", "position"):
        if said & _WORDS[kind]:
            return kind
    return "" if name.words else "position"


class _Search:
    """Looks for a vehicle's sensors and jets in a recording."""

    def __init__(self, recording: Recording, vehicle: Vehicle):
        self.recording, self.vehicle = recording, vehicle
        self.data: dict[str, Any] = {"sensors": {}}
        self.reasons: list[str] = []
        self.lacking: list[str] = []
        self._here: tuple[str, dict[str, Any] | None] = "", None  # the topic that is looked at, and its time
        self._free = {"gyro": [one.name for one in vehicle.gyros]}
        self._free["accelerometer"] = [one.name for one in vehicle.accelerometers]
        self._free |= {
            "pose": [one.name for one in vehicle.poses],
            "velocity": [one.name for one in vehicle.velocities],
        }
        self._called = {kind: {one.lower() for one in self._free[kind]} for kind in ("gyro", "accelerometer")}

    def _say(self, reason: str) -> None:
        self.reasons.append(reason)

    def _kind(self, name: _Name) -> str:
        """What a column measures, by its words or as a package of the vehicle is called; "": not known."""
        called = "_".join(name.words)
        return next((kind for kind, names in self._called.items() if called in names), _kind(name))

    def _package(self, kind: str, words: Sequence[str] = ()) -> str:
        """A package of the vehicle that is not taken yet, one that is so called first; "": none is left."""
        free = self._free[kind]
        said = {*words, "_".join(words)}
        name = next((one for one in free if one.lower() in said), free[0] if free else "")
        if name:
            free.remove(name)
        return name

    def _tracker(self, kind: str, shown_as: str, what: str) -> str:
        """Where a sensor in a fixed frame goes: one of the vehicle's, or, if it needs none, a name to show it under.

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
        """Says which packages of the vehicle have no columns, and which columns of a table nothing is made of."""
        missing = [name for free in self._free.values() for name in free]
        if missing:
            self._say(f"no columns were found for {', '.join(missing)}: name them under `sensors` if they were logged")
        if "" in self.recording.topics:
            used = set(_texts(self.data))
            left = [name for name in self.recording.topics[""].columns if name not in used]
            if left:
                self._say(f"not used: {', '.join(left[:_LISTED])}{', ...' if len(left) > _LISTED else ''}")

    # ---------------------------------------------------------------------------------- tables

    def in_a_table(self) -> None:
        """Looks in tables and .mat files, by names and numbers; of several parts in the one with rates first."""
        form = self.recording.form.model_dump(exclude_defaults=True)
        if form:
            self.data["csv"] = form
            self._say(f"csv: {', '.join(f'{key} {value!r}' for key, value in form.items())}, as its first lines show")
        topics = self.recording.topics
        read = {
            name: [read_name(column) for column, values in topic.columns.items() if _has_numbers(values)]
            for name, topic in topics.items()
        }
        kinds = {name: {self._kind(one) for one in names if one.axis >= 0} - {""} for name, names in read.items()}
        ordered = sorted(topics, key=lambda name: ("gyro" not in kinds[name], -len(kinds[name])))
        for name in ordered:
            if kinds[name] or len(topics) == 1:
                self._enter(name, read[name])
                self._sensors(topics[name], read[name])
        for name in sorted(topics, key=lambda name: -len(self._jet_columns(topics[name]))):
            self._enter(name, read[name], quietly=True)
            if self._commands(topics[name]):
                self._put_in_its_topic(self.data["commands"])
                break
        if "time" not in self.data:
            self.lacking.insert(0, "no column of time was found: name it, `time: {column: ...}`")

    def _enter(self, name: str, names: Sequence[_Name], *, quietly: bool = False) -> None:
        """Goes on in a topic: the first one, and its time, are those of the map."""
        found = self._time(self.recording.topics[name], names)
        self._here = name, None if found is None else found[0]
        if "time" not in self.data and "topic" not in self.data:
            if name:
                self.data["topic"] = name
                self._say(f"topic {name}: it has rates, or most of the sensors")
            if found is not None:
                self.data["time"] = found[0]
                self._say(found[1])
        elif found is not None and not quietly and self._here[1] != self.data.get("time"):
            self._say(f"{name}: {found[1]}")

    def _put_in_its_topic(self, entry: dict[str, Any]) -> None:
        """Names topic and time of what does not lie where the map begins."""
        name, time = self._here
        if name != self.data.get("topic", ""):
            entry["topic"] = name
            if time is not None and time != self.data.get("time"):
                entry["time"] = time

    def _time(self, topic: Topic, names: Sequence[_Name]) -> tuple[dict[str, Any], str] | None:
        """A column of time, as a map has it, and why it is one."""
        for name in names:
            if not set(name.words) & _TIME_WORDS or name.axis >= 0:
                continue
            values = topic.numbers(name.column)
            steps = np.diff(values[np.isfinite(values)])
            if steps.size and (steps > 0.0).mean() > 0.99:
                break
        else:
            return None
        unit, step, period_s = name.unit, float(np.median(steps)), self.vehicle.sample_period_s
        why = "as its name says"
        if not unit or factor_or_none(unit, "time") is None:
            unit = min(("s", "ms", "us", "ns"), key=lambda one: abs(np.log(step * factor(one, "time") / period_s)))
            why = f"since its steps of {step:.6g} are nearest to the sample period of {period_s:g} s so"
        said = f"time: column {name.column}, which rises from row to row, in {unit} {why}"
        return {"column": name.column, "unit": unit}, said

    def _sensors(self, topic: Topic, names: Sequence[_Name]) -> None:
        groups: dict[tuple[tuple[str, ...], str], dict[int, _Name]] = {}
        angles: dict[int, _Name] = {}
        for name in names:
            turn = next((_ANGLE_WORDS[word] for word in name.words if word in _ANGLE_WORDS), -1)
            if turn >= 0 and not set(name.words) & _WORDS["gyro"]:
                angles.setdefault(turn, name)
            elif turn >= 0:
                groups.setdefault((("rate",), name.unit), {})[turn] = name
            elif name.axis >= 0 and self._kind(name):
                groups.setdefault((name.words, name.unit), {})[name.axis] = name
        found: dict[str, list[dict[int, _Name]]] = {}
        for members in groups.values():
            found.setdefault(self._kind(members[min(members)]), []).append(members)
        position = next(iter(found.get("position", [])), {})
        pairs = self._differences(topic, position, angles, found)
        for members in found.get("gyro", []):
            self._add_gyro(topic, members)
        for kind in ("accelerometer", "increment"):
            for members in found.get(kind, []):
                self._add_accelerometer(topic, members, kind == "increment")
        for members in found.get("velocity", []):
            unit = self._unit(members, "velocity", "m/s")
            package = self._tracker("velocity", "velocity", f"{_listed(members)}, velocities by their names")
            if package:
                self._add(package, {"kind": "velocity", "columns": _columns(members), "unit": unit})
                self._say(f"{package}: {_listed(members)}, by their names")
        quaternion = next((one for one in found.get("quaternion", []) if len(one) == 4), {})
        self._add_pose(position, angles, quaternion)
        if pairs:
            self._use_differences(topic, pairs)

    def _add(self, name: str, entry: dict[str, Any]) -> None:
        """Adds a sensor, the first of its name."""
        if name not in self.data["sensors"]:
            self._put_in_its_topic(entry)
            self.data["sensors"][name] = entry

    def _unit(self, members: Mapping[int, _Name], kind: str, otherwise: str) -> str:
        unit = members[min(members)].unit
        return unit if unit and factor_or_none(unit, kind) is not None else otherwise

    def _differences(
        self,
        topic: Topic,
        position: Mapping[int, _Name],
        angles: Mapping[int, _Name],
        found: dict[str, list[dict[int, _Name]]],
    ) -> list[tuple[dict[str, str], Array]]:
        """Pairs of a value and its backward difference; groups of such rates are no sensors, and are taken out."""
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

    def _add_gyro(self, topic: Topic, members: Mapping[int, _Name]) -> None:
        package = self._package("gyro", members[min(members)].words)
        if not package:
            self._say(f"{_listed(members)}: rates, but the vehicle has no further gyro")
            return
        unit, why = self._unit(members, "rate", ""), "by their names"
        if not unit:
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

    def _add_accelerometer(self, topic: Topic, members: Mapping[int, _Name], increments: bool) -> None:
        first = members[min(members)]
        package = self._package("accelerometer", first.words)
        if not package:
            self._say(f"{_listed(members)}: accelerations, but the vehicle has no further accelerometer")
            return
        if increments:
            gives, unit, why = (
                "increment",
                self._unit(members, "velocity", "m/s"),
                "increments of velocity by their names",
            )
        elif factor_or_none(first.unit, "velocity") is not None or "_".join(first.words) == package.lower():
            own = f"{self.vehicle.unit_names['length']}/s" if "_".join(first.words) == package.lower() else "m/s"
            gives, unit, why = "integral", self._unit(members, "velocity", own), "as the vehicle's own, integrating"
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
        entry = {"kind": "accelerometer", "columns": _columns(members), "unit": unit, "gives": gives}
        self._add(package, entry)
        self._say(f"{package}: {_listed(members)} in {unit}, {why}")

    def _add_pose(
        self, position: Mapping[int, _Name], angles: Mapping[int, _Name], quaternion: Mapping[int, _Name]
    ) -> None:
        entry: dict[str, Any] = {}
        if quaternion:
            entry = {"quaternion": [quaternion[one].column for one in range(4)], "order": "wxyz"}
            why = f"quaternion {_listed(quaternion)}"
            why += ", taken for scalar first, body to world" if quaternion[0].indexed else ", body to world"
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

    def _jet_columns(self, topic: Topic) -> dict[str, str]:
        """A column for each jet, by designation; empty where not all are found."""
        jets = self.vehicle.jets
        numeric = [column for column, values in topic.columns.items() if values.dtype != object]
        for without in (set[str](), _ON_WORDS | set(_UNITS)):
            plain = {_plain(column, without): column for column in numeric}
            for names in ([jet.designation for jet in jets], [str(jet.number) for jet in jets]):
                keys = [_plain(name) for name in names]
                if all(key in plain for key in keys):
                    return {jet.designation: plain[key] for jet, key in zip(jets, keys, strict=True)}
        stems: dict[str, dict[int, str]] = {}
        for column in topic.columns:
            match = re.fullmatch(r"(.*?)[\[_.]?(\d+)\]?", column)
            if match and set(read_name(match.group(1)).words) & _JET_WORDS:
                stems.setdefault(match.group(1), {})[int(match.group(2))] = column
        for numbered in stems.values():
            for first in (0, 1):
                if set(numbered) == set(range(first, first + len(jets))):
                    return {jet.designation: numbered[first + index] for index, jet in enumerate(jets)}
        return {}

    def _commands(self, topic: Topic) -> bool:
        """Looks for commands to the jets; whether there are."""
        columns = self._jet_columns(topic)
        if columns:
            self.data["commands"] = {"columns": columns}
            self._say(f"commands: a column for each of the {len(columns)} jets, by their names")
            self._scale(topic, columns)
            return True
        for column, values in topic.columns.items():
            if values.dtype == object:
                texts = {word.lower() for text in topic.texts(column) for word in mapping.words(text)}
                if texts and texts <= {jet.lower() for jet in self.vehicle.designations}:
                    self.data["commands"] = {"listed": {"column": column}}
                    self._say(f"commands: column {column} lists designations of jets, such as {sorted(texts)[0]}")
                    return True
        for column, values in topic.columns.items():
            if values.dtype == object or not set(read_name(column).words) & _MASK_WORDS:
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

    def _scale(self, topic: Topic, columns: Mapping[str, str]) -> None:
        """What the numbers of the jets' columns mean."""
        values = np.concatenate([topic.numbers(column) for column in columns.values()])
        values = values[np.isfinite(values)]
        if not values.size:
            return
        block, names = self.data["commands"], [read_name(column) for column in columns.values()]
        most, unit, said = float(values.max()), names[0].unit, set(names[0].words)
        if unit and factor_or_none(unit, "time") is not None:
            block["unit"] = unit
            self._say(f"commands: on-times in {unit}, as their names say; the sample period is open all the time")
        elif values.min() > 500.0 and most < 2500.0:
            block |= {"off": 1000.0, "on": 2000.0}
            self._say("commands: they lie between 500 and 2500, like pulse widths of 1000 to 2000 us: a guess")
        elif unit == "%" or (1.0 + 1e-9 < most <= 100.0 and values.min() >= 0.0):
            timed = said & _ON_WORDS and unit != "%"
            block |= {"unit": "ms"} if timed else {"on": 100.0}
            self._say(f"commands: they reach {most:g}: {'on-times in ms, a guess' if timed else 'percent'}")
        elif not np.isin(values, (0.0, 1.0)).all() and most < 1.05 * self.vehicle.sample_period_s and said & _ON_WORDS:
            block["unit"] = "s"
            self._say(f"commands: on-times in s, since they reach {most:g}, within the sample period")

    def look_at_the_jets(self) -> None:
        """Tells from what the gyro shows of the jets whether rows hold commands to come, and which unit it has."""
        if "commands" not in self.data or not self.data["sensors"]:
            return
        self.data["commands"].setdefault("acts", "from_row")
        gyro = next((name for name, one in self.data["sensors"].items() if one["kind"] == "gyro"), None)
        by = None if gyro is None else _understood(self.recording, self.data, self.vehicle)
        if gyro is None or by is None or self.recording.kind not in ("table", "mat"):
            self._say("commands.acts: from_row, since nothing here tells: a row's command acts from the row on")
        else:
            self._follow(by, gyro)
            self._tell_sums(by)

    def _tell_sums(self, by: mapping.Mapped) -> None:
        """Tells by the jets whether increments of velocity, as names have it, are sums of them."""
        held, vehicle = np.nan_to_num(by.commands.values), self.vehicle
        pushes = vehicle.wrenches[:, 3:] / vehicle.nominal.mass * vehicle.sample_period_s
        meant = (held[1:] if self.data["commands"]["acts"] == "until_row" else held[:-1]) @ pushes
        for name, entry in self.data["sensors"].items():
            if entry.get("gives") != "increment" or len(by.channels[name].values) != len(held):
                continue
            values = by.channels[name].values
            gained, summed = _correlation(meant, values[1:]), _correlation(meant, np.diff(values, axis=0))
            if summed > gained + _CLEARLY:
                entry["gives"] = "integral"
                self._say(
                    f"{name}: sums of increments, since their differences follow the commands with a correlation of "
                    f"{summed:.2f}, they themselves with {gained:.2f}"
                )

    def _follow(self, by: mapping.Mapped, gyro: str) -> None:
        """Compares what a gyro shows with what the jets should make it show."""
        rates, held = by.channels[gyro].values, by.commands.values
        vehicle = self.vehicle
        if len(held) != len(rates):
            return
        arms = vehicle.wrenches[:, :3] - np.cross(vehicle.nominal.center_of_mass, vehicle.wrenches[:, 3:])
        turning = arms @ np.linalg.inv(vehicle.nominal.inertia).T * vehicle.sample_period_s
        change = np.diff(rates, axis=0)
        told = [np.nan_to_num(held) @ turning for held in (held[:-1], held[1:])]
        alike = [_correlation(meant, change) for meant in told]
        if any(np.isnan(alike)):
            self._say("commands.acts: from_row, since too few jets fire to tell")
            return
        later = alike[1] > alike[0] + _CLEARLY
        self.data["commands"]["acts"] = "until_row" if later else "from_row"
        self._say(
            f"commands.acts: {self.data['commands']['acts']}, since the rates follow a row's command with a "
            f"correlation of {alike[0]:.2f} in the interval after the row and {alike[1]:.2f} in the one before"
        )
        meant = told[later]
        both = np.isfinite(change)
        slope = float((meant[both] * change[both]).sum() / (meant[both] ** 2).sum())
        wrong = "deg/s" if 57.3 / 2.5 < slope < 57.3 * 2.5 and self.data["sensors"][gyro]["unit"] == "rad/s" else ""
        if wrong:
            self.data["sensors"][gyro]["unit"] = wrong
            self._say(
                f"{gyro}: {wrong}, since as rad/s it would turn {slope:.3g} times as much as the jets can make it"
            )
        return

    # ------------------------------------------------------------------------------------- PX4

    def in_px4(self) -> None:
        """Takes the topics that PX4 logs, in its frame: forward, right, down."""
        topics = {_base(name): name for name in reversed(list(self.recording.topics))}
        self._px4_vector(topics, _PX4_GYRO, "gyro", {"unit": "rad/s"}, "rates in body axes, rad/s")
        done = self._px4_vector(
            topics,
            _PX4_INCREMENTS,
            "accelerometer",
            {"unit": "m/s", "gives": "increment"},
            "increments of velocity, which lose nothing between samples",
        )
        if not done:
            self._px4_vector(
                topics,
                _PX4_INSTANTS,
                "accelerometer",
                {"unit": "m/s^2", "gives": "instant"},
                "accelerations, filtered by IMU_ACCEL_CUTOFF; vehicle_imu with its delta_velocity would be better",
            )
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
                if column == "output":
                    block |= {"off": 1000.0, "on": 2000.0}
                self.data["commands"] = block
                self._say(
                    f"commands: {topics[base]}, {column}[0] the vehicle's first jet and so on; NaN is disarmed"
                    + ("; 1000 to 2000 taken for closed to open" if column == "output" else "")
                )
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
            ("accelerometer", "linear_acceleration", {"unit": "m/s^2", "gives": "instant"}),
        ):
            package = self._package(kind)
            if package:
                columns = [f"{field}.{axis}" for axis in ("x", "y", "z")]
                self.data["sensors"][package] = {"kind": kind, "topic": name, "columns": columns, **more}
                self._say(f"{package}: {name}, {field} of an Imu, in {more['unit']}")

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


def factor_or_none(unit: str, kind: str) -> float | None:
    """The SI value of one of a unit; None where it is of another kind, or none."""
    try:
        return factor(unit, kind)
    except InputError:
        return None


def _has_numbers(values: NDArray[Any]) -> bool:
    return bool(values.dtype.kind in "biuf" and np.isfinite(values).any())


def _base(topic: str) -> str:
    return topic.rpartition("/")[2] if topic.startswith("/") else topic.partition("/")[0]


def _texts(data: Any) -> Iterator[str]:
    """All texts in the data of a map, keys aside."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        yield from chain.from_iterable(map(_texts, data.values()))
    elif isinstance(data, list):
        yield from chain.from_iterable(map(_texts, data))


def _plain(name: str, without: Iterable[str] = ()) -> str:
    """A jet's name without the words around it, so that `cmd_T1` is T1."""
    around = _JET_WORDS | set(without)
    words = [word for word in re.split(r"[^a-z0-9%]+", name.lower()) if word and word not in around]
    return re.sub(r"(?<!\d)0+(?=\d)", "", "".join(words))


def _columns(members: Mapping[int, _Name]) -> list[str | None]:
    return [members[axis].column if axis in members else None for axis in range(3)]


def _every(readings: Array) -> int:
    """Rows for each reading, shape (n, m), where rows repeat one until there is another; else 1."""
    rows = mapping.changes(readings)
    return int(np.gcd.reduce(np.diff(rows))) if rows.size >= _FEWEST else 1


def _listed(members: Mapping[int, _Name]) -> str:
    return ", ".join(members[axis].column for axis in sorted(members))


def _steps(topic: Topic, value: tuple[str, str], rate: tuple[str, str]) -> Array | None:
    """The steps by which a rate would be the backward difference of a value; None where it is none."""
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


def _correlation(meant: Array, change: Array) -> float:
    """Correlation of changes with those meant, NaN with too few samples."""
    both = np.isfinite(change) & (np.abs(meant) > 1e-3 * np.abs(meant).max(initial=0.0))
    if both.sum() < _FEWEST:
        return float("nan")
    sizes = (meant[both] ** 2).sum() * (change[both] ** 2).sum()
    return float((meant[both] * change[both]).sum() / np.sqrt(sizes)) if sizes > 0.0 else float("nan")


def _understood(recording: Recording, data: Mapping[str, Any], vehicle: Vehicle) -> mapping.Mapped | None:
    """The record as the map has it so far; None where the map cannot be applied."""
    try:
        by = RecordMap.model_validate({**data, "commands": {**data["commands"], "acts": "from_row"}})
        return mapping.mapped(recording, by, vehicle)
    except ValueError:  # said when the map is shown
        return None
