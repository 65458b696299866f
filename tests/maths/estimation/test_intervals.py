"""Guaranteed intervals, against programs and a simulation of their own: scipy's solver, and Euler's equations."""

from __future__ import annotations

from typing import Any, NamedTuple

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
    rows = np.asarray(matrix, dtype=float)
    n = rows.shape[1]
    return Constraints(
        np.vstack((np.eye(n) / span, rows)),
        np.concatenate((-np.ones(n), np.asarray(low, dtype=float))),
        np.concatenate((np.ones(n), np.asarray(high, dtype=float))),
        n,
    )


def test_corners_and_the_deepest_point_of_a_triangle() -> None:
    """Of x >= 0, y >= 0, x + 2 y <= 2 the corners; of x + y <= 3 all three distances are one at (1, 1)."""
    given = boxed([[1.0, 0.0], [0.0, 1.0], [1.0, 2.0]], [0.0, 0.0, -np.inf], [np.inf, np.inf, 2.0])
    found = extreme_points(given, 2, by_scipy)
    assert found is not None
    np.testing.assert_allclose(found[[0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 1, 1]], [0.0, 2.0, 0.0, 1.0], atol=1e-9)
    point, depth = deepest_point(
        boxed([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.0, 0.0, -np.inf], [np.inf, np.inf, 3.0]), by_scipy
    )
    np.testing.assert_allclose([*point, depth], [1.0, 1.0, 1.0], atol=1e-8)
    contradicting = boxed([[1.0], [1.0]], [1.0, -np.inf], [np.inf, 0.5])
    assert extreme_points(contradicting, 1, by_scipy) is None
    np.testing.assert_allclose(np.append(*deepest_point(contradicting, by_scipy)), [0.75, -0.25], atol=1e-8)
    with pytest.raises(ArithmeticError, match="solver"):
        deepest_point(contradicting, lambda *_: None)


PERIOD, ROWS, FINE = 0.1, 120, 10
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


class Point(NamedTuple):
    """Unknowns of a flight: the ten parameters, the rate at the beginning, the lag."""

    properties: Array
    rate: Array
    lag_s: float = LAG_S


def commands(seed: int = 0) -> Array:
    """Commands of the six jets, shape (ROWS, 6)."""
    return np.repeat(np.random.default_rng(seed).uniform(size=(ROWS // 5, 6)) < 0.25, 5, axis=0).astype(float)


def signals(points: list[Point], told: Array) -> Array:
    """Rate and integrated acceleration by Runge and Kutta's method, all points at once, shape (p, ROWS + 1, 6)."""
    ten = np.array([one.properties for one in points])
    inverse = np.zeros((len(points), 3, 3))
    for k, (i, j) in enumerate(ELEMENTS):
        inverse[:, i, j] = inverse[:, j, i] = ten[:, k]
    inertia, center, light = np.linalg.inv(inverse), ten[:, 6:9], ten[:, 9:]
    lags = np.array([one.lag_s for one in points])[:, None]
    state = np.hstack((np.array([one.rate for one in points]), np.zeros((len(points), 3))))
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
    sizes = [10, 6, 1, 3, 3, 3, 3, 3, 3, 3, 9]
    sigma = np.concatenate([np.zeros(size) for size in sizes])
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
    known = np.vstack((told, np.zeros((1, 6))))
    nothing = np.zeros((ROWS + 1, 6))
    time_s = PERIOD * np.arange(ROWS + 1)
    return Stretch(time_s, readings.reshape(-1, 2, 3), known, np.zeros((1, 6)), nothing, np.zeros(ROWS + 1))


def quantized(values: Array, phase: Array) -> Array:
    """Nearest marks, which are off the multiples by a phase."""
    quanta = np.repeat(QUANTA, 3)
    return np.asarray((np.rint(values / quanta + phase) - phase) * quanta)


def flight(point: Point, seed: int = 0) -> Stretch:
    """A quantized record of a point's flight."""
    told = commands(seed)
    return stretch(quantized(signals([point], told)[0], np.random.default_rng(seed).uniform(-0.5, 0.5, 6)), told)


CELLS = Cells(QUANTA, np.zeros(2), np.zeros(1), 3.0 * (np.abs(TRUTH) + 0.01))
START = np.array([0.004, -0.006, 0.002])


def found_of(record: Stretch, made: FlightModel, cells: Cells = CELLS) -> Confined:
    """Intervals of a record, about a point that is off by 1e-4."""
    return find_intervals([record], made.prior, made, cells, solve_linear_program)


def is_inside(found: Confined) -> bool:
    """Tests whether the truth is in every interval."""
    return bool(((found.low <= TRUTH) & (found.high >= TRUTH)).all())


@pytest.fixture(scope="module")
def usual() -> tuple[Stretch, Confined]:
    """A record of exact thrusts and lag, and its intervals."""
    record = flight(Point(TRUTH, START))
    return record, found_of(record, model())


def test_intervals_are_those_of_an_independent_program(usual: tuple[Stretch, Confined]) -> None:
    # derivatives by differences of the simulation, all readings in one program
    record, found = usual
    assert is_inside(found)
    assert not found.is_contradicted
    sizes = np.concatenate((1e-4 * np.abs(TRUTH), np.full(3, 1e-5)))
    each = np.eye(13) * sizes
    points = [Point(TRUTH + sign * one[:10], START + sign * one[10:]) for one in each for sign in (1.0, -1.0)]
    flown = signals([Point(TRUTH, START), *points], commands())
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
    _, exact = usual
    lagging = found_of(flight(Point(TRUTH, START, lag_s=1.1 * LAG_S)), model(lag_sigma_s=0.2 * LAG_S))
    assert is_inside(lagging)
    loose = found_of(flight(Point(TRUTH, START)), model(thrust_sigma=0.005))
    assert is_inside(loose)
    # thrusts and mass share a scale: 4 sigma of 0.5 % either way
    width = (loose.high - loose.low)[9] / TRUTH[9]
    assert 0.037 < width < 0.046
    assert width > 3.0 * (exact.high - exact.low)[9] / TRUTH[9]


def test_a_wrong_lag_contradicts_the_readings() -> None:
    found = found_of(flight(Point(TRUTH, START, lag_s=2.0 * LAG_S)), model())
    assert found.is_contradicted
    assert found.depth < -0.5
    assert np.isnan(found.low).all()


def test_noise_a_bias_gaps_and_further_stretches_leave_the_truth_inside(usual: tuple[Stretch, Confined]) -> None:
    record, exact = usual
    rng, told, noise = np.random.default_rng(1), commands(), 0.1 * QUANTA
    values = signals([Point(TRUTH, START)], told)[0]
    noisy = values + rng.standard_normal((ROWS + 1, 6)) * np.repeat(noise, 3)
    assert is_inside(found_of(stretch(quantized(noisy, np.zeros(6)), told), model(), CELLS._replace(noise=noise)))
    wider = found_of(record, model(), CELLS._replace(noise=noise))
    assert ((wider.low < exact.low) & (exact.high < wider.high)).all()
    biased = quantized(values + np.array([2e-4, -1e-4, 1e-4, 0.0, 0.0, 0.0]), np.zeros(6))
    assert is_inside(found_of(stretch(biased, told), model(), CELLS._replace(gyro_biases=np.array([1e-4]))))
    second = flight(Point(TRUTH, -START), seed=1)
    second.readings[30:70, :, 0] = np.nan
    both = find_intervals([record, second], model().prior, model(), CELLS, solve_linear_program)
    assert is_inside(both)
    assert (both.high - both.low <= 1.001 * (exact.high - exact.low)).all()
