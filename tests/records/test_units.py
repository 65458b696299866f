"""Units as recorders write them."""

from __future__ import annotations

import math

import pytest

from massprop_drake.errors import InputError
from massprop_drake.inputs.units import factor, parsed


@pytest.mark.parametrize(
    ("text", "kind", "size"),
    [
        ("deg/s", "rate", math.pi / 180.0),
        ("rpm", "rate", 2.0 * math.pi / 60.0),
        ("dps", "rate", math.pi / 180.0),
        ("mrad/ms", "rate", 1.0),
        ("g", "acceleration", 9.80665),
        ("mm/s^2", "acceleration", 1e-3),
        ("m/s²", "acceleration", 1.0),
        ("m s^-1", "velocity", 1.0),
        ("ft/s", "velocity", 0.3048),
        ("g*s", "velocity", 9.80665),
        ("ms", "time", 1e-3),
        ("N-m", "torque", 1.0),
        ("lbf*ft", "torque", 1.3558179483314004),
        ("lbf", "force", 4.4482216152605),
        ("%", "number", 0.01),
    ],
)
def test_units_in_si(text: str, kind: str, size: float) -> None:
    assert factor(text, kind) == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mm", "'mm' is a unit of length; expected one of rate (rad/s, deg/s or rpm)"),
        ("deg/s^2", "'deg/s^2' is a unit of something else"),
        ("degg/s", "did you mean 'deg'?"),
        ("", "a unit is empty"),
        ("/ ^", "is no unit; write it like deg/s"),
    ],
)
def test_what_is_no_unit_of_a_rate(text: str, said: str) -> None:
    with pytest.raises(InputError) as told:
        factor(text, "rate")
    assert said in str(told.value)


def test_a_product_of_powers() -> None:
    assert parsed("kg*m^2/s^2").dimension == parsed("N*m").dimension
