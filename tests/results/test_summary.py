"""A summary: typed in memory, JSON on disk, and the same either way; what detections become."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from massprop_drake import InputError, Run
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detector import STATUS, Verdict
from massprop_drake.maths.mass_properties import NAMES, derived
from massprop_drake.results.detections import DetectionRecord, detection_entries, settled
from massprop_drake.results.summary import Parameter, Summary, by_name, from_names, null_for_nan

STUCK_ON = DetectionRecord(
    onset_s=50.0,
    time_s=50.16,
    kind="jet_on",
    cluster=12,
    jet="R4R",
    isolated_to="jet",
    magnitude=868.0,
    magnitude_std=2.0,
    statistic=1.0e4,
    alarms=3,
    jet_index=28,
)


# --------------------------------------------------------------------------------- to JSON and back


def test_it_reads_back_from_its_json(stuck_run: Run) -> None:
    content = json.loads(json.dumps(stuck_run.results.as_json(), allow_nan=False))
    assert content == stuck_run.summary
    again = Summary.from_json(content)
    for field in fields(Summary):
        was, now = getattr(stuck_run.results, field.name), getattr(again, field.name)
        if field.name == "derived":
            for one, other in zip(was, now, strict=True):
                np.testing.assert_array_equal(one, other)
        elif isinstance(was, np.ndarray):
            np.testing.assert_array_equal(was, now, err_msg=field.name)
        else:
            assert was == now, field.name
    assert json.dumps(again.as_json()) == json.dumps(content)  # the order of keys, too


def test_what_is_not_known_is_null_and_back(short_run: Run) -> None:
    unknown = np.full(10, np.nan)
    known = short_run.results
    covariance = np.where(np.eye(10) > 0.0, np.nan, 0.0)
    some = replace(
        known,
        truth=unknown,
        percent_error=unknown,
        covariance=covariance,
        derived=known.derived._replace(mass=None, mass_std=None, inertia=None, inertia_std=None),
        consistency=known.consistency._replace(translation_nis_mean=None),
        data_quality={"rows": 3, "warnings": []},
    )
    content = json.loads(json.dumps(some.as_json(), allow_nan=False))
    assert content["truth"] == {
        "inverse_inertia": [[None] * 3] * 3,
        "center_of_mass": [None] * 3,
        "mass_reciprocal": None,
    }
    assert content["covariance"][0][:2] == [None, 0.0]
    assert content["derived"]["inertia"] is None
    assert list(content)[-1] == "data_quality"
    again = Summary.from_json(content)
    np.testing.assert_array_equal(again.truth, unknown)
    np.testing.assert_array_equal(again.covariance, covariance)
    assert again.derived.mass is None
    assert again.derived.inertia is None
    assert again.data_quality == {"rows": 3, "warnings": []}


def test_an_impossible_inertia_comes_with_the_nearest_possible_one(stuck_run: Run) -> None:
    known = stuck_run.results
    assert known.derived.physically_possible
    assert known.nearest_possible is None
    assert known.as_json()["derived"]["nearest_possible"] is None
    estimates = known.estimates.copy()
    estimates[:6] = [1.0, 0.5, 1.0 / 3.3, 0.0, 0.0, 0.0]
    covariance = np.diag(np.append(np.full(6, 1e-2), np.full(4, 1e-6)))
    wrong = replace(known, estimates=estimates, covariance=covariance, derived=derived(estimates, covariance))
    stored = wrong.as_json()["derived"]
    assert stored["physically_possible"] is False
    assert derived(from_names(stored["nearest_possible"]), covariance).physically_possible
    assert wrong.nearest_possible is wrong.nearest_possible  # sought once
    assert known.impossible == ""
    said = "no rigid body can have the inertia that was estimated"
    assert wrong.impossible == f"{said}; the nearest that one can have is in summary.json"
    estimates = estimates.copy()
    estimates[2] = -0.1  # beyond mending
    beyond = replace(wrong, estimates=estimates)
    assert beyond.as_json()["derived"]["nearest_possible"] is None
    assert beyond.impossible == said
    unknown = replace(wrong, derived=wrong.derived._replace(inertia=None))
    assert unknown.impossible == ""  # nothing has been estimated


def test_a_run_without_a_record_has_nothing_of_one(short_run: Run) -> None:
    content = short_run.results.as_json()
    assert "data_quality" not in content
    assert list(content["provenance"]) == ["drake", "numpy", "vehicle_sha256", "scenario_sha256", "engine"]


def test_a_summary_of_version_0_1_0_is_read(short_run: Run) -> None:
    # it knew no failures, so nothing of jets out of use and control authority
    content = json.loads(json.dumps(short_run.summary))
    for key in ("jets_out_of_use", "jets_left_in", "control_authority"):
        del content["autopilot"][key]
    old = Summary.from_json(content)
    assert old.autopilot.firings == short_run.results.autopilot.firings
    assert old.autopilot.jets_out_of_use is None
    assert old.as_json()["autopilot"]["control_authority"] is None


def test_keys_of_a_later_version_are_passed_over(short_run: Run) -> None:
    content = {**short_run.summary, "unheard_of": 1, "timing": {**short_run.summary["timing"], "later": 2}}
    assert Summary.from_json(content).as_json() == short_run.summary


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 7}, "format: input should be less than or equal to 1, got 7"),
        ({"derived": {}}, "derived.mass: missing"),
        ({"consistency": {"samples": 3}}, "consistency.rotation_nis_mean: missing"),
        (
            {"estimates": {"inverse_inertia": [[1.0]], "center_of_mass": [], "mass_reciprocal": 1.0}},
            r"estimates.inverse_inertia\[0\]: must have 3 values, got 1",
        ),
        ({"detections": 3}, "detections: input should be a valid list"),
        ({"covariance": [[1.0], [1.0, 2.0]]}, r"covariance\[0\]: must have 10 values, got 1"),
        ({"duration_s": -1.0}, "duration_s: input should be greater than or equal to 0"),
        ({"duration_s": math.nan}, "duration_s: input should be a finite number"),
        ({"duration_s": True}, "duration_s: input should be a valid number"),
        ({"seed": 10**400}, "seed: "),
        ({"data_quality": {"warnings": [3]}}, "data_quality: warnings: must be a list of text"),
    ],
)
def test_what_is_no_summary_is_refused(short_run: Run, change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"the summary: {words}"):
        Summary.from_json({**short_run.summary, **change})


@pytest.mark.parametrize("content", [{}, [], "text", None])
def test_other_json_is_refused(content: Any) -> None:
    with pytest.raises(InputError, match="the summary"):
        Summary.from_json(content)


def test_arrays_with_missing_numbers_are_null_and_back() -> None:
    parameters = np.array([1.0, 2.0, 3.0, np.nan, 5.0, 6.0, 7.0, 8.0, np.nan, 10.0])
    named = by_name(parameters)
    assert named == {
        "inverse_inertia": [[1.0, 6.0, 5.0], [6.0, 2.0, None], [5.0, None, 3.0]],
        "center_of_mass": [7.0, 8.0, None],
        "mass_reciprocal": 10.0,
    }
    np.testing.assert_array_equal(from_names(named), parameters)
    assert null_for_nan(np.array([[1.0, np.nan], [-0.0, 2.5]])) == [[1.0, None], [0.0, 2.5]]


# ------------------------------------------------------------------------------------- parameters


def test_the_parameters_stand_by_name(short_run: Run) -> None:
    results = short_run.results
    assert tuple(one.name for one in results.parameters) == NAMES
    ninth = results.parameters[8]
    assert ninth == Parameter(
        "z_cm", results.estimates[8], results.standard_deviations[8], results.truth[8], results.percent_error[8]
    )
    np.testing.assert_array_equal(short_run.covariance, results.covariance)


@pytest.mark.parametrize(
    ("estimate", "inside"), [(2.0, True), (2.299, True), (1.701, True), (2.301, False), (np.nan, False)]
)
def test_within_three_sigma(estimate: float, inside: bool) -> None:
    assert Parameter("x_cm", estimate, 0.1, 2.0, np.nan).within_three_sigma is inside


# ------------------------------------------------------------------------------------- detections


def _signals(n_rows: int, **rows: dict[int, float]) -> dict[str, Any]:
    """Signals of a detector that are zero but at some rows."""
    signals = {name: np.zeros((n_rows, 1)) for name in (*STATUS, "rotation_nis")}
    for name, values in rows.items():
        for row, value in values.items():
            signals[name][row] = value
    return signals


@pytest.mark.parametrize(
    ("magnitude", "std", "kind", "mode"),
    [
        (10.0, 1.0, "jet_on", "leak"),
        (870.0, 1.0, "jet_on", "stuck_on"),
        (-870.0, 1.0, "jet_off", "stuck_off"),
        (-800.0, 1.0, "jet_off", "stuck_off"),  # above 90 % of 870
        (-700.0, 60.0, "jet_off", "stuck_off"),  # within 3 sigma of it
        (-700.0, 50.0, "jet_degraded", "loss"),
    ],
)
def test_kind_and_mode_follow_from_the_force(
    orbiter: Vehicle, magnitude: float, std: float, kind: str, mode: str
) -> None:
    jet = orbiter.jet_index("R4R")
    signals = _signals(
        3,
        detector_event={1: float(Verdict.DECLARED)},
        suspected_jet={1: float(jet)},
        jet_isolated={1: 1.0},
        suspected_magnitude={1: magnitude},
        suspected_magnitude_std={1: std},
        suspected_likelihood={1: 77.0},
        onset={1: 0.04},
        alarms={1: 2.0},
    )
    (record,) = detection_entries(orbiter, np.array([0.0, 0.08, 0.16]), signals)
    assert orbiter.jets[jet].thrust == pytest.approx(870.0, abs=2.0)
    assert record == DetectionRecord(
        onset_s=0.04,
        time_s=0.08,
        kind=kind,
        cluster=12,
        jet="R4R",
        isolated_to="jet",
        magnitude=magnitude,
        magnitude_std=std,
        statistic=77.0,
        alarms=2,
        jets=("R4R",),
        thrust=orbiter.jets[jet].thrust,
        mode=mode,
        jet_index=jet,
    )


def test_a_jet_that_is_not_isolated_is_named_by_its_cluster(orbiter: Vehicle) -> None:
    signals = _signals(2, detector_event={0: float(Verdict.DECLARED)}, suspected_jet={0: 28.0})
    (record,) = detection_entries(orbiter, np.zeros(2), signals)
    assert (record.cluster, record.jet, record.isolated_to, record.jet_index) == (12, None, "cluster", 28)


def test_a_jump_has_no_jet_and_the_nis_for_a_statistic(orbiter: Vehicle) -> None:
    signals = _signals(2, detector_event={1: float(Verdict.JUMP)}, rotation_nis={1: 99.0}, alarms={1: 4.0})
    (record,) = detection_entries(orbiter, np.array([0.0, 0.08]), signals)
    assert (record.kind, record.cluster, record.jet, record.magnitude) == ("mass_property_jump", None, None, None)
    assert (record.statistic, record.alarms, record.jet_index) == (99.0, 4, None)


def test_a_withdrawal_marks_the_standing_declaration_of_its_jet(orbiter: Vehicle) -> None:
    other = STUCK_ON._replace(jet="F2R", jet_index=3)
    before = STUCK_ON._replace(withdrawn_s=51.0)
    signals = _signals(2, detector_event={1: float(Verdict.WITHDRAWN)}, suspected_jet={1: 28.0})
    records = detection_entries(orbiter, np.array([52.0, 52.08]), signals, (before, other, STUCK_ON))
    assert records == [before, other, STUCK_ON._replace(withdrawn_s=52.08)]


def test_without_a_detector_nothing_is_added(orbiter: Vehicle) -> None:
    assert detection_entries(orbiter, np.zeros(2), {}, (STUCK_ON,)) == [STUCK_ON]


def test_the_force_of_a_jet_stuck_on_is_given_as_known_at_the_end() -> None:
    force, variance = np.zeros(44), np.zeros(44)
    force[28], variance[28] = 870.5, 0.25
    off = STUCK_ON._replace(kind="jet_off", magnitude=-870.0)
    jump = STUCK_ON._replace(kind="mass_property_jump", jet_index=None)
    followed, left, there = settled((STUCK_ON, off, jump), force, variance)
    assert (followed.magnitude, followed.magnitude_std) == (870.5, 0.5)
    assert left.magnitude == -870.0
    assert there == jump
    assert {record.jet_index for record in (followed, left, there)} == {None}
    (unknown,) = settled((STUCK_ON,), force, np.zeros(44))
    assert unknown.magnitude == 868.0
    (withdrawn,) = settled((STUCK_ON._replace(withdrawn_s=51.0),), force, variance)
    assert withdrawn.magnitude == 868.0  # that it had while it stood
