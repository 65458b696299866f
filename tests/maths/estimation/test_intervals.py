"""Guaranteed intervals, against programs and a simulation of their own: scipy's solver, and Euler's equations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.estimation.offline.intervals import (
    Cells,
    Confined,
    Constraints,
    deepest_point,
    extreme_points,
    find_intervals,
)
from massprop_drake.systems.estimation.interval_program import solve_linear_program

Array = NDArray[np.float64]


def by_scipy(cost: Array, matrix: Array, low: Array, high: Array) -> Array | None:
    """A solver that is not the one of the package."""
    ends = np.concatenate((high, -low))
    there = np.isfinite(ends)
    rows = np.vstack((matrix, -matrix))[there]
    found = linprog(cost, rows, ends[there], bounds=(None, None), method="highs")
    return np.asarray(found.x) if found.status == 0 else None


def boxed(matrix: Any, low: Any, high: Any, span: float = 10.0) -> Constraints:
    """Constraints, each unknown within a span of its own besides."""
    own = np.ones(len(matrix[0]))
    return Constraints(np.vstack((np.diag(own) / span, matrix)), np.append(-own, low), np.append(own, high), own.size)


def test_corners_and_the_deepest_point_of_a_triangle() -> None:
    """Of x >= 0, y >= 0, x + 2 y <= 2 the corners; of x + y <= 3 all three distances are one at (1, 1)."""
    low, high = [0.0, 0.0, -np.inf], [np.inf, np.inf, 2.0]
    found = extreme_points(boxed([[1.0, 0.0], [0.0, 1.0], [1.0, 2.0]], low, high), 2, by_scipy)
    assert found is not None
    np.testing.assert_allclose(found[[0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 1, 1]], [0.0, 2.0, 0.0, 1.0], atol=1e-9)
    high[2] = 3.0
    point, depth = deepest_point(boxed([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], low, high), by_scipy)
    np.testing.assert_allclose([*point, depth], [1.0, 1.0, 1.0], atol=1e-8)
    contradicting = boxed([[1.0], [1.0]], [1.0, -np.inf], [np.inf, 0.5])
    assert extreme_points(contradicting, 1, by_scipy) is None
    np.testing.assert_allclose(np.append(*deepest_point(contradicting, by_scipy)), [0.75, -0.25], atol=1e-8)
    with pytest.raises(ArithmeticError, match="solver"):
        deepest_point(contradicting, lambda *_: None)


PERIOD, ROWS, FINE = 0.1, 60, 10
INERTIA = np.array([[3.0, 0.2, -0.1], [0.2, 4.0, 0.15], [-0.1, 0.15, 5.0]])
INVERSE, CENTER, MASS = np.linalg.inv(INERTIA), np.array([0.05, -0.02, 0.03]), 40.0
ELEMENTS = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
TRUTH = np.array([*(INVERSE[i, j] for i, j in ELEMENTS), *CENTER, 1.0 / MASS])
SPOTS = np.array([[1, 0.5, 0], [-1, 0.4, 0.2], [0, 1, 0.5], [0.3, -1, 0.5], [0.5, 0, 1], [-0.4, 0.6, -1]])
FORCES = 0.1 * np.array([[0, 1, 0.1], [0.1, 0, 1], [0.2, 0.1, -1], [1, 0, 0.3], [0, -1, 0.2], [-1, 0.1, 0]])
WRENCHES = np.hstack((np.cross(SPOTS, FORCES), FORCES))
ARM = np.array([0.6, 0.1, -0.3])
QUANTA = np.array([2e-5, 5e-5])
LAG_S = 0.03
START = np.array([0.004, -0.006, 0.002])  # rad/s


def commands(seed: int = 0) -> Array:
    """Commands of the six jets, shape (ROWS, 6)."""
    return np.repeat(np.random.default_rng(seed).uniform(size=(ROWS // 5, 6)) < 0.25, 5, axis=0).astype(float)


def signals(points: Array, told: Array, lags: Array | float = LAG_S) -> Array:
    """Rate and integrated acceleration by Runge and Kutta's method, all points at once, shape (p, ROWS + 1, 6).

    Args:
        points: the ten parameters, and the rate at the beginning, shape (p, 13).
    """
    inverse = np.zeros((len(points), 3, 3))
    for k, (i, j) in enumerate(ELEMENTS):
        inverse[:, i, j] = inverse[:, j, i] = points[:, k]
    inertia, center, light = np.linalg.inv(inverse), points[:, 6:9], points[:, 9:10]
    state = np.hstack((points[:, 10:], np.zeros((len(points), 3))))
    level, h, found = np.zeros((len(points), 6)), PERIOD / FINE, [state]
    for row in told:
        for step in range(FINE):

            def slope(x: Array, at_s: float) -> Array:
                thrust = row + (level - row) * np.exp(-at_s / lags)  # noqa: B023 (called at once)
                torque, force = thrust @ WRENCHES[:, :3], thrust @ WRENCHES[:, 3:]
                w = x[:, :3]
                momentum = np.einsum("pij,pj->pi", inertia, w)
                turning = torque - np.cross(center, force) - np.cross(w, momentum)
                change = np.einsum("pij,pj->pi", inverse, turning)
                felt = force * light + np.cross(change, ARM - center) + np.cross(w, np.cross(w, ARM - center))
                return np.hstack((change, felt))

            t = step * h
            k1 = slope(state, t)
            k2 = slope(state + 0.5 * h * k1, t + 0.5 * h)
            k3 = slope(state + 0.5 * h * k2, t + 0.5 * h)
            k4 = slope(state + h * k3, t + h)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        level = row + (level - row) * np.exp(-PERIOD / lags)
        found.append(state)
    return np.array(found).swapaxes(0, 1)


def model(lag_sigma_s: float = 0.0, thrust_sigma: float = 0.0) -> FlightModel:
    """The small body as hindsight has it."""
    sigma = np.zeros(10 + 6 + 1 + 7 * 3 + 9)
    sigma[:10], sigma[10:16], sigma[16] = np.abs(TRUTH) + 0.01, thrust_sigma, lag_sigma_s
    prior = np.zeros(sigma.size)
    prior[:10] = TRUTH * 1.0001
    return FlightModel(
        period_s=PERIOD,
        wrenches=WRENCHES,
        flows=np.zeros(6),
        time_constants_s=np.full(6, LAG_S),
        kinds=np.zeros(6, dtype=int),
        positions=ARM[None],
        variances=QUANTA**2 / 12.0,
        quanta=QUANTA,
        gyros=1,
        prior=prior,
        sigma=sigma,
    )


def stretch(readings: Array, told: Array) -> Stretch:
    """A record of the small body; readings of shape (ROWS + 1, 6)."""
    time_s, nothing = PERIOD * np.arange(ROWS + 1), np.zeros((ROWS + 1, 6))
    known = np.vstack((told, nothing[:1]))
    return Stretch(time_s, readings.reshape(-1, 2, 3), known, nothing[:1], nothing, nothing[:, 0])


def quantized(values: Array, phase: Array) -> Array:
    """Nearest marks, which are off the multiples by a phase."""
    quanta = np.repeat(QUANTA, 3)
    return np.asarray((np.rint(values / quanta + phase) - phase) * quanta)


def flight(lag_s: float = LAG_S, start: Array = START, seed: int = 0) -> Stretch:
    """A quantized record of the truth."""
    told, phase = commands(seed), np.random.default_rng(seed).uniform(-0.5, 0.5, 6)
    return stretch(quantized(signals(np.append(TRUTH, start)[None], told, lag_s)[0], phase), told)


CELLS = Cells(QUANTA, np.zeros(2), np.zeros(1), 3.0 * (np.abs(TRUTH) + 0.01))


def found_of(record: Stretch, made: FlightModel, cells: Cells = CELLS) -> Confined:
    """Intervals of a record, about a point that is off by 1e-4."""
    return find_intervals([record], made.prior, made, cells, solve_linear_program)


def require_inside(found: Confined) -> None:
    """Requires the truth in every interval."""
    assert ((found.low <= TRUTH) & (found.high >= TRUTH)).all()


@pytest.fixture(scope="module")
def usual() -> tuple[Stretch, Confined]:
    """A record of exact thrusts and lag, and its intervals."""
    record = flight()
    return record, found_of(record, model())


def test_intervals_are_those_of_an_independent_program(usual: tuple[Stretch, Confined]) -> None:
    # derivatives by differences of the simulation, all readings in one program
    record, found = usual
    require_inside(found)
    assert not found.is_contradicted
    sizes = np.concatenate((1e-4 * np.abs(TRUTH), np.full(3, 1e-5)))
    moves = np.vstack((np.zeros(13), *(sign * one for one in np.diag(sizes) for sign in (1.0, -1.0))))
    flown = signals(np.append(TRUTH, START) + moves, commands())
    rows, lefts = [], []
    for component in range(6):
        slopes = (flown[1::2, :, component] - flown[2::2, :, component]).T / (2.0 * sizes)
        starts = np.zeros((ROWS + 1, 3))
        if component >= 3:
            starts[:, component - 3] = 1.0
        quantum = QUANTA[component // 3]
        rows.append(np.hstack((slopes, starts)) / quantum)
        lefts.append((record.readings.reshape(-1, 6)[:, component] - flown[0, :, component]) / quantum)
    matrix, left = np.vstack(rows), np.concatenate(lefts)
    size = np.abs(matrix).max(axis=0)
    for unknown in range(10):
        ends = []
        for sign in (1.0, -1.0):
            point = by_scipy(sign * np.eye(16)[unknown], matrix / size, left - 0.5, left + 0.5)
            assert point is not None
            ends.append(TRUTH[unknown] + point[unknown] / size[unknown])
        width = ends[1] - ends[0]  # what the model may be wrong by is allowed for in the package alone
        assert [found.low[unknown], found.high[unknown]] == pytest.approx(ends, abs=0.02 * width)
        assert found.low[unknown] < ends[0] < ends[1] < found.high[unknown]


def test_an_unknown_lag_and_unknown_thrusts_widen_the_intervals(usual: tuple[Stretch, Confined]) -> None:
    exact = usual[1]
    lagging = found_of(flight(1.1 * LAG_S), model(lag_sigma_s=0.2 * LAG_S))
    require_inside(lagging)
    loose = found_of(usual[0], model(thrust_sigma=0.005))
    require_inside(loose)
    # thrusts and mass share a scale: 4 sigma of 0.5 % either way
    width = (loose.high - loose.low)[9] / TRUTH[9]
    assert 0.037 < width < 0.046
    assert width > 3.0 * (exact.high - exact.low)[9] / TRUTH[9]


def test_a_wrong_lag_contradicts_the_readings() -> None:
    found = found_of(flight(2.0 * LAG_S), model())
    assert found.is_contradicted
    assert found.depth < -0.5
    assert np.isnan(found.low).all()


def test_noise_a_bias_gaps_and_further_stretches_leave_the_truth_inside(usual: tuple[Stretch, Confined]) -> None:
    record, exact = usual
    told, noise, off = commands(), 0.1 * QUANTA, np.array([2e-4, -1e-4, 1e-4, 0.0, 0.0, 0.0])
    scatter = np.random.default_rng(1).standard_normal((ROWS + 1, 6)) * np.repeat(noise, 3)
    values = signals(np.append(TRUTH, START)[None], told)[0] + scatter + off
    allowed = CELLS._replace(noise=noise, gyro_biases=np.array([1e-4]))
    require_inside(found_of(stretch(quantized(values, np.zeros(6)), told), model(), allowed))
    wider = found_of(record, model(), CELLS._replace(noise=noise))
    assert ((wider.low < exact.low) & (exact.high < wider.high)).all()
    second = flight(start=-START, seed=1)
    second.readings[15:35, :, 0] = np.nan
    both = find_intervals([record, second], model().prior, model(), CELLS, solve_linear_program)
    require_inside(both)
    assert (both.high - both.low <= 1.001 * (exact.high - exact.low)).all()
