"""The linear program of guaranteed intervals, by Drake."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.systems.estimation.interval_program import solve_linear_program

# x + y <= 4, x + 3 y <= 6, x and y from 0 to 3
MATRIX = np.array([[1.0, 1.0], [1.0, 3.0], [1.0, 0.0], [0.0, 1.0]])
LOW, HIGH = np.array([-np.inf, -np.inf, 0.0, 0.0]), np.array([4.0, 6.0, 3.0, 3.0])


@pytest.mark.parametrize(
    ("cost", "corner"), [((-1.0, -2.0), (3.0, 1.0)), ((1.0, -2.0), (0.0, 2.0)), ((1.0, 1.0), (0.0, 0.0))]
)
def test_the_corner_of_least_cost(cost: tuple[float, float], corner: tuple[float, float]) -> None:
    found = solve_linear_program(np.array(cost), MATRIX, LOW, HIGH)
    np.testing.assert_allclose(found, corner, atol=1e-9)


def test_contradicting_constraints_have_no_solution() -> None:
    assert solve_linear_program(np.ones(1), np.ones((2, 1)), np.array([1.0, -np.inf]), np.array([np.inf, 0.5])) is None


@pytest.mark.parametrize("place", range(4))
def test_a_number_that_is_none_is_refused(place: int) -> None:
    given = [np.ones(2), MATRIX.copy(), LOW.copy(), HIGH.copy()]
    given[place].flat[0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        solve_linear_program(*given)
