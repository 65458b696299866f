"""What a run says of each parameter: as well as it is known, and what would show it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from massprop_drake import Run, load_scenario, load_vehicle
from massprop_drake.inputs import params
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.results.identifiability_flags import bound_in_words, classify_parameters, unobservable_combinations


def test_a_long_maneuver_identifies_all_ten(sample_run: Run) -> None:
    found = sample_run.results.identifiability
    assert [entry.parameter for entry in found] == list(NAMES)
    assert {entry.flag for entry in found} == {"identified"}
    assert {entry.reason for entry in found} == {""}
    assert all(entry.share is not None and entry.share < 0.5 for entry in found)


def test_a_short_one_says_what_it_has_not_shown(short_run: Run) -> None:
    found = {entry.parameter: entry for entry in short_run.results.identifiability}
    assert found["Iyy_inv"].flag == "identified"
    assert found["m_inv"].flag == "weak"
    assert re.fullmatch(r"1-sigma is \d.* times what is asked; a second of \w+ would leave .* % of it",
                        found["m_inv"].reason)  # fmt: skip


def test_before_anything_has_fired_nothing_is_known() -> None:
    scenario = load_scenario("sample_maneuver")
    found = classify_parameters(scenario, params.initial_estimate(scenario), params.initial_covariance(scenario))
    assert {entry.flag for entry in found} == {"not_excited"}
    assert found[6].share == pytest.approx(1.0)
    assert found[6].reason.startswith("1-sigma is still 100 % of the start's; a second of ")
    wider = classify_parameters(scenario, params.initial_estimate(scenario), 4.0 * params.initial_covariance(scenario))
    assert wider[6].reason.startswith("1-sigma has grown to 2 times the start's; a second of ")
    pitch = found[1]  # the jet named for it must turn the body about y
    assert pitch.jet is not None
    vehicle = scenario.vehicle_data
    wrench = vehicle.wrenches[vehicle.designations.index(pitch.jet)]
    torque = wrench[:3] - np.cross(vehicle.nominal.center_of_mass, wrench[3:])
    assert abs(torque[1]) > 0.5 * np.linalg.norm(torque)


def test_without_an_accelerometer_the_mass_cannot_be_observed() -> None:
    vehicle = load_vehicle("orbiter")
    np.testing.assert_array_equal(unobservable_combinations(vehicle, accelerometer=False), np.eye(10)[9:])
    assert unobservable_combinations(vehicle, accelerometer=True).size == 0


def test_sigmas_are_told_against_the_least_for_rounding_as_noise(short_run: Run) -> None:
    known = [one._replace(bound=2.0) for one in short_run.results.identifiability[:2]]
    for deviations, span in (([2.0, 3.0], "1 to 1.5 (b)"), ([2.0, 2.001], "1"), ([0.76, 3.0], "0.38 (a) to 1.5 (b)")):
        said = bound_in_words(deviations, known, "ab")
        assert said == f"1-sigma is {span} times its Cramér-Rao bound, with rounding taken as noise"
    assert bound_in_words([1.0], [known[0]._replace(bound=None)], "a") == ""
    said = bound_in_words([2.0, 2.0], known, "ab", has_failed=True)
    assert said == "1-sigma is 1 times its Cramér-Rao bound, computed as if no jet had failed and rounding were noise"
