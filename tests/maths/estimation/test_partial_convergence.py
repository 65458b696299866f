"""Failures that the rates show while the mass, or the inertia about an axis, is not known yet."""

from __future__ import annotations

import json

import numpy as np
import pytest

from massprop_drake import load_scenario, simulate
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.joint import beginning
from massprop_drake.maths.estimation.joint.guard import knows_rotation
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import MASS, JointParams

TURNS = [("rhc", "+x", 0.5, 1.7), ("rhc", "+y", 2.0, 3.2), ("rhc", "+z", 3.5, 4.7), ("thc", "+z", 6.0, 7.0)]
WINDOWS = [{"controller": by, "axis": axis, "start_s": start, "end_s": end} for by, axis, start, end in TURNS]
SETTINGS = ("estimation={filter: joint}", "execution.engine=loop", "seed=3")


def test_a_failure_is_named_by_the_rates_within_a_second_while_mass_is_unknown() -> None:
    # turns about all axes, then the first translation, in which it acts
    failure = {"kind": "stuck_on", "jet": "YN2", "start_s": 5.45}
    given = [f"maneuver={json.dumps(WINDOWS)}", f"failures={json.dumps([failure])}", "duration_s=7.5"]
    run = simulate(load_scenario("small_satellite_maneuver", [*SETTINGS, *given]))
    ((found,), (injected,)) = run.summary["detections"], run.summary["injected"]
    before = np.flatnonzero(run.time_s < injected["first_acted_s"] - 0.01)[-1]
    assert run["standard_deviation"][before, MASS] > 0.2 * run["estimate"][before, MASS]
    assert (found["kind"], found["jets"]) == ("jet_on", ["YN2"])
    assert found["time_s"] - injected["first_acted_s"] <= 1.0
    assert np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]).max() < 4.0
    assert run.summary["consistency"]["verdict"] == "consistent"


@pytest.fixture(scope="module")
def params() -> JointParams:
    return inputs.estimation_params(load_scenario("small_satellite_maneuver", SETTINGS)).filter_params.joint


@pytest.mark.parametrize(("row", "matters"), [(0, True), (1, True), (2, True), (3, True), (7, True), (MASS, False)])
def test_rotation_is_known_whatever_the_mass_and_not_without_any_other(
    row: int, matters: bool, params: JointParams
) -> None:
    state = beginning.initial_joint_state(params)
    assert not knows_rotation(state, params)  # 30 %
    state = state._replace(root=0.1 * state.root)
    assert knows_rotation(state, params)
    state.root[row] *= 10.0
    assert knows_rotation(state, params) != matters
    if row == 0:  # axes about which nothing turns the vehicle need not be known
        about_x = np.abs(effects_of(params.wrenches, state.mean)[:, 0])
        assert not knows_rotation(state, params, about_x > 0.5 * about_x.max())
        assert knows_rotation(state, params, about_x < 1e-3 * about_x.max())
