"""Figures of merit from rows whose figures are plain."""

from __future__ import annotations

import math
from typing import Any

import pytest
from campaign_rows import declaration, failure, jump, lost, many, row

from massprop_drake.inputs.campaign_file import Gate
from massprop_drake.studies.campaign import merit
from massprop_drake.studies.campaign.statistics import Figure

MINUTE_H = 1.0 / 60.0


def test_each_cause_is_counted_over_the_time_in_which_it_could_be_one() -> None:
    rows = [
        row(0, [failure(acted_s=45.0)], [declaration("F1U", 10.0, "healthy"), declaration("F1U", 50.0, "failure")]),
        row(1, [failure(None, kind="dock", acted_s=30.0)], [declaration("F1U", 40.0, "jump")]),
        row(2, [failure(outcome="never_acted")], [declaration("F1U", 59.0, "healthy")]),
        lost(3, "too slow"),
    ]
    found = merit.figures(rows)
    assert found["false_declarations_per_hour"].value == pytest.approx(4 / (3 * MINUTE_H))
    hours = {cause: found[f"false_declarations_per_hour_{cause}"].n * 60 for cause in merit.CAUSES}
    assert hours == pytest.approx({"healthy": 0.75 + 0.5 + 1.0, "failure": 0.25, "jump": 0.5})
    assert found["false_declarations_per_hour_failure"].value == pytest.approx(1 / (0.25 * MINUTE_H))
    assert found["false_declarations_in_case"][::3] == (1.0, 3)
    assert found["failed_to_run"][::3] == (0.25, 4)


def test_what_never_acted_is_in_no_figure_and_what_was_not_tested_is() -> None:
    outcomes = ("named", "group", "wrong", "missed", "not_tested", "never_acted")
    rows = [row(case, [failure(outcome=outcome)]) for case, outcome in enumerate(outcomes)]
    found = merit.figures(rows)
    assert found["isolated"][::3] == (0.4, 5)
    assert found["named"][::3] == (0.2, 5)
    assert found["wrong"].value == found["missed"].value == found["not_tested"].value == 0.2
    assert found["found_within_1_s"].value == pytest.approx(0.4)
    assert merit.count_outcomes(rows) == {"stuck_on": dict.fromkeys(outcomes, 1)}


def test_delays_count_from_the_first_effect_and_end_with_the_flight() -> None:
    rows = [
        row(0, [failure(acted_s=20.0, declared_s=22.0)]),
        row(1, [failure(acted_s=30.0, declared_s=36.0)]),
        row(2, [failure(outcome="missed", acted_s=40.0)]),
    ]
    found = merit.figures(rows)
    assert found["found_within_1_s"].value == 0.0
    assert found["found_within_5_s"].value == pytest.approx(1 / 3)
    assert math.isnan(found["found_within_30_s"].value)  # nobody was watched for longer than 20 s
    assert found["found_within_30_s"].low == pytest.approx(merit.detection_curve(merit.events(rows)).low[-1])
    assert found["delay_50_percent_s"].value == pytest.approx(6.0)
    assert math.isnan(found["delay_90_percent_s"].value)


@pytest.mark.parametrize(
    ("gate", "passes"),
    [
        ({"max": 0.2}, True), ({"min": 0.2}, False), ({"min": 0.05, "max": 0.15}, True),
        ({"max": 0.2, "on": "upper_bound"}, False), ({"min": 0.04, "on": "lower_bound"}, True),
    ],
)  # fmt: skip
def test_a_gate_looks_at_the_figure_or_at_a_bound(gate: dict[str, Any], passes: bool) -> None:
    (found,) = merit.judge_gates({"wrong": Gate(**gate)}, {"wrong": Figure(0.1, 0.04, 0.3, 20)})
    assert found.passes is passes


def test_the_confusion_knows_jets_clusters_and_jumps() -> None:
    rows = [
        row(0, [failure("R4R", "named")]),
        row(1, [failure("R4R", "group")]),
        row(2, [failure("R4R", "wrong", taken_for="F1U")]),
        row(3, [failure("R4R", "wrong", taken_for="cluster 9")]),
        row(4, [failure("R4R", "wrong", taken_for="mass_property_jump")]),
        row(5, [failure("F1U", "missed")]),
        row(6, [failure("F1U", "not_tested")]),
        row(7, [failure(None, "wrong", kind="dock", taken_for="F1U")]),
        row(8, [failure(None, "named", kind="dock")]),
    ]
    counts = merit.confusion([*merit.events(rows), *merit.events(rows, payloads=True)])
    assert counts == {
        ("R4R", "R4R"): 1, ("R4R", "its cluster"): 1, ("R4R", "F1U"): 1, ("R4R", "cluster 9"): 1, ("R4R", "jump"): 1,
        ("F1U", "not found"): 1, ("F1U", "not tested"): 1, ("jump", "F1U"): 1, ("jump", "jump"): 1,
    }  # fmt: skip
    merged = merit.sum_by_cluster(counts, {"R4R": 5, "F1U": 9})
    assert merged["cluster 5", "cluster 5"] == 2
    assert merged["cluster 5", "cluster 9"] == 2
    assert merged["jump", "cluster 9"] == 1
    assert sum(merged.values()) == sum(counts.values())


def test_a_higher_threshold_strikes_out_what_is_below_it() -> None:
    rows = [
        row(0, [failure()], [declaration(statistic=40.0), declaration("F1U", 10.0, "healthy", statistic=15.0)]),
        row(1, [failure()], [declaration(statistic=25.0), jump(50.0, "failure")]),
    ]
    curve = {point.setting: point for point in merit.operating_curve(rows)}
    assert list(curve) == [15.0, 25.0, 40.0]
    assert [point.found.value for point in curve.values()] == [1.0, 1.0, 0.5]
    assert [point.delay_s.value for point in curve.values()] == pytest.approx([0.5, 0.5, 0.5])
    # the jump has another statistic and is no declaration of a jet
    assert [point.false_per_hour.value for point in curve.values()] == pytest.approx([30.0, 0.0, 0.0])


def test_sensitivity_leaves_out_what_is_no_number() -> None:
    rows = [{**row(n, z=n - 4.0), "draw.size": 2.0 * n, "draw.jet": "R4R", "draw.same": 1.0} for n in range(9)]
    found = merit.sensitivity(rows, ["size", "jet", "same"], absolute=False)
    assert list(found["m_inv"]) == ["size"]
    assert found["m_inv"]["size"].value == pytest.approx(1.0)
    # the error's size is the same on both sides of the middle
    assert merit.sensitivity(rows, ["size"], absolute=True)["m_inv"]["size"].value == pytest.approx(0.0, abs=1e-12)


def test_sobol_indices_need_every_case() -> None:
    rows = many(1, 8)
    assert merit.sobol([*rows, lost(8, "crashed")], 2) is None
    found = merit.sobol(rows, 2)
    assert found is not None
    assert (len(found[0]), len(found[1].total[0])) == (10, 2)
