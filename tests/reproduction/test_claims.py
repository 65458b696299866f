"""Verdicts follow from how the measured values lie over the phases."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from reproduction.claims import (
    AtLeast,
    AtMost,
    Because,
    Between,
    Claim,
    Expectation,
    Near,
    Printed,
    Reading,
    Verdict,
    decide,
    judge,
)

TWENTY = np.arange(1.0, 21.0)
HOLDS, SPREAD, DIFFERS = Verdict.HOLDS, Verdict.SPREAD, Verdict.DIFFERS


def phases(values: Any) -> list[Any]:
    return [{"case": {"x": np.array([value])}} for value in values]


def of_one(phase: Any) -> float:
    return float(phase["case"]["x"][0])


def claim(expect: Expectation, **others: Any) -> Claim:
    return Claim(1, "text", "thesis", expect, others.pop("measure", of_one), **others)


@pytest.mark.parametrize(
    ("expect", "verdict", "share"),
    [
        (AtMost(20.0), HOLDS, 1.0),
        (AtMost(19.0), HOLDS, 0.95),
        (AtMost(18.9), SPREAD, 0.9),
        (AtMost(10.0), SPREAD, 0.5),  # half of the phases are asked for, and no fewer
        (AtMost(9.9), DIFFERS, 0.45),
        (AtLeast(2.0), HOLDS, 0.95),
        (AtLeast(2.1), SPREAD, 0.9),
        (AtLeast(11.1), DIFFERS, 0.45),
        (Between(5.0, 14.0), SPREAD, 0.5),
        (Between(5.0, 13.0), DIFFERS, 0.45),
        (Reading(AtLeast(12.0), "many: more than eleven"), DIFFERS, 0.45),
        (Near(5.0, 0.5), DIFFERS, 0.05),
        (Near(5.5, 0.4), DIFFERS, 0.0),
        # the central 95 % of 1 .. 20 is 1.475 to 19.525
        (Printed(1.5), SPREAD, 0.05),
        (Printed(10.0), SPREAD, 0.475),
        (Printed(1.4), DIFFERS, 0.05),
        (Printed(19.6), DIFFERS, 0.95),
    ],
)
def test_verdict(expect: Expectation, verdict: Verdict, share: float) -> None:
    assert decide(expect, TWENTY) == (verdict, pytest.approx(share))


def test_what_could_not_be_measured_meets_nothing() -> None:
    values = np.append(TWENTY[:-3], [np.nan] * 3)
    for expect in (AtMost(100.0), AtLeast(0.0), Between(0.0, 100.0), Near(0.0, 100.0)):
        assert decide(expect, values) == (SPREAD, pytest.approx(0.85))
    assert decide(Printed(10.0), values)[0] is DIFFERS


@pytest.mark.parametrize(
    ("expect", "unit", "values", "expected", "measured"),
    [
        (Reading(Between(1, 2), "minor: at most double"), "s", [2.0], "1 to 2 s (minor: at most double)", "2 s"),
        (Printed(15.0), "%", TWENTY, "15 %", "10.5 % (1.48 to 19.5), thesis at 72 %"),
        (AtMost(15.0), "", TWENTY, "≤ 15", "10.5 (1.48 to 19.5), met in 75 %"),
        (AtMost(50.0), "", TWENTY, "≤ 50", "10.5 (1.48 to 19.5)"),
        (AtMost(30.0), "", [*TWENTY[:-1], np.inf], "≤ 30", "10.5 (1 to inf), met in 95 %"),
        (AtMost(30.0), "", [np.inf] * 3, "≤ 30", "inf"),
    ],
)
def test_bound_median_spread_and_place_are_said(
    expect: Expectation, unit: str, values: list[float], expected: str, measured: str
) -> None:
    outcome = judge(claim(expect, unit=unit), phases(values))
    assert (outcome.claim.expected, outcome.measured) == (expected, measured)


def test_only_a_difference_is_explained_by_what_is_measured() -> None:
    because = Because("it is {:.1f}", (lambda phase: 2.0 * of_one(phase),))
    said = [judge(claim(AtMost(limit), because=because), phases(TWENTY)).why for limit in (0.5, 10.0)]
    assert said == ["it is 21.0", ""]


def test_a_pooled_claim_has_the_spread_of_drawing_phases_anew() -> None:
    def mean(some: Any) -> float:
        return float(np.mean([of_one(phase) for phase in some]))

    outcome, again = (judge(claim(Between(8, 13), measure=mean, pooled=True), phases(TWENTY)) for _ in range(2))
    assert (outcome.center, outcome.verdict) == (10.5, HOLDS)
    # standard error of the mean of 20 values of standard deviation 5.77
    assert outcome.values.std() == pytest.approx(5.77 / np.sqrt(20.0), rel=0.15)
    np.testing.assert_array_equal(outcome.values, again.values)
    # the first of phases drawn anew is any of the twenty: it is judged by the same half
    first = [claim(AtMost(limit), measure=lambda some: of_one(some[0]), pooled=True) for limit in (13.0, 7.0)]
    assert [judge(one, phases(TWENTY)).verdict for one in first] == [SPREAD, DIFFERS]
