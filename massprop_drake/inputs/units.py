"""Units as recorders write them: deg/s, rpm, g, ms, mm/s^2."""

from __future__ import annotations

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

_UNITS = {
    **{name: Unit(1.0, _NONE) for name in ("1", "fraction")},
    **{name: Unit(0.01, _NONE) for name in ("%", "percent")},
    **{
        f"{prefix}{second}": Unit(factor, _TIME)
        for prefix, factor in {"": 1.0, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9}.items()
        for second in ("s", "sec", "secs")
    },
    **{
        f"{prefix}second{plural}": Unit(factor, _TIME)
        for prefix, factor in {"": 1.0, "milli": 1e-3, "micro": 1e-6, "nano": 1e-9}.items()
        for plural in ("", "s")
    },
    **{name: Unit(60.0, _TIME) for name in ("min", "minutes")},
    **{name: Unit(3600.0, _TIME) for name in ("h", "hours")},
    **{name: Unit(86400.0, _TIME) for name in ("d", "day", "days")},
    **{name: Unit(1.0, _ANGLE) for name in ("rad", "radian", "radians")},
    "mrad": Unit(1e-3, _ANGLE),
    "urad": Unit(1e-6, _ANGLE),
    **{name: Unit(_DEGREE, _ANGLE) for name in ("deg", "°", "degree", "degrees")},
    "mdeg": Unit(1e-3 * _DEGREE, _ANGLE),
    "arcsec": Unit(_DEGREE / 3600.0, _ANGLE),
    **{name: Unit(_TURN, _ANGLE) for name in ("rev", "turn")},
    "rpm": Unit(_TURN / 60.0, _RATE),
    "dps": Unit(_DEGREE, _RATE),
    **{name: Unit(1.0, _LENGTH) for name in ("m", "meter", "meters")},
    **{
        f"{prefix}m": Unit(factor, _LENGTH)
        for prefix, factor in {"k": 1e3, "d": 0.1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6}.items()
    },
    "ft": Unit(FOOT, _LENGTH),
    "in": Unit(FOOT / 12.0, _LENGTH),
    "g": Unit(GRAVITY, _ACCELERATION),
    "mg": Unit(1e-3 * GRAVITY, _ACCELERATION),
    "ug": Unit(1e-6 * GRAVITY, _ACCELERATION),
    "kg": Unit(1.0, _MASS),
    "slug": Unit(SLUG, _MASS),
    "N": Unit(1.0, _FORCE),
    "mN": Unit(1e-3, _FORCE),
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


def parse_unit(text: str) -> Unit:
    """Reads a unit, a product or quotient of names with powers: `deg/s`, `m/s^2`, `m/s2`, `N*m`.

    Raises:
        InputError: when a name is not known.
    """
    plain = re.sub(r"\s*([*/·])\s*", r"\1", text.strip().replace("\u03bc", "µ"))
    plain = re.sub(r"\s+|(?<=\w)-(?=[^\W\d])", "*", plain)  # m s^-1, N-m
    factor, dimension, place = 1.0, [0, 0, 0, 0], 0
    while place < len(plain):
        part = _PART.match(plain, place)
        if part is None:
            raise InputError(f"{text!r} is no unit; write it like deg/s, m/s^2 or N*m")
        sign, name, power, mark = part.groups()
        if name not in _UNITS:
            known = [*_UNITS]
            raise InputError(f"{text!r} is no unit that is known{suggestion(name, known)}")
        exponent = (-1 if sign == "/" else 1) * (int(power) if power else {"²": 2, "³": 3}.get(mark, 1))
        factor *= _UNITS[name].factor ** exponent
        dimension = [have + exponent * more for have, more in zip(dimension, _UNITS[name].dimension, strict=True)]
        place = part.end()
    if not plain:
        raise InputError("a unit is empty; write it like deg/s, or 1 for a number without unit")
    return Unit(factor, (dimension[0], dimension[1], dimension[2], dimension[3]))


def si_factor(text: str, *kinds: str) -> float:
    """Returns the factor from a unit to SI; the unit must measure one of the given kinds of quantity.

    Args:
        text: the unit.
        kinds: such as "rate", "length", "time".

    Raises:
        InputError: when it is not known, or of another kind.
    """
    unit = parse_unit(text)
    if unit.dimension not in {_KINDS[kind][0] for kind in kinds}:
        of = next((kind for kind, (dimension, _) in _KINDS.items() if dimension == unit.dimension), "something else")
        wanted = " or ".join(f"{kind} ({_KINDS[kind][1]})" for kind in kinds)
        raise InputError(f"{text!r} is a unit of {of}; expected one of {wanted}")
    return unit.factor


def is_unit_of(text: str, kind: str) -> bool:
    """Tests whether a unit is of a kind of quantity; raises InputError for no unit."""
    return parse_unit(text).dimension == _KINDS[kind][0]
