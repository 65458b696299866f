"""Names of columns: the quantity, axis and unit that they state, and which of them are the jets'."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from massprop_drake.errors import InputError
from massprop_drake.inputs.units import si_factor
from massprop_drake.records.text_files import unit_in

_PREFIXES = ("", "m", "u", "µ")  # of SI
_ANGLES = tuple(f"{prefix}{angle}" for prefix in _PREFIXES for angle in ("rad", "deg"))
_LENGTHS = ("m", "mm", "cm", "um")
# units as the last word of a name has them, besides those that `inputs.units` knows
_UNITS = {
    **dict.fromkeys(("millis",), "ms"),
    **dict.fromkeys(("msec", "msecs"), "ms"),
    **dict.fromkeys(("micros",), "us"),
    **dict.fromkeys(("nanos", "nanosec", "nanosecs"), "ns"),
    **{name: name for name in ("rpm", "ft", *_ANGLES, *_LENGTHS)},
    **{f"{prefix}{name}": f"{prefix}{name}" for prefix in _PREFIXES for name in ("dps", "g")},
    **{name: name for name in ("s", "sec", "secs", "second", "seconds", "ms", "us", "usec", "usecs", "ns", "nsec")},
    **{name: name for name in ("nsecs", "milliseconds", "microseconds", "nanoseconds", "minutes", "hours", "days")},
    **{f"{angle}{time}": f"{angle}/s" for angle in _ANGLES for time in ("ps", "s", "pers", "sec")},
    **{f"{length}{time}": f"{length}/s" for length in _LENGTHS for time in ("ps", "pers")},
    **{f"{length}{time}": f"{length}/s^2" for length in _LENGTHS for time in ("ps2", "pss", "pers2")},
    **dict.fromkeys(("pct", "percent"), "%"),
    "fps": "ft/s",
    "fps2": "ft/s^2",
}
_QUOTIENTS = {  # two words of a name that are a unit
    (length, time): f"{length}/{'s^2' if time in ('s2', 'ss', 'sec2') else 's'}"
    for length in (*_LENGTHS, "ft", *_ANGLES)
    for time in ("s", "s2", "ss", "sec", "sec2")
}
_ALONE = {name for name, unit in _UNITS.items() if len(name) > 1 and unit in ("s", "ms", "us", "ns")} | {
    name for name in _UNITS if name.endswith(("sec", "secs", "second", "seconds"))
}  # that are a name by themselves, of a column of time

WORDS: Mapping[str, frozenset[str]] = {
    "increment": frozenset({"dv", "deltav", "delv", "dvel"}),
    "gyro": frozenset(
        {"gyro", "gyr", "gyroscope", "omega", "w", "rate", "rates", "angvel", "ang", "angular", "pqr", "imugyro"}
    ),
    "accelerometer": frozenset({"acc", "accel", "a", "acceleration", "accelerometer", "accelerations", "sf"}),
    "quaternion": frozenset({"q", "quat", "quaternion", "orientation", "attitude", "att", "rotation"}),
    "velocity": frozenset({"v", "vel", "velocity", "speed", "linear"}),
    "position": frozenset({"p", "pos", "position", "r", "xyz", "translation"}),
}
WHEELS = frozenset({"wheel", "wheels", "rw", "rwa", "reactionwheel"})
_OF_JETS = frozenset(  # words of jets and of nothing else, so that what they name is hardly a sensor's reading
    {"jet", "jets", "thr", "thrs", "thruster", "thrusters", "thrust", "valve", "valves", "nozzle", "nozzles", "rcs"}
    | {"actuator", "actuators", "servo", "pwm", "duty", "fire", "firing", "solenoid", "sol"}
)
# beside `WORDS`: no reading of the vehicle's own motion
_NO_READINGS = frozenset(
    {"covariance", "cov", "std", "sigma", "variance", "bias", "error", "err", "innovation", "residual", "noise"}
    | {"cmd", "command", "commanded", "ref", "reference", "des", "desired", "target", "setpoint", "sp", "goal"}
    | WHEELS
    | _OF_JETS
    | {"motor", "rotor", "mag", "magnetometer", "sun", "torque", "force", "momentum"}
    | {"temp", "temperature", "clipping", "flag", "status", "valid", "limit"}
)
_TURNING = {"roll": 0, "pitch": 1, "yaw": 2, "heading": 2, "psi": 2, "hdg": 2}
_TIME = frozenset(
    {"time", "times", "t", "timestamp", "timestamps", "stamp", "clock", "tstamp", "ts", "utc", "epoch", "met", "tow"}
    | {"elapsed", "datetime", "date", "gregorian", "julian", "sclk", "tick", "ticks", "tai", "gps", "secs", "unix"}
)
_FRACTIONS = frozenset({"fraction", "frac", "subsec", "subsecs", "subseconds", "fine", "nanos", "micros", "millis"})
_JETS = _OF_JETS | {
    *("cmd", "cmds", "command", "commands", "u", "motor", "motors", "control", "controls", "output", "outputs", "data")
}
_ON = frozenset({"on", "ton", "duration", "width", "pulse", "ontime", "time", "open", "cmd", "out", "state"})
_MASKS = _JETS | {"mask", "bits", "bitmask", "on", "bitfield", "word"}
_NO_COMMANDS = frozenset(
    {"temp", "temperature", "pressure", "press", "status", "flag", "valid", "count", "counter", "cnt", "health"}
    | {"current", "voltage", "volt", "feedback", "meas", "measured", "force", "torque", "flow", "covariance", "total"}
)
_DIMENSIONS: Mapping[str, tuple[str, ...]] = {  # that a unit may have, by the quantity
    "increment": ("velocity", "acceleration"),
    "gyro": ("rate",),
    "accelerometer": ("velocity", "acceleration"),
    "velocity": ("velocity",),
    "position": ("length",),
}
_MEASURED = ("time", "angle", "rate", "length", "velocity", "acceleration", "force", "torque", "number")
_AXES = {**{axis: index for index, axis in enumerate("xyz")}, "p": 0, "q": 1, "r": 2}
_QUATERNION = re.compile(r"(?:.*_)?(?:q|quat|quaternion|orientation)_?([wxyzs0-4]?)")


class ColumnName(NamedTuple):
    """Words of the name of a column.

    Attributes:
        column: the name.
        words: of it, without unit and axis.
        axis: 0 to 2, 3 of a quaternion's fourth; as it is written where `indexed`; -1: none.
        unit: as `inputs.units` has it; "": it says none.
        indexed: whether the axis is a number.
    """

    column: str
    words: tuple[str, ...]
    axis: int
    unit: str
    indexed: bool = False

    @property
    def turn_axis(self) -> int:
        """Axis, 0 to 2, about which the roll, pitch or yaw in the name turns; -1: the name has none."""
        return next((_TURNING[word] for word in self.words if word in _TURNING), -1)

    @property
    def is_timed(self) -> bool:
        """True if the words of the name are of a clock, or it is a unit alone."""
        return self.axis < 0 and (not self.words or bool(set(self.words) & _TIME)) and not set(self.words) & _JETS

    @property
    def is_fraction(self) -> bool:
        """True if the words of the name are of a fraction of a second, logged beside whole seconds."""
        return bool(set(self.words) & _FRACTIONS)

    @property
    def may_be_mask(self) -> bool:
        """True if the words of the name may be of a bit mask of commands to jets."""
        return bool(set(self.words) & _MASKS)

    @property
    def is_on_time(self) -> bool:
        """True if the words of the name are of the duration for which a jet is open."""
        return bool(set(self.words) & (_ON - {"cmd", "out", "state"}))


def read_name(column: str, unit: str = "") -> ColumnName:
    """Splits a column's name, such as `gyro_x_dps`, `wx [deg/s]` or `q[0]`, into its words, axis and unit.

    Args:
        column: the name.
        unit: that is known from elsewhere, such as a line below the names; "": none.
    """
    rest = column
    bracket = re.search(r"\s*[\[(]([^\])]*)[\])]\s*$", rest)
    if bracket and not bracket.group(1).isdigit():
        unit, rest = unit_in(bracket.group(1)) or unit, rest[: bracket.start()]
    indexed = re.search(r"\[(\d+)\]", rest)
    words = _split_words(re.sub(r"\[\d+\]", "", rest))
    if not unit:
        unit = _take_unit(words)
    axis = -1
    turn = _QUATERNION.fullmatch("_".join(words[-2:]) if len(words) > 1 else "".join(words))
    if turn is not None and not (words == ["q"] and not indexed) and not set(words) & _NO_READINGS:
        part = turn.group(1) or (indexed.group(1) if indexed else "")
        if part in ("w", "x", "y", "z", "s"):
            return ColumnName(column, ("q",), "wxyz".index(part.replace("s", "w")), unit)
        if part.isdigit():
            return ColumnName(column, ("q",), int(part), unit, True)
    if words in (["p"], ["q"], ["r"]) and not indexed:
        return ColumnName(column, ("pqr",), _AXES[words[0]], unit)
    if indexed:
        axis = int(indexed.group(1)) if int(indexed.group(1)) < 4 else -1
    elif words:
        last = words[-1]
        if last in _AXES or last in ("0", "1", "2", "3"):
            axis = _AXES[last] if last in _AXES else int(last)
            words.pop()
            return ColumnName(column, tuple(words), axis, unit, last.isdigit())
        known = set().union(*WORDS.values()) | {"g"}
        if len(last) > 1 and last[-1] in "xyz0123" and last[:-1] in known:
            axis = _AXES[last[-1]] if last[-1] in _AXES else int(last[-1])
            words[-1] = {"g": "gyro"}.get(last[:-1], last[:-1])
            return ColumnName(column, tuple(words), axis, unit, last[-1].isdigit())
    return ColumnName(column, tuple(words), axis, unit, indexed is not None)


def _split_words(text: str) -> list[str]:
    """Splits a name into lowercase words at punctuation and capitals; roll, pitch or yaw speed becomes rate."""
    text = re.sub(r"([a-z])([A-Z])", r"\1_\2", text)
    text = re.sub(r"([A-Z]{2,})([A-Z][a-z]{2,})", r"\1_\2", text)
    text = re.sub(r"(?i)(roll|pitch|yaw)_?(speed|rate)", r"\1_rate", text)
    return [word for word in re.split(r"[^A-Za-z0-9µ°%]+", text.lower()) if word]


def _take_unit(words: list[str]) -> str:
    """Removes the unit at the end of a name from the list of its words and returns it; "": none."""
    if len(words) > 3 and words[-2] == "per" and (words[-3], words[-1]) in _QUOTIENTS:
        unit = _QUOTIENTS[words[-3], words[-1]]
        del words[-3:]
    elif len(words) > 2 and (words[-2], words[-1]) in _QUOTIENTS:
        unit = _QUOTIENTS[words[-2], words[-1]]
        del words[-2:]
    elif (len(words) > 1 and words[-1] in _UNITS) or (len(words) == 1 and words[0] in _ALONE):
        unit = _UNITS[words.pop()]
    else:
        return ""
    return unit


def column_quantity(name: ColumnName) -> str:
    """Returns the quantity that a column measures by its words and unit, a key of `WORDS`; "": not known."""
    kind = _quantity_of_words(name)
    dimension = next((one for one in _MEASURED if name.unit and si_factor_or_none(name.unit, one) is not None), "")
    return "" if dimension and dimension not in _DIMENSIONS.get(kind, (dimension,)) else kind


def _quantity_of_words(name: ColumnName) -> str:
    """Returns the quantity that the words of a column's name are of, a key of `WORDS`; "": not known."""
    words_ = set(name.words)
    if words_ & _NO_READINGS or ("angular" in words_ and words_ & WORDS["accelerometer"]) or "angle" in words_:
        return ""
    if "delta" in words_ and words_ & WORDS["velocity"]:
        return "increment"
    for kind, words in WORDS.items():
        if words_ & words:
            return kind
    return "" if name.words else "position"


def si_factor_or_none(unit: str, kind: str) -> float | None:
    """Returns the factor from a unit to SI; None if it is no unit of this kind of quantity."""
    try:
        return si_factor(unit, kind)
    except InputError:
        return None


# ------------------------------------------------------------------------------------------- jets


class JetColumns(NamedTuple):
    """Columns of one kind for the jets.

    Attributes:
        columns: by designation, of those that were found.
        lacking: designations of the others.
        beside: columns of the same kind that are no jet's.
        named: whether the words around are of jets, or these are called by their designations.
    """

    columns: dict[str, str]
    lacking: list[str]
    beside: list[str]
    named: bool


def jet_families(columns: Iterable[str], jets: Sequence[tuple[str, int]]) -> list[JetColumns]:
    """Lists groups of columns that differ only in the jet they name, the likelier to be commands first.

    Jets are named by their designation, `cmd_XP1`, or counted, `THR01_ON_MS`, `control[0]`: by the vehicle's numbers,
    or in its order from 0 or 1.

    Args:
        columns: names.
        jets: designation and number of each.
    """
    split = {column: _split_tokens(column) for column in columns}
    known = {_split_tokens(designation): designation for designation, _ in jets}
    families: dict[tuple[str, ...], dict[str, str]] = {}
    counted: dict[tuple[str, ...], dict[int, str]] = {}
    for column, tokens in split.items():
        for (begin, end), designation in _find_designations(tokens, known):
            families.setdefault((*tokens[:begin], "", *tokens[end:]), {}).setdefault(designation, column)
        for at, token in enumerate(tokens):
            if token.isdigit():
                family = (*tokens[:at], "", *tokens[at + 1 :])
                counted.setdefault(family, {}).setdefault(int(token), column)
    ranked = [
        (_rank_words(rest, named=True), _make_family(found, jets, [], named=True)) for rest, found in families.items()
    ]
    for rest, numbered in counted.items():
        if len(numbered) < 2 or len(jets) < 2:
            continue
        first = 0 if 0 in numbered else 1
        numbers = dict(jets)
        if not set(numbers.values()) <= set(numbered):
            numbers = {designation: first + index for index, (designation, _) in enumerate(jets)}
        elif first == 0:  # counted from 0: the vehicle's numbers, from 1, would be one off
            numbers = {designation: index for index, (designation, _) in enumerate(jets)}
        by_jet = {designation: numbered[number] for designation, number in numbers.items() if number in numbered}
        extra = [column for number, column in sorted(numbered.items()) if number not in numbers.values()]
        ranked.append(
            (_rank_words(rest, named=False), _make_family(by_jet, jets, extra, named=bool(set(rest) & (_JETS | _ON))))
        )
    ordered = sorted(ranked, key=lambda one: (len(one[1].lacking) > 0, one[0], len(one[1].lacking)))
    return [family for rank, family in ordered if rank < 3]


def _make_family(
    by_jet: Mapping[str, str], jets: Sequence[tuple[str, int]], extra: list[str], *, named: bool
) -> JetColumns:
    """Makes the group of columns of the jets, in the vehicle's order, with the jets that lack one."""
    columns = {designation: by_jet[designation] for designation, _ in jets if designation in by_jet}
    lacking = [designation for designation, _ in jets if designation not in by_jet]
    return JetColumns(columns, lacking, extra, named)


def _rank_words(parts: tuple[str, ...], *, named: bool) -> int:
    """Ranks a column name, with a designation if `named`, by its words: 0 (likely a command) to 2; 3: no command."""
    words = {word for word in parts if word}
    if words & _NO_COMMANDS:
        return 3
    if words & (_JETS | _ON):
        return 0
    if named:
        return 1 if words <= set(_UNITS) else 2
    return 2 if len(words) == 1 else 3


def _split_tokens(name: str) -> tuple[str, ...]:
    """Splits a name into lowercase words and numbers without leading zeros: `THR01_ON` is thr, 1, on."""
    text = re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()
    return tuple(one.lstrip("0") or "0" if one.isdigit() else one for one in re.findall(r"[a-zµ°%]+|\d+", text))


def _find_designations(
    tokens: tuple[str, ...], known: Mapping[tuple[str, ...], str]
) -> list[tuple[tuple[int, int], str]]:
    """Finds jet designations in a name's tokens, the longest ones alone; lists (begin, end) and designation."""
    for length in sorted({len(one) for one in known}, reverse=True):
        spans = [(begin, begin + length) for begin in range(len(tokens) - length + 1)]
        found = [((begin, end), known[tokens[begin:end]]) for begin, end in spans if tokens[begin:end] in known]
        if found:
            return found
    return []
