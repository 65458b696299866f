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
    number,
)

TWENTY = np.arange(1.0, 21.0)


def phases(values: Any) -> list[Any]:
    return [{"case": {"x": np.array([value])}} for value in values]


def claim(expect: Expectation, **others: Any) -> Claim:
    return Claim(1, "text", "thesis", expect, lambda phase: float(phase["case"]["x"][0]), **others)


@pytest.mark.parametrize(
    ("expect", "verdict", "share"),
    [
        (AtMost(20.0), Verdict.HOLDS, 1.0),
        (AtMost(19.0), Verdict.HOLDS, 0.95),
        (AtMost(18.9), Verdict.SPREAD, 0.9),
        (AtMost(10.0), Verdict.SPREAD, 0.5),  # half of the phases are asked for, and no fewer
        (AtMost(9.9), Verdict.DIFFERS, 0.45),
        (AtMost(1.0), Verdict.DIFFERS, 0.05),
        (AtLeast(2.0), Verdict.HOLDS, 0.95),
        (AtLeast(2.1), Verdict.SPREAD, 0.9),
        (AtLeast(11.0), Verdict.SPREAD, 0.5),
        (AtLeast(11.1), Verdict.DIFFERS, 0.45),
        (Between(5.0, 14.0), Verdict.SPREAD, 0.5),
        (Between(5.0, 13.0), Verdict.DIFFERS, 0.45),
        (Reading(AtLeast(11.0), "many: more than ten"), Verdict.SPREAD, 0.5),
        (Reading(AtLeast(12.0), "many: more than eleven"), Verdict.DIFFERS, 0.45),
        (Near(5.0, 0.5), Verdict.DIFFERS, 0.05),
        (Near(5.5, 0.4), Verdict.DIFFERS, 0.0),
        # the central 95 % of 1 .. 20 is 1.475 to 19.525
        (Printed(1.5), Verdict.SPREAD, 0.05),
        (Printed(10.0), Verdict.SPREAD, 0.475),
        (Printed(19.5), Verdict.SPREAD, 0.95),
        (Printed(1.4), Verdict.DIFFERS, 0.05),
        (Printed(19.6), Verdict.DIFFERS, 0.95),
    ],
)
def test_verdict(expect: Expectation, verdict: Verdict, share: float) -> None:
    assert decide(expect, TWENTY) == (verdict, pytest.approx(share))


def test_what_could_not_be_measured_meets_nothing() -> None:
    values = np.append(TWENTY[:-3], [np.nan] * 3)
    for expect in (AtMost(100.0), AtLeast(0.0), Between(0.0, 100.0), Near(0.0, 100.0)):
        assert decide(expect, values) == (Verdict.SPREAD, pytest.approx(0.85))
    assert decide(Printed(10.0), values)[0] is Verdict.DIFFERS


def test_a_pooled_claim_is_judged_by_the_same_half() -> None:
    def first(some: Any) -> float:
        return float(some[0]["case"]["x"][0])

    # the first of phases drawn anew is any of the twenty
    outcomes = [judge(Claim(1, "", "", AtMost(limit), first, pooled=True), phases(TWENTY)) for limit in (13.0, 7.0)]
    assert [outcome.verdict for outcome in outcomes] == [Verdict.SPREAD, Verdict.DIFFERS]


def test_how_words_are_read_stands_beside_the_bound() -> None:
    reading = Reading(Between(1.0, 2.0), "minor: at most double")
    assert claim(reading, unit="s").expected == "1 to 2 s (minor: at most double)"
    assert claim(AtMost(2.0), unit="lbf").expected == "≤ 2 lbf"
    assert claim(Printed(3.0)).expected == "3"


def test_measured_gives_median_spread_and_place() -> None:
    assert judge(claim(Printed(15.0), unit="%"), phases(TWENTY)).measured == "10.5 % (1.48 to 19.5), thesis at 72 %"
    assert judge(claim(AtMost(15.0)), phases(TWENTY)).measured == "10.5 (1.48 to 19.5), met in 75 %"
    assert judge(claim(AtMost(50.0)), phases(TWENTY)).measured == "10.5 (1.48 to 19.5)"
    assert judge(claim(AtMost(50.0), unit="s"), phases([2.0])).measured == "2 s"


def test_a_phase_without_a_value_is_shown_as_such() -> None:
    outcome = judge(claim(AtMost(30.0)), phases([*TWENTY[:-1], np.inf]))
    assert outcome.measured == "10.5 (1 to inf), met in 95 %"
    assert outcome.verdict is Verdict.HOLDS
    assert judge(claim(AtMost(30.0)), phases([np.inf] * 3)).measured == "inf"


def test_only_a_difference_is_explained_by_what_is_measured() -> None:
    because = Because("it is {:.1f}", (lambda phase: 2.0 * float(phase["case"]["x"][0]),))
    assert judge(claim(AtMost(0.5), because=because), phases(TWENTY)).why == "it is 21.0"
    assert judge(claim(AtMost(10.0), because=because), phases(TWENTY)).why == ""


def test_a_pooled_claim_has_the_spread_of_drawing_phases_anew() -> None:
    def mean(some: Any) -> float:
        return float(np.mean([phase["case"]["x"][0] for phase in some]))

    outcome = judge(Claim(1, "", "", Between(8.0, 13.0), mean, pooled=True), phases(TWENTY))
    assert outcome.center == 10.5
    # standard error of the mean of 20 values of standard deviation 5.77
    assert outcome.values.std() == pytest.approx(5.77 / np.sqrt(20.0), rel=0.15)
    assert outcome.verdict is Verdict.HOLDS
    again = judge(Claim(1, "", "", Between(8.0, 13.0), mean, pooled=True), phases(TWENTY))
    np.testing.assert_array_equal(outcome.values, again.values)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.0123456, "0.0123"), (289.4, "289"), (1938.4, "1938"), (17804.0, "1.78e4"), (-4.5e-7, "-4.5e-7")],
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text
