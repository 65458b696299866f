"""The joint filter's cycle as one kernel is the cycle by its parts, bit for bit; compiled code is no part of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import cycle, whole_joint
from massprop_drake.maths.estimation.cycle import EstimationParams
from massprop_drake.runners import cycles, loop, recorded

CASES: dict[str, tuple[str, list[str]]] = {
    "thrust errors": ("dispersed_thrust", ["duration_s=14", "seed=2"]),
    "a jet that sticks": (
        "orbiter_maneuver",
        ["duration_s=11", "failures=[{kind: stuck_on, jet: R4R, start_s: 8}]"],
    ),
}


def with_work(made: EstimationParams) -> EstimationParams:
    """Parameters of which the kernel is asked as if it were compiled."""
    joint = made.filter_params.joint
    joint = joint._replace(compiled=whole_joint.Work(joint, compile_it=False))
    return made._replace(
        filter_params=made.filter_params._replace(joint=joint),
        detector_params=made.detector_params._replace(joint=joint),
    )


class Counted(cycles.Watched):
    """Cycles of which it is counted how many the kernel takes."""

    def __init__(self, made: EstimationParams, state: cycle.EstimationState):
        super().__init__(with_work(made), state, compiled=False)
        self.taken = 0

    def _watch_on(self, until: int) -> None:
        before = self._next
        super()._watch_on(until)
        self.taken += self._next - before


ODDS = ("history_", "fault_", "none_", "unknown_")


@pytest.mark.parametrize("case", CASES)
def test_one_kernel_gives_the_bits_of_the_parts(case: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    name, overrides = CASES[case]
    scenario = load_scenario(name, [*overrides, "execution.engine=loop"])
    parts = simulate(scenario)
    parts.save(tmp_path / "run", pictures=False, report=False)
    record = tmp_path / "run" / "telemetry.csv"
    read = estimate(record, scenario)
    made: list[Counted] = []

    def counted(_scenario: Scenario, given: EstimationParams, state: Any = None) -> Counted:
        made.append(Counted(given, state or cycle.initial_state(given)))
        return made[-1]

    for runner in (loop, recorded):
        monkeypatch.setattr(runner, "cycles", counted)
    for whole_run, parts_run in ((simulate(scenario), parts), (estimate(record, scenario), read)):
        for signal in parts_run.signals:
            rounding = 1e-12 if signal.startswith(ODDS) else 0.0  # likelihoods are sums that begin elsewhere
            np.testing.assert_allclose(
                whole_run[signal], parts_run[signal], rtol=rounding, atol=rounding, err_msg=signal
            )
        np.testing.assert_array_equal(whole_run.covariance, parts_run.covariance)
        assert whole_run.summary["detections"] == parts_run.summary["detections"]
    assert all(each.taken > 20 for each in made)
    assert [entry["jet"] for entry in parts.summary["detections"]] == (["R4R"] if case == "a jet that sticks" else [])


def test_a_cycle_that_is_left_to_the_parts_changes_nothing() -> None:
    scenario = load_scenario("orbiter_maneuver", ["duration_s=10", "execution.engine=loop"])
    run = loop.Loop(scenario)
    watched = Counted(run._params, cycle.initial_state(run._params))
    run._known = watched
    run.advance(10.0)
    assert watched._watch.on
    before = watched.state()
    record = watched._record
    late = record._replace(samples=record.samples._replace(time_s=record.samples.time_s + 0.01))
    watched.begin(late, watched._log)
    watched._next = run._sample
    assert watched._watch.advance(run._sample, run._sample + 1) == run._sample
    after = watched._watch.state()
    assert not watched._watch.on
    for one, other in ((before.filter, after.filter), (before.detector, after.detector)):
        np.testing.assert_equal(one, other)
    records = [len(each.detector.tree.leader.watch.records) for each in (before, after)]
    assert records[0] == records[1] > 10


def test_what_the_kernel_does_not_do_is_left_to_the_parts() -> None:
    def covers(*overrides: str) -> bool:
        made = params.estimation_params(load_scenario("orbiter_maneuver", list(overrides)))
        return whole_joint.covers(with_work(made) if made.detector is not None else made)

    assert covers()
    assert not covers("detector.kind=off")
    assert not whole_joint.covers(params.estimation_params(load_scenario("orbiter_maneuver")))
    assert not whole_joint.covers(params.estimation_params(load_scenario("sample_maneuver")))
