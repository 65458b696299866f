"""A filter of another method as one system: what a new entry of the registry gets without a line of wiring."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from systems_probe import outputs

from massprop_drake import Estimator, Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import estimation
from massprop_drake.maths.estimation.filter import Filter, FilterStep, Groups
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.filters.registry import FILTERS
from massprop_drake.maths.estimation.filters.thesis import ThesisParams, ThesisState
from massprop_drake.maths.linear_algebra import Array


class CountingState(NamedTuple):
    """The thesis's pair, and how often each axis was pushed: a state of another size."""

    pair: ThesisState
    pushes: Array


def _finish(state: CountingState, measurement: Any, interval: Any, adaptation: Any, params: Any) -> FilterStep:
    step = thesis.finish(state.pair, measurement, interval, adaptation, params)
    pushes = state.pushes + (interval.impulses.linear_impulse != 0.0)
    return step._replace(state=CountingState(step.state, pushes))


def _saved(state: CountingState, params: ThesisParams) -> Groups:
    return {**thesis.save_state(state.pair, params), "pushes": state.pushes}


COUNTING = Filter(
    params=thesis.make_params,
    initial=lambda params: CountingState(thesis.initial_state(params), np.zeros(3)),
    predicted=lambda state: thesis.predicted_parameters(state.pair),
    measure=lambda state, *rest: thesis.measure(state.pair, *rest),
    evidence=lambda state, *rest: thesis.evidence(state.pair, *rest),
    finish=_finish,
    covariance=lambda state: thesis.parameter_covariance(state.pair),
    saved=_saved,
    restored=lambda groups, params: CountingState(thesis.restore_state(groups, params), groups["pushes"]),
)


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    """The registry has the filter while these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FILTERS, "counting", COUNTING)
        yield


@pytest.fixture(scope="module")
def counting() -> Scenario:
    """A failure's scenario, estimated by that filter."""
    near = "estimation={start: nominal, std_fraction: 0.001, thrust_uncertainty: 0.01}"
    case = load_scenario("stuck_on_29", ["duration_s=4", near, "failures=[{kind: stuck_on, jet: R4R, start_s: 2}]"])
    return case.model_copy(update={"estimation": case.estimation.model_copy(update={"filter": "counting"})})


@pytest.fixture(scope="module")
def flown(counting: Scenario) -> Run:
    return simulate(counting)


def test_topology(counting: Scenario) -> None:
    dut = estimation.build(counting).GetSubsystemByName("estimator")
    reports = {"rotation_report": 28, "mass_report": 11, "detector_report": 14 + 4 * 44}
    assert reports.items() <= outputs(dut).items()
    assert not {"hypothesis_report", "fault_probability", "joint_report"} & set(outputs(dut))


def test_the_estimator_takes_it_and_keeps_its_state(counting: Scenario, flown: Run) -> None:
    dut = Estimator(counting.vehicle_data, counting)
    for k, time_s in enumerate(flown.time_s):
        accelerometers = {name: flown[name][k] for name in ("acc1", "acc2", "acc3")}
        step = dut.step(time_s, flown["gyro"][k], accelerometers, flown["command"][k])
        np.testing.assert_array_equal(step.estimate, flown["estimate"][k])
        if k == flown.time_s.size // 2:
            kept = dut.state
            dut = Estimator(counting.vehicle_data, counting)
            dut.restore(kept)
    (pushes,) = dut.state["states"]["pushes"]
    linear = flown["linear_impulse"] != 0.0
    np.testing.assert_array_equal(pushes, linear.sum(axis=0))
    assert linear.any()
