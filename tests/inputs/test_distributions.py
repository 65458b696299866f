"""What a campaign draws: quantiles against scipy's distributions, bounds, and blocks that are refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from massprop_drake import InputError
from massprop_drake.inputs.distributions import KINDS
from massprop_drake.inputs.model import validate_data

U = np.array([0.0, 1e-9, 0.01, 0.25, 0.5, 0.7, 0.99, 1.0 - 1e-9])

ORACLES: list[tuple[str, dict[str, Any], Any]] = [
    ("uniform", {"low": -2.0, "high": 3.0}, stats.uniform(-2.0, 5.0)),
    ("loguniform", {"low": 5.0, "high": 200.0}, stats.loguniform(5.0, 200.0)),
    ("triangular", {"low": 1.0, "high": 4.0, "mode": 2.0}, stats.triang(1.0 / 3.0, 1.0, 3.0)),
    ("triangular", {"low": 1.0, "high": 4.0, "mode": 1.0}, stats.triang(0.0, 1.0, 3.0)),
    ("normal", {"mean": 1.0, "std": 0.1}, stats.norm(1.0, 0.1)),
    ("normal", {"mean": 1.0, "std": 2.0, "low": 0.0, "high": 1.5}, stats.truncnorm(-0.5, 0.25, 1.0, 2.0)),
    ("normal", {"mean": 0.0, "std": 1.0, "low": 6.0}, stats.truncnorm(6.0, math.inf)),
    ("normal", {"mean": 0.0, "std": 1.0, "high": -6.0}, stats.truncnorm(-math.inf, -6.0)),
    ("lognormal", {"median": 3.0, "factor": 1.1}, stats.lognorm(math.log(1.1), scale=3.0)),
]


def made(tag: str, parameters: Any) -> Any:
    return validate_data(KINDS[tag], parameters, None, tag)


@pytest.mark.parametrize(("tag", "parameters", "oracle"), ORACLES)
def test_quantiles_are_those_of_scipy(tag: str, parameters: dict[str, Any], oracle: Any) -> None:
    inside = U[1:]  # an unbounded distribution has none at zero
    np.testing.assert_allclose(made(tag, parameters).quantiles(inside), oracle.ppf(inside), rtol=1e-9, atol=1e-12)
    assert np.isfinite(made(tag, parameters).quantiles(U)).all()


def test_whole_numbers_and_choices_are_alike_or_as_weighed() -> None:
    u = (np.arange(1000) + 0.5) / 1000
    numbers = made("integers", {"low": 2, "high": 6}).quantiles(u)
    assert [numbers.count(number) for number in range(2, 7)] == [200] * 5
    assert all(type(number) is int for number in numbers)
    assert [made("choice", ["a", "b"]).quantiles(u).count(name) for name in "ab"] == [500, 500]
    weighted = made("choice", {"values": ["a", "b", "c", "d"], "weights": [0, 3, 1, 0]})
    weighed = weighted.quantiles(np.append(u, [0.0, 1 - 1e-16]))
    assert [weighed.count(name) for name in "abcd"] == [0, 751, 251, 0]


bounds = st.floats(allow_nan=False, allow_infinity=False)
unit = st.floats(0.0, 1.0, exclude_max=True)


@settings(max_examples=50, derandomize=True, deadline=None, database=None)
@given(kind=st.sampled_from(["uniform", "loguniform", "triangular", "normal"]), a=bounds, b=bounds, c=unit, u=unit)
def test_nothing_is_drawn_beyond_the_bounds(kind: str, a: float, b: float, c: float, u: float) -> None:
    low, high = sorted((a, b))
    if kind == "loguniform":
        low, high = sorted((abs(a), abs(b)))
    parameters = {"low": low, "high": high}
    if kind == "triangular":
        parameters["mode"] = min(max(low + c * (high - low), low), high)
    if kind == "normal":
        parameters |= {"mean": 0.5 * low + 0.5 * high, "std": max(1e-300, 0.3 * high - 0.3 * low)}
    try:
        distribution = made(kind, parameters)
    except InputError:
        assert not low < high or low == 0.0 or math.isinf(high - low)
        return
    [value] = distribution.quantiles(np.array([u]))
    assert low <= value <= high


@pytest.mark.parametrize(
    ("tag", "parameters", "expected"),
    [
        ("uniform", {"low": 0.1, "high": 0.3, "points": 3}, [0.1, 0.2, 0.3]),
        ("loguniform", {"low": 1.0, "high": 100.0, "points": 3}, [1.0, 10.0, 100.0]),
        ("integers", {"low": 1, "high": 3, "points": 3}, [1, 2, 3]),
        ("integers", {"low": 1, "high": 9, "points": 3}, [1, 5, 9]),
    ],
)
def test_grids_take_points_with_their_bounds(tag: str, parameters: Any, expected: list[Any]) -> None:
    grid = made(tag, parameters).grid()
    assert grid == pytest.approx(expected, rel=1e-12)
    assert (grid[0], grid[-1]) == (expected[0], expected[-1])


@pytest.mark.parametrize(
    ("tag", "parameters", "said"),
    [
        ("uniform", {"low": 1.0, "high": 1.0}, "high must be above low, got 1 to 1"),
        ("normal", {"std": 1.0, "low": 1.0, "high": 1.0}, "high must be above low"),
        ("uniform", {"low": -1e308, "high": 1e308}, "too far apart"),
        ("integers", {"low": 0, "high": 2, "points": 4}, "there are no 4 whole numbers from 0 to 2"),
        ("integers", {"low": -(10**400), "high": 2}, "low"),
        ("normal", {"std": 1.0, "low": 9.0}, "nothing within 8 std of the mean"),
        ("choice", {"values": ["a"], "weights": [0]}, "one weight at least must be above zero"),
    ],
)
def test_what_makes_no_distribution_is_refused(tag: str, parameters: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        made(tag, parameters)
