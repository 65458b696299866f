"""A summary: typed in memory, JSON on disk, and the same either way."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from massprop_drake import InputError, Run
from massprop_drake.maths import mass_properties
from massprop_drake.maths.mass_properties import NAMES, derive_mass_and_inertia
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.results import table
from massprop_drake.results.json_arrays import parameters_from_names
from massprop_drake.results.summary import Parameter, Summary


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
    later = {**content, "unheard_of": 1, "timing": {**content["timing"], "later": 2}}  # passed over
    for key in ("jets_out_of_use", "jets_left_in", "control_authority"):  # of version 0.1.0, which knew no failures
        del later["autopilot"][key]
    old = Summary.from_json(later).as_json()
    assert (old["autopilot"]["firings"], old["autopilot"]["control_authority"]) == (
        content["autopilot"]["firings"],
        None,
    )
    assert list(old) == list(content)


def test_what_is_not_known_is_null_and_back(short_run: Run) -> None:
    unknown, known = np.full(10, np.nan), short_run.results
    assert "data_quality" not in known.as_json()
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
    nothing = {"inverse_inertia": [[None] * 3] * 3, "center_of_mass": [None] * 3, "mass_reciprocal": None}
    assert content["truth"] == nothing
    assert content["covariance"][0][:2] == [None, 0.0]
    assert content["derived"]["inertia"] is None
    assert list(content)[-1] == "data_quality"
    again = Summary.from_json(content)
    np.testing.assert_array_equal(again.truth, unknown)
    np.testing.assert_array_equal(again.covariance, covariance)
    assert (again.derived.mass, again.derived.inertia) == (None, None)
    assert again.data_quality == {"rows": 3, "warnings": []}


def test_an_impossible_inertia_comes_with_the_nearest_possible_one(stuck_run: Run) -> None:
    known = stuck_run.results
    assert known.derived.physically_possible
    assert known.as_json()["derived"]["nearest_possible"] is None
    estimates = known.estimates.copy()
    estimates[:6] = [1.0, 0.5, 1.0 / 3.3, 0.0, 0.0, 0.0]
    covariance = np.diag(np.append(np.full(6, 1e-2), np.full(4, 1e-6)))
    wrong = replace(
        known, estimates=estimates, covariance=covariance, derived=derive_mass_and_inertia(estimates, covariance)
    )
    stored = wrong.as_json()["derived"]
    assert stored["physically_possible"] is False
    assert derive_mass_and_inertia(parameters_from_names(stored["nearest_possible"]), covariance).physically_possible
    said = "no rigid body can have the inertia that was estimated"
    near = f"{said}; the nearest that one can have is in summary.json"
    estimates = estimates.copy()
    estimates[2] = -0.1  # beyond mending
    beyond = replace(wrong, estimates=estimates)
    assert beyond.as_json()["derived"]["nearest_possible"] is None
    unknown = replace(wrong, derived=wrong.derived._replace(inertia=None))  # nothing has been estimated
    assert [one.impossible for one in (known, wrong, beyond, unknown)] == ["", near, said, ""]


ESTIMATES = {"inverse_inertia": [[1.0]], "center_of_mass": [], "mass_reciprocal": 1.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 7}, "format: input should be less than or equal to 1, got 7"),
        ({"derived": {}}, "derived.mass: missing"),
        ({"estimates": ESTIMATES}, r"estimates.inverse_inertia\[0\]: must have 3 values, got 1"),
        ({"detections": 3}, "detections: input should be a valid list"),
        ({"covariance": [[1.0], [1.0, 2.0]]}, r"covariance\[0\]: must have 10 values, got 1"),
        ({"duration_s": -1.0}, "duration_s: input should be greater than or equal to 0"),
        ({"duration_s": math.nan}, "duration_s: input should be a finite number"),
        ({"duration_s": True}, "duration_s: input should be a valid number"),
        ({"data_quality": {"warnings": [3]}}, "data_quality: warnings: must be a list of text"),
        (None, ""),
    ],
)
def test_what_is_no_summary_is_refused(short_run: Run, change: dict[str, Any] | None, words: str) -> None:
    with pytest.raises(InputError, match=f"the summary: {words}"):
        Summary.from_json([] if change is None else {**short_run.summary, **change})


def test_the_parameters_stand_by_name(short_run: Run) -> None:
    results = short_run.results
    assert tuple(one.name for one in results.parameters) == NAMES
    columns = (results.estimates, results.standard_deviations, results.truth, results.percent_error)
    assert results.parameters[8] == Parameter("z_cm", *(column[8] for column in columns))
    for estimate, inside in ((2.299, True), (1.701, True), (2.301, False), (1.699, False), (math.nan, False)):
        assert Parameter("x_cm", estimate, 0.1, 2.0, math.nan).within_three_sigma is inside


def test_no_percentage_refers_to_what_is_as_good_as_zero(short_run: Run) -> None:
    """Products of the truth and of the estimate, and a center that rounding has left at the origin."""
    known, units = short_run.results, short_run.scenario.vehicle_data.unit_names
    zero = np.where(np.isin(np.arange(10), range(3, 9)), 1e-13 * known.truth[1], known.truth)
    for name, column in (("truth", 4), ("estimates", 6)):  # of a row its error, or its 1-sigma, in percent
        error = mass_properties.percent_error(*(zero if one == name else known.truth for one in ("estimates", "truth")))
        results = replace(known, **{name: zero, "percent_error": error})
        results = replace(results, derived=derive_mass_and_inertia(results.estimates, results.covariance))
        rows = [row for part in table.property_rows(results, units) for row in part]
        dashed = {row.symbol for row in rows if row[column] == "-"}
        assert dashed == {row.symbol for row in rows} - {"m", "Ixx", "Iyy", "Izz", *SYMBOLS[:3], "1/m"}
