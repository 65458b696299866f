"""Units as recorders write them: deg/s, rpm, g, ms, mm/s^2."""

from __future__ import annotations

import difflib
import math
import re
from typing import NamedTuple

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.plausible import FOOT, GRAVITY, SLUG

Dimension = tuple[int, int, int, int]  # powers of length, mass, time, angle


class Unit(NamedTuple):
    """Unit of measurement.

    Attributes:
        factor: SI value of one.
        dimension: powers of length, mass, time and angle.
    """

    factor: float
    dimension: Dimension


_LENGTH, _MASS, _TIME, _ANGLE = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)
_RATE, _FORCE, _ACCELERATION, _NONE = (0, 0, -1, 1), (1, 1, -2, 0), (1, 0, -2, 0), (0, 0, 0, 0)
_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0

_SMALL = {"m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9}  # SI prefixes
_WRITTEN_OUT = {"milli": 1e-3, "micro": 1e-6, "nano": 1e-9}
_NO_SUCH = {"k", "M", "c", "d", "h", "kilo", "mega", "centi"}  # that not every unit takes


def _prefixed(prefixes: dict[str, float], names: tuple[str, ...], unit: Unit) -> dict[str, Unit]:
    """Maps each name of a unit, without and with SI prefixes, to its SI factor and dimension."""
    return {
        f"{prefix}{name}": Unit(factor * unit.factor, unit.dimension)
        for name in names
        for prefix, factor in {"": 1.0, **prefixes}.items()
    }


_UNITS = {
    **{name: Unit(1.0, _NONE) for name in ("1", "fraction")},
    **{name: Unit(0.01, _NONE) for name in ("%", "percent")},
    **_prefixed(_SMALL, ("s", "sec", "secs"), Unit(1.0, _TIME)),
    **_prefixed(_WRITTEN_OUT, ("second", "seconds"), Unit(1.0, _TIME)),
    **{name: Unit(60.0, _TIME) for name in ("min", "minutes")},
    **{name: Unit(3600.0, _TIME) for name in ("h", "hours")},
    **{name: Unit(86400.0, _TIME) for name in ("d", "day", "days")},
    **_prefixed(_SMALL, ("rad",), Unit(1.0, _ANGLE)),
    **_prefixed(_WRITTEN_OUT, ("radian", "radians"), Unit(1.0, _ANGLE)),
    **_prefixed(_SMALL, ("deg",), Unit(_DEGREE, _ANGLE)),
    **_prefixed(_WRITTEN_OUT, ("degree", "degrees"), Unit(_DEGREE, _ANGLE)),
    "°": Unit(_DEGREE, _ANGLE),
    "arcsec": Unit(_DEGREE / 3600.0, _ANGLE),
    **{name: Unit(_TURN, _ANGLE) for name in ("rev", "turn")},
    "rpm": Unit(_TURN / 60.0, _RATE),
    **_prefixed(_SMALL, ("dps",), Unit(_DEGREE, _RATE)),
    **{name: Unit(1.0, _LENGTH) for name in ("meter", "meters")},
    **_prefixed({"k": 1e3, "d": 0.1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6}, ("m",), Unit(1.0, _LENGTH)),
    "ft": Unit(FOOT, _LENGTH),
    "in": Unit(FOOT / 12.0, _LENGTH),
    **_prefixed(_SMALL, ("g",), Unit(GRAVITY, _ACCELERATION)),
    "kg": Unit(1.0, _MASS),
    "slug": Unit(SLUG, _MASS),
    **_prefixed({"k": 1e3, **_SMALL}, ("N",), Unit(1.0, _FORCE)),
    "lbf": Unit(SLUG * FOOT, _FORCE),
}
_KINDS = {
    "time": (_TIME, "s or ms"),
    "angle": (_ANGLE, "rad or deg"),
    "rate": (_RATE, "rad/s, deg/s or rpm"),
    "length": (_LENGTH, "m or mm"),
    "velocity": ((1, 0, -1, 0), "m/s or mm/s"),
    "acceleration": (_ACCELERATION, "m/s^2 or g"),
    "force": (_FORCE, "N or lbf"),
    "torque": ((2, 1, -2, 0), "N*m or lbf*ft"),
    "number": (_NONE, "1 or %"),
}
_PART = re.compile(r"([*/·]?)([^\s\d*/·^²³-]+|1)(?:\^?(-?\d)|([²³]))?")


def parse_unit(text: str, expected: str = "") -> Unit:
    """Parses a unit such as `deg/s`, `m/s^2`, `m/s2` or `N*m` to its SI factor and dimension.

    Args:
        expected: end of the message where nothing known is similar.

    Raises:
        InputError: when a name is not known.
    """
    plain = re.sub(r"\s*([*/·])\s*", r"\1", text.strip().replace("\u03bc", "µ"))
    plain = re.sub(r"\s+|(?<=\w)-(?=[^\W\d])", "*", plain)  # m s^-1, N-m
    factor, dimension, position = 1.0, [0, 0, 0, 0], 0
    while position < len(plain):
        part = _PART.match(plain, position)
        if part is None:
            raise InputError(f"{text!r} is no unit; write it like deg/s, m/s^2 or N*m")
        sign, name, power, mark = part.groups()
        if name not in _UNITS:
            raise InputError(f"{text!r} is no unit that is known{_suggest_unit(name) or expected}")
        exponent = (-1 if sign == "/" else 1) * (int(power) if power else {"²": 2, "³": 3}.get(mark, 1))
        factor *= _UNITS[name].factor ** exponent
        dimension = [have + exponent * more for have, more in zip(dimension, _UNITS[name].dimension, strict=True)]
        position = part.end()
    if not plain:
        raise InputError("a unit is empty; write it like deg/s, or 1 for a number without unit")
    return Unit(factor, (dimension[0], dimension[1], dimension[2], dimension[3]))


def _suggest_unit(name: str) -> str:
    """Writes a hint on an unknown unit, the end of a message: prefixes that its stem takes, a similar name, or ""."""
    for prefix in (*_SMALL, *_WRITTEN_OUT, *_NO_SUCH):
        stem = name.removeprefix(prefix)
        if stem != name and stem in _UNITS:
            own = _UNITS[stem]
            alike = [
                f"'{one}'" for one, unit in _UNITS.items() if one.endswith(stem) and unit.dimension == own.dimension
            ]
            return f": of '{stem}' there {'are' if len(alike) > 1 else 'is'} {', '.join(alike)}"
    return suggestion(name, difflib.get_close_matches(name, _UNITS, n=1))


def si_factor(text: str, *kinds: str) -> float:
    """Returns the factor from a unit to SI; raises InputError for a unit of other kinds of quantity."""
    expected = " or ".join(f"{kind} ({_KINDS[kind][1]})" for kind in kinds)
    unit = parse_unit(text, f"; expected one of {expected}")
    if unit.dimension not in {_KINDS[kind][0] for kind in kinds}:
        of = next((kind for kind, (dimension, _) in _KINDS.items() if dimension == unit.dimension), "something else")
        raise InputError(f"{text!r} is a unit of {of}; expected one of {expected}")
    return unit.factor


def is_unit_of(text: str, kind: str) -> bool:
    """Tests whether a text is a unit of a kind of quantity such as "rate"; raises InputError for no unit."""
    return parse_unit(text).dimension == _KINDS[kind][0]
