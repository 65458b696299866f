"""The linear program of jet selection against an independent solver (HiGHS, by scipy)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.optimize import linprog

from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram, Outcome

Array = NDArray[np.float64]

# tighter than HiGHS's own 1e-7, so that what is compared is not its tolerance
HIGHS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
WEIGHTS = np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])  # of the scaled rows, as documented
ORBITER = load_vehicle("orbiter")
ACTIVITY = activity_vectors(ORBITER.wrenches, ORBITER.nominal.vector())
PRIMARY = np.array([jet.kind == "primary" for jet in ORBITER.jets])
ROWS = np.abs(ACTIVITY).max(axis=1)
BOUNDED, UNBOUNDED = np.where(PRIMARY, 2.0, 0.0), np.where(PRIMARY, np.inf, 0.0)


class Best(NamedTuple):
    """What HiGHS says of a request: least propellant and largest share, None where out of reach; least distance."""

    propellant: float | None
    share: float | None
    distance: float


def solved(cost: Array, matrix: Array, right: Array, bounds: list[Any]) -> float | None:
    found = linprog(cost, A_eq=matrix, b_eq=right, bounds=bounds, method="highs", options=HIGHS)
    assert found.status in (0, 2), found.message
    return float(found.fun) if found.status == 0 else None


def best(request: Array, limits_s: Array) -> Best:
    """Solves with rows whose largest element is 1, and the request likewise."""
    size = float(np.abs(request / ROWS).max())
    rows, target, n = ACTIVITY / ROWS[:, None], request / ROWS / size, limits_s.size
    box = [(0.0, limit / size) for limit in limits_s]
    least = solved(ORBITER.mass_flows, rows, target, box)
    moved = np.column_stack([rows, [*[0.0] * 3, *-target[3:]]])
    share = solved(-np.eye(n + 1)[n], moved, np.array([*target[:3], 0, 0, 0]), [*box, (0.0, 1.0)])
    near = np.hstack([rows, np.eye(6), -np.eye(6)])
    distance = solved(np.concatenate([np.zeros(n), WEIGHTS, WEIGHTS]), near, target, [*box, *[(0.0, None)] * 12])
    assert distance is not None
    return Best(None if least is None else least * size, None if share is None else -share, distance)


@pytest.fixture(scope="module")
def program() -> JetSelectionProgram:
    """Used again and again: no answer may depend on what was asked before."""
    return JetSelectionProgram(ORBITER.mass_flows)


def drawn(kind: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """A request and limits."""
    turning = 2e-3 * rng.standard_normal(3)
    if kind == "unlimited":
        spread = 10.0 ** np.repeat([rng.uniform(-6.0, 0.0), rng.uniform(-5.0, 2.0)], 3)  # rad/s and ft/s
        return rng.standard_normal(6) * spread, UNBOUNDED
    if kind == "bounded":
        direction = rng.standard_normal(3)
        return np.append(turning, direction / np.linalg.norm(direction)), BOUNDED
    if kind == "beyond reach":
        return np.append(turning, 3.0 * rng.choice([-1.0, 0.0, 1.0], 3)), BOUNDED
    # six verniers span five dimensions and push down and sideways only
    return np.append(10.0 ** rng.uniform(-5.0, -2.0) * turning / 2e-3, np.zeros(3)), np.where(PRIMARY, 0.0, 20.0)


@pytest.mark.parametrize(
    ("kind", "outcomes"),
    [
        ("unlimited", {Outcome.EXACT}),
        ("bounded", {Outcome.EXACT, Outcome.REDUCED}),
        ("beyond reach", {Outcome.EXACT, Outcome.REDUCED}),
        ("verniers alone", {Outcome.CLOSEST}),
    ],
)
def test_requests_are_met_as_well_and_as_cheaply_as_can_be(
    program: JetSelectionProgram, kind: str, outcomes: set[Outcome]
) -> None:
    rng, seen = np.random.default_rng(8), set()
    for _ in range(30):
        request, limits = drawn(kind, rng)
        found, expected, before = program.solve(ACTIVITY, request, limits), best(request, limits), program.solves
        assert ((found.on_times_s >= 0.0) & (found.on_times_s <= limits)).all()
        # an on-time at its limit comes back through a division and a multiplication: a few units in the last place
        slack = np.where(np.isfinite(limits), 1e-12 * limits, 0.0)
        assert ((found.on_times_s > slack) & (found.on_times_s < limits - slack)).sum() <= 6
        assert_array_equal(found.reached, ACTIVITY @ found.on_times_s)
        assert_allclose(found.propellant, ORBITER.mass_flows @ found.on_times_s, rtol=1e-14)
        size = np.abs(request / ROWS).max()
        seen.add(found.outcome)
        if expected.propellant is not None:
            assert found.outcome == Outcome.EXACT
            assert_allclose(found.propellant, expected.propellant, rtol=1e-9)
            assert np.abs((found.reached - request) / ROWS).max() / size < 1e-9
        elif expected.share is not None:
            assert found.outcome == Outcome.REDUCED
            target = np.append(request[:3], expected.share * request[3:])
            # on the edge of reach Clp's absolute 1e-7, in its own scaling, shows as up to 5e-6 of the request
            assert np.abs((found.reached - target) / ROWS).max() / size < 1e-5
        else:
            assert found.outcome == Outcome.CLOSEST
            # Clp takes a row for met when it misses by 1e-7
            assert_allclose(WEIGHTS @ np.abs((found.reached - request) / ROWS) / size, expected.distance, rtol=1e-7)
        fresh = JetSelectionProgram(ORBITER.mass_flows).solve(ACTIVITY, request, limits)
        assert_array_equal(fresh.on_times_s, found.on_times_s)
        assert program.solves == before
    assert seen == outcomes


def test_few_jets_come_as_close_as_can_be_and_none_fires_nothing(program: JetSelectionProgram) -> None:
    limits, request = np.where(np.isin(np.arange(44), (0, 28)), 2.0, 0.0), np.array([1e-3, -1e-3, 2e-3, 0, 0, 0])
    found = program.solve(ACTIVITY, request, limits)
    distance = WEIGHTS @ np.abs((found.reached - request) / ROWS) / np.abs(request / ROWS).max()
    assert_allclose(distance, best(request, limits).distance, rtol=1e-9)
    for asked, jets, outcome in ((request, np.zeros(44), Outcome.CLOSEST), (np.zeros(6), BOUNDED, Outcome.EXACT)):
        found = program.solve(ACTIVITY, asked, jets)
        assert (found.outcome, found.propellant, found.on_times_s.any(), found.reached.any()) == (
            outcome,
            0,
            False,
            False,
        )


@pytest.mark.parametrize(
    ("request_", "activity", "limits", "words"),
    [
        (np.zeros(6), ACTIVITY[:, :37], BOUNDED, r"activity must have shape \(6, 44\), got \(6, 37\)"),
        (np.zeros(3), ACTIVITY, BOUNDED, r"request must have shape \(6,\), got \(3,\)"),
        (np.zeros(6), ACTIVITY, BOUNDED[:3], r"limits_s must have shape \(44,\), got \(3,\)"),
        (np.array([1e-3, np.nan, 0, 0, 0, 0]), ACTIVITY, BOUNDED, "must be finite"),
        (np.zeros(6), np.where(ACTIVITY > 0.0, np.inf, ACTIVITY), BOUNDED, "must be finite"),
        (np.ones(6), ACTIVITY, np.where(PRIMARY, 2.0, np.nan), "limits_s must be zero or positive"),
        (np.ones(6), ACTIVITY, np.where(PRIMARY, 2.0, -0.1), "limits_s must be zero or positive"),
    ],
)
def test_what_is_no_request_is_refused(request_: Array, activity: Array, limits: Array, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        JetSelectionProgram(ORBITER.mass_flows).solve(activity, request_, limits)
    with pytest.raises(ValueError, match="mass flows must be positive and finite"):
        JetSelectionProgram(np.array([0.1, 0.0, np.nan]))


# ---------------------------------------------------------------------------------------- control authority


def furthest(row: int, sign: float, limits_s: Array) -> float:
    """The reach by HiGHS: on-times as variables, rotations other than the row's held at zero."""
    rows, held = ACTIVITY / ROWS[:, None], [axis for axis in range(3) if axis != row]
    found = solved(-sign * rows[row], rows[held], np.zeros(len(held)), [(0.0, limit) for limit in limits_s])
    assert found is not None
    return -found * ROWS[row]


@pytest.mark.parametrize("row", range(6))
def test_reach_against_highs_whatever_the_body(program: JetSelectionProgram, row: int) -> None:
    rng = np.random.default_rng(1)
    for sign, time_s, share in ((1.0, 1.0, 1.0), (-1.0, 1.0, 0.6), (1.0, 0.08, 0.4), (-1.0, 0.08, 1.0)):
        limits = np.where(PRIMARY & (rng.random(44) < share), time_s, 0.0)
        expected = furthest(row, sign, limits)
        # Clp's absolute tolerance of 1e-7, on numbers of the order of 0.01 to 1 here
        assert_allclose(program.reach(ACTIVITY, row, sign, limits), expected, rtol=1e-5)
        assert_allclose(program.reach(1e-5 * ACTIVITY, row, sign, limits), 1e-5 * expected, rtol=1e-5)
    assert program.reach(ACTIVITY, row, 1.0, np.zeros(44)) == 0.0


def test_reach_is_nothing_where_no_combination_gets(program: JetSelectionProgram) -> None:
    # these five cannot pitch up without rolling or yawing; a reach above zero would keep up the appearance of
    # control and let a needed jet be taken out of use
    limits = np.zeros(44)
    limits[[ORBITER.jet_index(name) for name in ("F1U", "F2D", "L1L", "R1R", "R5R")]] = 1.0
    assert furthest(1, 1.0, limits) < 1e-12
    assert program.reach(ACTIVITY, 1, 1.0, limits) < 1e-6 * program.reach(ACTIVITY, 1, -1.0, np.ones(44))
