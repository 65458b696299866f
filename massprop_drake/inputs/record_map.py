"""Maps of records: meaning of the columns of other programs' files, read from YAML and validated.

A map names, for every sensor of a vehicle and for its jets, the columns, their unit, axes and clock. It describes what
is in the file, also what no estimator uses yet; `massprop_drake.records.mapping` applies it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from massprop_drake.inputs.model import (
    Count,
    Flag,
    Key,
    Matrix3,
    Model,
    Name,
    Positive,
    Real,
    Text,
    Vector3,
    described,
    list_keys,
    validate_data,
)
from massprop_drake.inputs.units import is_unit_of, si_factor
from massprop_drake.inputs.yaml import Document, read_text

Column = Annotated[str, Field(strict=True, min_length=1, max_length=200)]


def _require_each_once(readers: Iterable[str], sources: Iterable[Any], noun: str) -> None:
    """Raises ValueError where two readers, such as jets, share a source, such as a column; None is no source."""
    reader_of: dict[Any, str] = {}
    for reader, source in zip(readers, sources, strict=True):
        if source is not None and reader_of.setdefault(source, reader) != reader:
            raise ValueError(f"{reader_of[source]} and {reader} both have {noun} {source!r}: name each its own")


def _require_columns_once(value: tuple[str | None, ...]) -> tuple[str | None, ...]:
    """Returns the columns of axes; raises ValueError where two have the same."""
    _require_each_once(("the first axis", "the second", "the third"), value, "column")
    return value


Three = Annotated[tuple[Column | None, Column | None, Column | None], AfterValidator(_require_columns_once)]


def _unit_validator(*kinds: str) -> AfterValidator:
    """Makes a validator that refuses a text that is no unit of one of some kinds of quantities."""

    def check(value: str) -> str:
        """Returns a unit; raises InputError where it is none of these kinds."""
        si_factor(value, *kinds)
        return value

    return AfterValidator(check)


TimeUnit = Annotated[Text, _unit_validator("time")]
AngleUnit = Annotated[Text, _unit_validator("angle")]
LengthUnit = Annotated[Text, _unit_validator("length")]
Signed = Literal["x", "y", "z", "-x", "-y", "-z"]


def _require_each_axis_once(value: tuple[Signed, Signed, Signed]) -> tuple[Signed, Signed, Signed]:
    """Returns three signed axes; raises ValueError unless x, y and z stand once each."""
    if len({axis[-1] for axis in value}) < 3:
        raise ValueError(f"must name each of x, y and z once, got [{', '.join(value)}]")
    return value


Axes = Annotated[tuple[Signed, Signed, Signed], AfterValidator(_require_each_axis_once)]

_COLUMNS = "columns of the recorder's x, y, z; null: not logged"
_AXES = "the recorder's axes that are the vehicle's x, y, z, such as [x, -y, -z] from forward-left-up"
_TOPIC = "topic of the log; `name/1` is the second instance in a ULog"
_NAMING = {
    "column",
    "columns",
    "date",
    "speed",
    "fraction",
    "value",
    "rate",
    "quaternion",
    "angles",
    "heading",
    "position",
}  # keys of columns
_LARGEST = 1e12  # number of any meaning, whatever its unit, as of telemetry
_FARTHEST_S = 1e10  # s, three hundred years, by which no clock is behind another
_ROTATION_TOLERANCE = 1e-3  # of the products of a rotation's columns, as printed matrices have them


class Difference(Model):
    """Column and its rate, logged as the backward difference over the true step."""

    value: Column = described(..., "column of the quantity; angles are unwrapped")
    value_unit: Annotated[Text, _unit_validator("length", "angle")] = described("m", "its unit")
    rate: Column = described(..., "column of its rate")
    rate_unit: Annotated[Text, _unit_validator("velocity", "rate")] = described("m/s", "its unit")

    @model_validator(mode="after")
    def _require_matching_units(self) -> Difference:
        """Raises ValueError unless both units are angular or both linear."""
        if is_unit_of(self.value_unit, "angle") != is_unit_of(self.rate_unit, "rate"):
            raise ValueError(f"rate_unit {self.rate_unit!r} is none of a rate of {self.value_unit!r}")
        return self


class RecordTime(Model):
    """The stamps of samples, and the clock that made them."""

    column: Column | None = described(
        None, "column of numbers or ISO 8601 stamps; null: the log's own stamps, of message headers first"
    )
    unit: TimeUnit = described("s", "unit of the column; stamps have none")
    date: Column | None = described(None, "column of dates, where `column` has the time of day alone")
    fraction: Column | None = described(None, "column that is added, such as nanoseconds")
    fraction_unit: TimeUnit = described("ns", "its unit")
    offset_s: Real = described(
        0.0,
        "added to every stamp: how far this clock is behind that of the rows at the first of them",
        "s",
        ge=-_FARTHEST_S,
        le=_FARTHEST_S,
    )
    drift: Real = described(0.0, "relative gain of this clock: intervals are divided by 1 + drift", gt=-0.5, lt=0.5)
    differences: tuple[Difference, ...] = described(
        (),
        "pairs that give the true steps, (value - value before) / rate, by least squares, where the "
        "logged time is nominal",
    )

    @model_validator(mode="after")
    def _require_time_column(self) -> RecordTime:
        """Raises ValueError for a fraction or date without a column."""
        if self.fraction is not None and self.column is None:
            raise ValueError("fraction: is added to a column; give column, too")
        if self.date is not None and self.column is None:
            raise ValueError("date: goes with a column of the time of day; give column, too")
        return self


def rotation_of(axes: Axes) -> np.ndarray:
    """Computes the rotation matrix from the recorder's axes to the wanted ones, named such as -y, shape (3, 3)."""
    matrix = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        matrix[row, "xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return matrix


class _Sampled(Model):
    """The fields common to everything that is sampled."""

    topic: Text = described("", f"{_TOPIC}; empty: the map's")
    time: RecordTime | None = described(None, "own clock, with the keys of `time`; null: the map's")


class _Read(_Sampled):
    """The fields common to sensors."""

    every: Annotated[Count, Field(ge=1)] = described(
        1, "rows per reading, where rows repeat a reading until the next: only the first row of each has it"
    )


class _Vector(_Sampled):
    """The fields common to vectors."""

    columns: Three = described(..., _COLUMNS)
    axes: Axes = described(("x", "y", "z"), _AXES)
    rotation: Matrix3 | None = described(None, "matrix from the recorder's to the vehicle's axes, instead of `axes`")
    zero: Vector3 = described((0.0, 0.0, 0.0), "reading at rest, subtracted")

    @model_validator(mode="after")
    def _require_columns_and_rotation(self) -> _Vector:
        """Raises ValueError without any column, for axes and a rotation, or for one that is not orthonormal."""
        if all(column is None for column in self.columns):
            raise ValueError("columns: none is named; leave the sensor out")
        if self.rotation is not None:
            if self.axes != ("x", "y", "z"):
                raise ValueError("give either axes or rotation, not both")
            matrix = np.array(self.rotation)
            turns = np.abs(matrix).max() <= 1.0 + _ROTATION_TOLERANCE
            if not turns or np.abs(matrix @ matrix.T - np.eye(3)).max() > _ROTATION_TOLERANCE:
                raise ValueError("rotation: its rows must be at right angles and of length 1")
        return self

    @property
    def matrix(self) -> np.ndarray:
        """Matrix from the recorder's axes to the vehicle's, shape (3, 3)."""
        return rotation_of(self.axes) if self.rotation is None else np.array(self.rotation)


class GyroMap(_Vector, _Read):
    """Angular rates in body axes."""

    kind: Literal["gyro"] = described(..., "angular rates")
    unit: Annotated[Text, _unit_validator("rate")] = described("rad/s", "such as deg/s or rpm")


class AccelerometerMap(_Vector, _Read):
    """Non-gravitational accelerations, or their integrals, in body axes."""

    kind: Literal["accelerometer"] = described(..., "non-gravitational accelerations or their integrals")
    unit: Annotated[Text, _unit_validator("velocity", "acceleration")] = described(
        ..., "unit of velocity for `integral` and `increment`, else of acceleration"
    )
    gives: Literal["integral", "increment", "mean", "instant"] = described(
        ...,
        "integral: from the beginning; increment: over the sample that ended; mean: acceleration over it;"
        " instant: acceleration at the stamp, at least four a row",
    )

    @model_validator(mode="after")
    def _require_unit_of_gives(self) -> AccelerometerMap:
        """Raises ValueError where unit or `every` do not go with `gives`."""
        kind = "velocity" if self.gives in ("integral", "increment") else "acceleration"
        if not is_unit_of(self.unit, kind):
            raise ValueError(f"unit {self.unit!r} does not fit gives: {self.gives}, which is of {kind}")
        if self.every > 1 and self.gives != "integral":
            raise ValueError(f"every goes with gives: integral; of gives: {self.gives} no row may be left out")
        return self


class VelocityMap(_Vector, _Read):
    """Velocities."""

    kind: Literal["velocity"] = described(..., "velocities; read, not estimated from")
    unit: Annotated[Text, _unit_validator("velocity")] = described("m/s", "such as mm/s")
    frame: Literal["world", "body"] = described("world", "whose axes these are")


class _Attitude(_Read):
    """The fields common to attitudes, of which one form is given."""

    quaternion: tuple[Column, Column, Column, Column] | None = described(None, "columns, in the order of `order`")
    order: Literal["wxyz", "xyzw"] | None = described(None, "scalar first or last; required with a quaternion")
    angles: Three | None = described(None, "columns of roll, pitch and yaw, turned about z, y, x in turn")
    heading: Column | None = described(None, "column of the turn about z alone, of a planar vehicle")
    angle_unit: AngleUnit = described("rad", "of angles and heading")
    rotates: Literal["body_to_world", "world_to_body"] = described(
        "body_to_world", "what the attitude turns vectors from and to"
    )
    axes: Axes = described(("x", "y", "z"), "body axes, likewise")
    world_axes: Axes = described(("x", "y", "z"), "world axes, likewise, such as [y, x, -z] from east-north-up")

    @property
    def forms(self) -> list[str]:
        """Forms in which the attitude is given."""
        return [name for name in ("quaternion", "angles", "heading") if getattr(self, name) is not None]

    @model_validator(mode="after")
    def _require_one_form(self) -> _Attitude:
        """Raises ValueError for an attitude in two forms, left-handed axes, or a quaternion without its order."""
        if len(self.forms) > 1:
            raise ValueError(f"give one of {' and '.join(self.forms)}")
        for name in ("axes", "world_axes"):
            axes = getattr(self, name)
            if np.linalg.det(rotation_of(axes)) < 0.0:
                raise ValueError(f"{name}: [{', '.join(axes)}] is left-handed, and an attitude turns right-handed axes")
        if (self.quaternion is None) != (self.order is None):
            raise ValueError("quaternion and order belong together; order: wxyz or xyzw")
        return self


class AttitudeMap(_Attitude):
    """An attitude, as of a star tracker."""

    kind: Literal["attitude"] = described(..., "attitude; read, not estimated from")

    @model_validator(mode="after")
    def _require_attitude(self) -> AttitudeMap:
        """Raises ValueError where no form of attitude is given."""
        if not self.forms:
            raise ValueError("give quaternion, angles or heading")
        return self


class PoseMap(_Attitude):
    """A position and an attitude, as of motion capture."""

    kind: Literal["pose"] = described(..., "position and attitude; read, not estimated from")
    position: Three = described(..., "columns of world x, y, z; null: not logged")
    unit: LengthUnit = described("m", "of the position, such as mm")


class WheelMap(_Read):
    """The speed of a reaction wheel relative to the vehicle."""

    kind: Literal["wheel"] = described(..., "speed of a reaction wheel")
    speed: Column = described(..., "column of the speed")
    unit: Annotated[Text, _unit_validator("rate")] = described("rad/s", "such as rpm")


class EngineMap(_Read):
    """The level of an engine and the angles of its gimbal."""

    kind: Literal["engine"] = described(..., "level and gimbal angles of an engine")
    level: Column = described(..., "column of the level")
    full: Positive = described(1.0, "number at full thrust, such as 100")
    gimbal: tuple[Column, Column] | None = described(None, "columns of its two angles; null: fixed")
    unit: Annotated[Text, _unit_validator("angle")] = described("rad", "of the angles, such as deg")


SensorMap = Annotated[
    GyroMap | AccelerometerMap | VelocityMap | AttitudeMap | PoseMap | WheelMap | EngineMap, Field(discriminator="kind")
]


class ForceMap(_Vector):
    """A known outside force, or torque about the vehicle origin, over the interval that starts."""

    unit: Annotated[Text, _unit_validator("force", "torque")] = described(..., "such as N, or N*m for a torque")


class Mask(Model):
    """Jets as bits of a whole number."""

    column: Column = described(..., "column of the number")
    bits: dict[Name, Annotated[Count, Field(le=63)]] = described(..., "bit of each jet by designation, from 0")


class Listed(Model):
    """Jets that fire, as a text of their names."""

    column: Column = described(..., "column of the text, names separated by other than letters, digits and underscores")
    names: dict[Name, Text] = described({}, "name in the text by designation, where they differ")


class CommandMap(_Sampled):
    """Commands to the jets."""

    columns: dict[Name, Column] | None = described(None, "column of each jet by its designation")
    mask: Mask | None = described(None, "a bit mask")
    listed: Listed | None = described(None, "a list of the jets that fire")
    unit: Annotated[Text, _unit_validator("number", "time")] = described(
        "1", "1: number between `off` and `on`; a unit of time: how long the jet is on"
    )
    off: Real = described(
        0.0, "value of closed; beyond one that is not 0, a jet is closed too", ge=-_LARGEST, le=_LARGEST
    )
    on: Real | None = described(
        None, "value of open all the time; null: 1, or the sample period for on-times", ge=-_LARGEST, le=_LARGEST
    )
    threshold: Real | None = described(
        None, "share from `off` to `on` from which a jet is open, below closed; null: shares are kept", gt=0.0, le=1.0
    )
    acts: Literal["from_row", "until_row"] = described(
        "from_row", "until_row: a row's command was in force since the row before"
    )
    at: Literal["start", "center", "end"] | None = described(None, "place of on-times in a sample; null: the vehicle's")
    missing: Literal["unknown", "off"] = described("unknown", "meaning of an empty value or NaN")
    on_change: Flag = described(False, "whether only changes of commands are logged")

    @model_validator(mode="after")
    def _require_one_form(self) -> CommandMap:
        """Raises ValueError unless one form is given, with a column, bit or name for each jet, and on is not off."""
        forms = [name for name in ("columns", "mask", "listed") if getattr(self, name) is not None]
        if len(forms) != 1:
            raise ValueError(f"give one of columns, mask and listed, got {' and '.join(forms) or 'none'}")
        for jets, noun in (
            (self.columns, "column"),
            (self.mask and self.mask.bits, "bit"),
            (self.listed and self.listed.names, "name"),
        ):
            _require_each_once((f"jet {jet}" for jet in jets or ()), (jets or {}).values(), noun)
        if self.on == self.off:
            raise ValueError(f"on and off must differ, got {self.off:g}")
        if self.at is not None and not self.is_timed:
            raise ValueError("at goes with on-times, `unit: ms` or another of time")
        return self

    @property
    def is_timed(self) -> bool:
        """True if commands are on-times."""
        return self.columns is not None and self.threshold is None and is_unit_of(self.unit, "time")

    @property
    def jets(self) -> list[str] | None:
        """Designations of the jets that the map names; None: those of the vehicle."""
        if self.columns is not None:
            return list(self.columns)
        if self.mask is not None:
            return list(self.mask.bits)
        return list(self.listed.names) if self.listed is not None and self.listed.names else None


def _column_names(data: Any, parent_key: str = "") -> Iterator[str]:
    """Yields the column names in the data, mappings and lists, of a block of a map."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key == "columns" and isinstance(value, dict):
                yield from value.values()
            else:
                yield from _column_names(value, key)
    elif isinstance(data, (list, tuple)):
        for value in data:
            yield from _column_names(value, parent_key)
    elif isinstance(data, str) and parent_key in _NAMING:
        yield data


class CsvForm(Model):
    """Format of a text file."""

    separator: Annotated[str, Field(strict=True, min_length=1, max_length=1)] = described(
        ",", "separator of cells; a blank: any run of blanks"
    )
    decimal: Literal[".", ","] = described(".", "decimal mark")
    skip: Count = described(0, "lines above that of the names")
    below: Count = described(0, "lines between the names and the first row")
    comment: Text = described("", "beginning of lines to leave out; the first has the names where no other line has")


class RecordMap(Model):
    """A map from the columns of a record to a vehicle's sensors and jets."""

    description: Text = described("", "one line")
    topic: Text = described("", f"{_TOPIC}, where a part names none")
    time: RecordTime = described(RecordTime(), "stamps of the rows")
    rows: Name | None = described(
        None, "sensor whose samples are the rows; null: the first gyro, else the first sensor"
    )
    sensors: dict[Name, SensorMap] = described(..., "sensors by the vehicle's names", min_length=1)
    commands: CommandMap = described(..., "commands to the jets")
    known_force: ForceMap | None = described(None, "known outside force, body axes")
    known_torque: ForceMap | None = described(None, "its torque about the vehicle origin")
    csv: CsvForm = described(CsvForm(), "layout of a text file")
    cut_off: Literal["refuse", "accept"] = described(
        "accept", "treatment of a damaged record; accept: read as far as it is valid"
    )

    @model_validator(mode="after")
    def _require_known_rows_and_units(self) -> RecordMap:
        """Raises ValueError where rows names no sensor, or a known force or torque has another unit."""
        if self.rows is not None and self.rows not in self.sensors:
            raise ValueError(f"rows: {self.rows!r} is not one of sensors ({', '.join(self.sensors)})")
        for name, kind in (("known_force", "force"), ("known_torque", "torque")):
            part = getattr(self, name)
            if part is not None and not is_unit_of(part.unit, kind):
                raise ValueError(f"{name}: unit {part.unit!r} is none of a {kind}")
        return self

    @property
    def row_sensor(self) -> str:
        """The sensor whose samples are the rows."""
        gyros = [name for name, sensor in self.sensors.items() if sensor.kind == "gyro"]
        return self.rows or [*gyros, *self.sensors][0]

    def topic_of(self, map_entry: _Sampled) -> str:
        """Returns the log topic of a sensor or of the commands: its own, else the map's."""
        return map_entry.topic or self.topic

    @property
    def parts(self) -> list[_Sampled]:
        """All blocks that are read: sensors, commands, known force and torque."""
        parts = [*self.sensors.values(), self.commands, self.known_force, self.known_torque]
        return [part for part in parts if part is not None]

    @property
    def topics(self) -> set[str]:
        """All topics that are read."""
        return {self.topic_of(part) for part in self.parts}

    @property
    def columns(self) -> set[str]:
        """All columns that are read, of whatever topic."""
        return {name for part in [self.time, *self.parts] for name in _column_names(part.model_dump())}


def map_keys() -> list[Key]:
    """Lists the keys of a map for documentation, without those of own clocks, which are those of `time`."""
    return [key for key in list_keys(RecordMap) if ".time." not in key.name]


def load_map(path: str | Path) -> RecordMap:
    """Reads a map of a record's columns from a YAML file and validates it.

    Raises:
        InputError: when there is no such file, or it is wrong; the message says where.
    """
    document = Document(read_text(Path(path)), str(path))
    return validate_data(RecordMap, document.data, document)
