"""Failures that the rates show while the mass is not known yet."""

from __future__ import annotations

import json

import numpy as np
import pytest

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.joint import beginning
from massprop_drake.maths.estimation.joint.guard import knows_rotation
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import MASS, JointParams

TURNS = [("rhc", "+x", 0.5, 1.7), ("rhc", "+y", 2.0, 3.2), ("rhc", "+z", 3.5, 4.7), ("thc", "+z", 6.0, 7.0)]
WINDOWS = [{"controller": by, "axis": axis, "start_s": start, "end_s": end} for by, axis, start, end in TURNS]
SETTINGS = ("estimation={filter: joint}", "duration_s=7.5", "execution.engine=loop", "seed=3")


def flight(failure: dict[str, object] | None) -> Run:
    """Turns about all axes, then the first translation, in which a failure acts."""
    happens = [f"maneuver={json.dumps(WINDOWS)}", f"failures={json.dumps([failure] if failure else [])}"]
    return simulate(load_scenario("small_satellite_maneuver", [*SETTINGS, *happens]))


def largest_error(run: Run) -> float:
    """Largest error of a parameter at the end, in its 1-sigma."""
    errors = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    return float(np.abs(errors).max())


@pytest.mark.parametrize(
    ("failure", "kind"),
    [
        ({"kind": "stuck_off", "jet": "ZP1", "start_s": 5.5}, "jet_off"),
        ({"kind": "stuck_on", "jet": "YN2", "start_s": 5.45}, "jet_on"),
        ({"kind": "leak", "jet": "XP1", "start_s": 5.2, "force": 0.5}, "jet_on"),
    ],
)
def test_a_failure_is_named_by_the_rates_within_a_second_while_mass_is_unknown(
    failure: dict[str, object], kind: str
) -> None:
    run = flight(failure)
    (found,), (injected,) = run.summary["detections"], run.summary["injected"]
    acted_s = injected["first_acted_s"]
    before = np.flatnonzero(run.time_s < acted_s - 0.01)[-1]
    assert run["standard_deviation"][before, MASS] > 0.2 * run["estimate"][before, MASS]
    assert (found["kind"], found["jets"]) == (kind, [failure["jet"]])
    assert found["time_s"] - acted_s <= 1.0
    assert largest_error(run) < 4.0
    assert run.summary["consistency"]["verdict"] == "consistent"


def test_a_healthy_flight_with_unknown_mass_is_silent() -> None:
    run = flight(None)
    assert run.summary["detections"] == []
    assert largest_error(run) < 4.0


TOGETHER = [
    ("T1", "T8"),
    ("T2", "T7"),
    ("T5", "T12"),
    ("T6", "T11"),
    ("T1", "T2"),
    ("T7", "T8"),
    ("T5", "T6"),
    ("T11", "T12"),
]


@pytest.mark.parametrize(
    "failure",
    [
        {"kind": "leak", "jet": "T11", "start_s": 21.5, "force": 0.01},
        {"kind": "stuck_on", "jet": "T9", "start_s": 21.5},
        None,
    ],
)
def test_failures_are_named_though_nothing_has_turned_the_vehicle_about_one_axis(
    failure: dict[str, object] | None,
) -> None:
    """Its start is over without it; a jet that turns it about that axis is named as well."""
    pulses = [
        {"jet": jet, "start_s": round(0.5 + 0.6 * number, 2), "end_s": round(0.8 + 0.6 * number, 2)}
        for number in range(36)
        for jet in TOGETHER[number % 8]
    ]
    of_filter = "joint={thrust_uncertainty: 0, tank_fraction: 0}"
    happens = [f"jet_schedule={json.dumps(pulses)}", f"failures={json.dumps([failure] if failure else [])}"]
    told = ["vehicle=free_flyer", "detector={kind: hypotheses}", of_filter, "duration_s=23"]
    run = simulate(load_scenario("jet_pulses", [*SETTINGS, *told, *happens]))
    before = np.flatnonzero(run.time_s < 21.4)[-1]
    assert run["standard_deviation"][before, 2] > 0.1 * run["estimate"][before, 2]
    assert [found["jets"] for found in run.summary["detections"]] == ([[failure["jet"]]] if failure else [])
    assert largest_error(run) < 4.0
    assert run.summary["consistency"]["verdict"] == "consistent"


@pytest.fixture(scope="module")
def params() -> JointParams:
    return inputs.joint_params(load_scenario("small_satellite_maneuver", SETTINGS)).joint


@pytest.mark.parametrize(("row", "matters"), [(0, True), (1, True), (2, True), (3, True), (7, True), (MASS, False)])
def test_rotation_is_known_whatever_the_mass_and_not_without_any_other(
    row: int, matters: bool, params: JointParams
) -> None:
    state = beginning.initial(params)
    assert not knows_rotation(state, params)  # 30 %
    state = state._replace(root=0.1 * state.root)
    assert knows_rotation(state, params)
    state.root[row] *= 10.0
    assert knows_rotation(state, params) != matters


def test_axes_about_which_nothing_turns_the_vehicle_need_not_be_known(params: JointParams) -> None:
    state = beginning.initial(params)
    state = state._replace(root=0.1 * state.root)
    state.root[0] *= 10.0
    about_x = np.abs(effects_of(params.wrenches, state.mean)[:, 0])
    assert not knows_rotation(state, params, about_x > 0.5 * about_x.max())
    assert knows_rotation(state, params, about_x < 1e-3 * about_x.max())
