"""Saved states of vehicles with parts of all kinds: what a run has left is taken up again."""

from __future__ import annotations

import pytest

from massprop_drake import load_scenario, simulate
from massprop_drake.inputs.params import estimation_params
from massprop_drake.runners.logs import restored


@pytest.mark.parametrize("name", ["lander_maneuver"])
def test_what_a_run_has_left_is_taken_up(name: str) -> None:
    """A hypothesis assumes no setting of an engine, and no speed of a wheel, until a reading of it is not believed."""
    case = load_scenario(name, ["duration_s=22", "estimation.filter=joint", "detector.kind=hypotheses"])
    run = simulate(case, look_back=False)
    assert run.state is not None
    state = restored(run.state["states"], estimation_params(case), "a file").filter
    assert state.estimate.tolist() == run["estimate"][-1].tolist()
