"""Distances of a course from its aims, against sums that are done by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from massprop_drake.maths.maneuver.aims import Aims, Known, compare_with_aims

NOBODY = np.zeros((0, 2), dtype=int), np.zeros(0), np.zeros(0)
PAIRS = np.array([[0, 1], [1, 0], [0, -1]])


def test_deviations_are_those_of_the_inverse() -> None:
    random = np.random.default_rng(1)
    rows = random.standard_normal((9, 6)) * np.array([1.0, 1e3, 1e-3, 1.0, 1.0, 1.0])
    shown = rows.T @ rows
    known = Known(np.diag([1e-2, 1e2, 1e-8]), np.array([0, 1, 2]))  # three of four parameters, and two jets
    aims = Aims(np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 2.0, 1.0, 7.0]]), np.array([1.0, 2.0]), *NOBODY, np.zeros(0))
    found = compare_with_aims(shown, known, aims)
    covariance = np.linalg.inv(known.information + shown[:3, :3])
    expected = [math.sqrt(row[:3] @ covariance @ row[:3]) for row in aims.combinations]
    np.testing.assert_allclose(found.deviations, expected, rtol=1e-9)
    np.testing.assert_allclose(found.ratios, np.array(expected) / aims.deviations, rtol=1e-9)
    assert found.shortfall == pytest.approx(sum(max(0.0, math.log(ratio)) for ratio in found.ratios))


@pytest.mark.parametrize("alike", [True, False])
def test_two_suspects_differ_by_what_the_rest_leaves(alike: bool) -> None:
    """One parameter that is free, and two jets: the likelihood ratio of the best fits, by least squares.

    A jet that would have to give less than nothing explains nothing.
    """
    random = np.random.default_rng(2)
    rows = 4.0 * random.standard_normal((8, 3))
    rows[:, 2] *= -1.0 if alike else 1.0
    known = Known(np.array([[0.3]]), np.array([0]))
    aims = Aims(np.zeros((0, 1)), np.zeros(0), PAIRS, np.array([0.7] * 3), np.full(3, 5.0), np.full(3, 4.0))
    found = compare_with_aims(rows.T @ rows, known, aims)

    def misfit(columns: list[int], data: np.ndarray) -> float:
        prior = [[math.sqrt(0.3) if column == 0 else 0.0 for column in columns]]
        table = np.vstack((rows[:, columns], prior))
        left = np.append(data, 0.0)
        best = np.linalg.lstsq(table, left, rcond=None)[0]
        return float(np.sum((left - table @ best) ** 2))

    for place, (own, other) in enumerate(((1, 2), (2, 1))):
        data = 0.7 * rows[:, own]
        expected = 0.5 * (misfit([0, other] if alike else [0], data) - misfit([0, own], data))
        assert found.deltas[place] == pytest.approx(expected, rel=1e-9)
    left = misfit([0], rows[:, 1])  # of a unit of the first force, where nothing fails
    assert found.deltas[2] == pytest.approx(0.5 * 0.49 * left - 0.5 * math.log1p(25.0 * left), rel=1e-9)
    np.testing.assert_allclose(found.ratios, np.sqrt(4.0 / found.deltas))


def test_a_jump_is_worth_what_its_evidence_says() -> None:
    """Against densities of the readings, of both sizes of a jump together."""
    random = np.random.default_rng(3)
    rows, units = random.standard_normal((9, 2)), 0.3 * random.standard_normal((9, 10))
    every = np.hstack((rows, units))
    aims = Aims(np.zeros((0, 0)), np.zeros(0), np.array([[1, -1]]), np.array([0.7]), np.full(1, 5.0), np.full(1, 4.0))
    known = Known(np.zeros((0, 0)), np.zeros(0, dtype=int))
    without = compare_with_aims(every.T @ every, known, aims).deltas.item()
    found = compare_with_aims(
        every.T @ every, known, aims._replace(jumps=np.array([np.ones(10), np.full(10, 0.04)]), jump=-0.5)
    ).deltas.item()
    data, leads = 0.7 * rows[:, 1], []
    for unit in (units, 0.2 * units):
        spread = np.eye(9) + unit @ unit.T
        ahead = 0.5 * data @ data - 0.5 * data @ np.linalg.solve(spread, data) - 0.5 * np.linalg.slogdet(spread)[1]
        leads.append(math.exp(-0.5 + ahead))
    assert found == pytest.approx(without - math.log(1.0 + sum(leads)), rel=1e-9)
    assert sum(leads) > 0.01
