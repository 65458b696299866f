"""The linear program of jet selection against an independent solver (HiGHS, by scipy)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram, Outcome, Selection

Array = NDArray[np.float64]

# tighter than HiGHS's own 1e-7, so that what is compared is not its tolerance
HIGHS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
WEIGHTS = np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])  # of the scaled rows, as documented


class Jets(NamedTuple):
    """Activity vectors, mass flows and kinds of a set of jets."""

    activity: Array
    mass_flows: Array
    primary: NDArray[np.bool_]


@pytest.fixture(scope="module")
def jets(orbiter: Vehicle) -> Jets:
    """All 44 jets of the orbiter with its nominal mass properties."""
    return Jets(
        activity_vectors(orbiter.wrenches, orbiter.nominal.vector()),
        orbiter.mass_flows,
        np.array([jet.kind == "primary" for jet in orbiter.jets]),
    )


@pytest.fixture(scope="module")
def primaries(jets: Jets) -> Jets:
    return Jets(jets.activity[:, jets.primary], jets.mass_flows[jets.primary], np.ones(38, dtype=bool))


def _scaled(activity: Array, request: Array) -> tuple[Array, Array, float]:
    """Rows with a largest element of 1, the request likewise, and its largest element before."""
    rows = np.abs(activity).max(axis=1)
    target = request / rows
    size = float(np.abs(target).max())
    return activity / rows[:, None], target / size, size


def _least_propellant(jets: Jets, request: Array, limits_s: Array) -> float | None:
    """Least propellant by HiGHS; None where the request is out of reach."""
    rows, target, size = _scaled(jets.activity, request)
    bounds = np.column_stack([np.zeros_like(limits_s), limits_s / size])
    found = linprog(jets.mass_flows, A_eq=rows, b_eq=target, bounds=bounds, method="highs", options=HIGHS)
    assert found.status in (0, 2), found.message
    return float(found.fun) * size if found.status == 0 else None


def _largest_share(jets: Jets, request: Array, limits_s: Array) -> float | None:
    """The largest share of the velocity change that goes with all of the rate change, by HiGHS."""
    rows, target, size = _scaled(jets.activity, request)
    n = limits_s.size
    matrix = np.column_stack([rows, np.concatenate([np.zeros(3), -target[3:]])])
    bounds = [*((0.0, limit / size) for limit in limits_s), (0.0, 1.0)]
    cost = np.zeros(n + 1)
    cost[n] = -1.0
    right = np.concatenate([target[:3], np.zeros(3)])
    found = linprog(cost, A_eq=matrix, b_eq=right, bounds=bounds, method="highs", options=HIGHS)
    assert found.status in (0, 2), found.message
    return -float(found.fun) if found.status == 0 else None


def _least_distance(jets: Jets, request: Array, limits_s: Array) -> float:
    """The least weighted distance of anything reachable from the request, by HiGHS."""
    rows, target, size = _scaled(jets.activity, request)
    n = limits_s.size
    cost = np.concatenate([np.zeros(n), WEIGHTS, WEIGHTS])
    matrix = np.hstack([rows, np.eye(6), -np.eye(6)])
    bounds = [*((0.0, limit / size) for limit in limits_s), *[(0.0, None)] * 12]
    found = linprog(cost, A_eq=matrix, b_eq=target, bounds=bounds, method="highs", options=HIGHS)
    assert found.status == 0, found.message
    return float(found.fun)


def _distance(jets: Jets, request: Array, reached: Array) -> float:
    rows = np.abs(jets.activity).max(axis=1)
    return float(WEIGHTS @ np.abs((reached - request) / rows)) / float(np.abs(request / rows).max())


def _residual(jets: Jets, request: Array, selection: Selection) -> float:
    """Largest miss of a row relative to the largest request, both in scaled rows."""
    rows = np.abs(jets.activity).max(axis=1)
    miss = (jets.activity @ selection.on_times_s - request) / rows
    return float(np.abs(miss).max() / np.abs(request / rows).max())


def _between_bounds(selection: Selection, limits_s: Array) -> int:
    # an on-time at its limit comes back through a division and a multiplication: a few units in the last place
    times = selection.on_times_s
    slack = np.where(np.isfinite(limits_s), 1e-12 * limits_s, 0.0)
    return int(((times > slack) & (times < limits_s - slack)).sum())


def test_random_requests_cost_the_least_and_are_met(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    rng = np.random.default_rng(0)
    unlimited = np.full(38, np.inf)
    for _ in range(500):
        request = rng.standard_normal(6)
        request[:3] *= 10.0 ** rng.uniform(-6.0, 0.0)  # rad/s
        request[3:] *= 10.0 ** rng.uniform(-5.0, 2.0)  # ft/s
        selection = dut.solve(primaries.activity, request, unlimited)
        assert selection.outcome == Outcome.EXACT
        np.testing.assert_allclose(
            selection.propellant, _least_propellant(primaries, request, unlimited), rtol=1e-9, atol=0.0
        )
        np.testing.assert_allclose(
            selection.propellant, primaries.mass_flows @ selection.on_times_s, rtol=1e-14, atol=0.0
        )
        np.testing.assert_array_equal(selection.reached, primaries.activity @ selection.on_times_s)
        assert _residual(primaries, request, selection) < 1e-9
        assert selection.on_times_s.min() >= 0.0
        assert _between_bounds(selection, unlimited) <= 6


def test_bounded_random_translations_cost_the_least_and_keep_the_bounds(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    rng = np.random.default_rng(1)
    limits = np.full(38, 2.0)
    exact = at_limit = 0
    for _ in range(200):
        direction = rng.standard_normal(3)
        velocity = direction / np.linalg.norm(direction)  # 1 ft/s
        request = np.concatenate([2e-3 * rng.standard_normal(3), velocity])
        selection = dut.solve(primaries.activity, request, limits)
        assert selection.on_times_s.min() >= 0.0
        assert selection.on_times_s.max() <= 2.0
        assert _between_bounds(selection, limits) <= 6
        least = _least_propellant(primaries, request, limits)
        assert (selection.outcome == Outcome.EXACT) == (least is not None)
        if least is None:
            continue
        exact += 1
        at_limit += bool((selection.on_times_s == 2.0).any())
        np.testing.assert_allclose(selection.propellant, least, rtol=1e-9, atol=0.0)
        assert _residual(primaries, request, selection) < 1e-9
    assert exact > 150
    assert at_limit > 20  # the bounds matter in this test


def test_a_translation_aft_beyond_the_jets_is_served_at_their_greatest_acceleration(primaries: Jets) -> None:
    # the three jets that push aft give 3 x 0.99 x 888 lbf / 5908 slug = 0.446 ft/s^2, the slight tilt of the
    # others a little more, but not 0.5
    dut = JetSelectionProgram(primaries.mass_flows)
    request = np.array([0.0, 0.0, 0.0, -1.0, 0.0, 0.0])  # 0.5 ft/s^2 for 2 s
    limits = np.full(38, 2.0)
    selection = dut.solve(primaries.activity, request, limits)
    assert selection.outcome == Outcome.REDUCED
    share = _largest_share(primaries, request, limits)
    assert share is not None
    assert 0.446 / 0.5 < share < 0.999
    # 1e-9 of the share is given up on purpose
    np.testing.assert_allclose(-selection.reached[3], share, rtol=2e-9, atol=0.0)
    # the rest of the request is kept: no turning, no sideways motion
    rows = np.abs(primaries.activity).max(axis=1)
    others = [0, 1, 2, 4, 5]
    np.testing.assert_allclose((selection.reached / rows)[others], 0.0, atol=1e-9 * np.abs(request / rows).max())
    # and what is reached is reached at the least cost: the reference gives away the rounding of `reached`
    least = _least_propellant(primaries, request * -selection.reached[3], limits)
    assert least is not None
    np.testing.assert_allclose(selection.propellant, least, rtol=1e-7, atol=0.0)


def test_translations_beyond_reach_get_their_largest_share(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    rng = np.random.default_rng(2)
    limits = np.full(38, 2.0)
    rows = np.abs(primaries.activity).max(axis=1)
    reduced = 0
    for _ in range(200):
        request = np.concatenate([2e-3 * rng.standard_normal(3), 3.0 * rng.choice([-1.0, 0.0, 1.0], 3)])
        share = _largest_share(primaries, request, limits)
        if share is None or share == 1.0:
            continue
        selection = dut.solve(primaries.activity, request, limits)
        assert selection.outcome == Outcome.REDUCED
        reduced += 1
        target = np.concatenate([request[:3], share * request[3:]])
        # on the edge of reach Clp's absolute 1e-7, in its own scaling, shows as up to 5e-6 of the request
        miss = np.abs((selection.reached - target) / rows) / np.abs(request / rows).max()
        assert miss.max() < 1e-5
    assert reduced > 150


def test_verniers_alone_come_as_close_as_can_be(jets: Jets) -> None:
    # six verniers span five dimensions and push down and sideways only
    dut = JetSelectionProgram(jets.mass_flows)
    rng = np.random.default_rng(3)
    limits = np.where(jets.primary, 0.0, 20.0)
    for _ in range(100):
        request = np.zeros(6)
        request[:3] = 10.0 ** rng.uniform(-5.0, -2.0) * rng.standard_normal(3)
        selection = dut.solve(jets.activity, request, limits)
        assert selection.outcome == Outcome.CLOSEST
        assert not selection.on_times_s[jets.primary].any()
        assert selection.on_times_s.min() >= 0.0
        assert selection.on_times_s.max() <= 20.0
        # Clp takes a row for met when it misses by 1e-7
        np.testing.assert_allclose(
            _distance(jets, request, selection.reached), _least_distance(jets, request, limits), rtol=1e-7, atol=0.0
        )


def test_almost_all_jets_out_still_comes_as_close_as_can_be(jets: Jets) -> None:
    dut = JetSelectionProgram(jets.mass_flows)
    limits = np.zeros(44)
    limits[[0, 28]] = 2.0  # one forward jet pushing aft, one aft jet pushing left
    request = np.array([1e-3, -1e-3, 2e-3, 0.0, 0.0, 0.0])
    selection = dut.solve(jets.activity, request, limits)
    assert selection.outcome == Outcome.CLOSEST
    assert set(np.flatnonzero(selection.on_times_s)) <= {0, 28}
    np.testing.assert_allclose(
        _distance(jets, request, selection.reached), _least_distance(jets, request, limits), rtol=1e-9, atol=0.0
    )


def test_without_any_jet_nothing_fires(jets: Jets) -> None:
    dut = JetSelectionProgram(jets.mass_flows)
    selection = dut.solve(jets.activity, np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(44))
    assert selection.outcome == Outcome.CLOSEST
    assert not selection.on_times_s.any()
    assert not selection.reached.any()


def test_no_request_is_ever_dropped(jets: Jets) -> None:
    """Translations at the edge of what the jets can do, and with verniers alone."""
    dut = JetSelectionProgram(jets.mass_flows)
    rng = np.random.default_rng(4)
    for number in range(1000):
        request = np.concatenate(
            [2e-3 * rng.standard_normal(3), rng.uniform(0.0, 5.0) * rng.choice([-1.0, 0.0, 1.0], 3)]
        )
        longest = rng.uniform(0.08, 2.0)
        limits = np.where(jets.primary == (number % 2 == 1), longest, 0.0)
        selection = dut.solve(jets.activity, request, limits)
        assert selection.on_times_s.min() >= 0.0
        assert (selection.on_times_s <= limits).all()


def test_a_jet_with_limit_zero_is_never_chosen(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    request = np.array([0.0, 0.0, 5e-3, 0.0, 0.0, 0.0])
    chosen = np.flatnonzero(dut.solve(primaries.activity, request, np.full(38, np.inf)).on_times_s)
    limits = np.full(38, np.inf)
    limits[chosen] = 0.0
    again = dut.solve(primaries.activity, request, limits)
    assert not again.on_times_s[chosen].any()
    assert again.outcome == Outcome.EXACT
    np.testing.assert_allclose(again.propellant, _least_propellant(primaries, request, limits), rtol=1e-9)


def test_the_answer_grows_in_proportion_to_the_request(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    request = np.array([1e-3, -2e-3, 5e-4, 0.1, 0.0, -0.2])
    unlimited = np.full(38, np.inf)
    one = dut.solve(primaries.activity, request, unlimited)
    million = dut.solve(primaries.activity, 1e-6 * request, unlimited)
    np.testing.assert_allclose(million.on_times_s, 1e-6 * one.on_times_s, rtol=1e-9, atol=1e-20)


def test_the_answer_does_not_depend_on_what_was_asked_before(primaries: Jets) -> None:
    request = np.array([1e-3, -2e-3, 5e-4, 0.1, 0.0, -0.2])
    unlimited = np.full(38, np.inf)
    fresh = JetSelectionProgram(primaries.mass_flows).solve(primaries.activity, request, unlimited)
    used = JetSelectionProgram(primaries.mass_flows)
    used.solve(primaries.activity, np.array([0.0, 0.0, 0.0, -1.0, 0.0, 0.0]), np.full(38, 2.0))
    used.solve(2.0 * primaries.activity, -request, unlimited)
    np.testing.assert_array_equal(used.solve(primaries.activity, request, unlimited).on_times_s, fresh.on_times_s)


def test_a_request_of_nothing_gives_nothing(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    selection = dut.solve(primaries.activity, np.zeros(6), np.full(38, 2.0))
    assert selection.outcome == Outcome.EXACT
    assert selection.propellant == 0.0
    assert not selection.on_times_s.any()
    assert not selection.reached.any()


def test_programs_are_counted(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    dut.solve(primaries.activity, np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]), np.full(38, np.inf))
    assert dut.solves == 1
    # out of reach, then the share, then the least propellant for it
    dut.solve(primaries.activity, np.array([0.0, 0.0, 0.0, -1.0, 0.0, 0.0]), np.full(38, 2.0))
    assert dut.solves == 4


def test_wrong_shapes_are_refused(primaries: Jets) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    limits = np.full(38, np.inf)
    with pytest.raises(ValueError, match=r"activity must have shape \(6, 38\), got \(6, 37\)"):
        dut.solve(primaries.activity[:, :37], np.zeros(6), limits)
    with pytest.raises(ValueError, match=r"request must have shape \(6,\), got \(3,\)"):
        dut.solve(primaries.activity, np.zeros(3), limits)
    with pytest.raises(ValueError, match=r"limits_s must have shape \(38,\), got \(44,\)"):
        dut.solve(primaries.activity, np.zeros(6), np.full(44, np.inf))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(primaries: Jets, bad: float) -> None:
    dut = JetSelectionProgram(primaries.mass_flows)
    request = np.array([1e-3, 0.0, bad, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="must be finite"):
        dut.solve(primaries.activity, request, np.full(38, np.inf))
    activity = primaries.activity.copy()
    activity[2, 5] = bad
    with pytest.raises(ValueError, match="must be finite"):
        dut.solve(activity, np.zeros(6), np.full(38, np.inf))


@pytest.mark.parametrize("bad", [np.nan, -0.1])
def test_limits_that_are_no_times_are_refused(primaries: Jets, bad: float) -> None:
    limits = np.full(38, 2.0)
    limits[7] = bad
    with pytest.raises(ValueError, match="limits_s must be zero or positive"):
        JetSelectionProgram(primaries.mass_flows).solve(primaries.activity, np.ones(6), limits)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1.0])
def test_mass_flows_must_be_positive(bad: float) -> None:
    with pytest.raises(ValueError, match="mass flows must be positive and finite"):
        JetSelectionProgram(np.array([0.1, bad, 0.1]))
