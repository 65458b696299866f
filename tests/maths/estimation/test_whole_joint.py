"""The joint filter's cycle as one kernel is the cycle by its parts, bit for bit; compiled code is no part of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import cycle, quiet_cycles, whole_joint
from massprop_drake.maths.estimation.cycle import EstimationParams
from massprop_drake.runners import cycles, loop, recorded

TAKEN: list[int] = []  # cycles that kernels take at a time


class Counted(quiet_cycles.Quiet):
    """Cycles of which it is counted how many the kernel takes."""

    def advance(self, row: int, until: int) -> int:
        reached = super().advance(row, until)
        TAKEN.append(reached - row)
        return reached


def with_work(made: EstimationParams) -> EstimationParams:
    """Parameters of which the kernel is asked as if it were compiled."""
    joint = made.filter_params.joint
    joint = joint._replace(compiled=whole_joint.Work(joint, compile_it=False))
    return made._replace(
        filter_params=made.filter_params._replace(joint=joint),
        detector_params=made.detector_params._replace(joint=joint),
    )


def as_one(_scenario: Scenario, made: EstimationParams, state: Any = None) -> cycles.JointKernelCycles:
    return cycles.JointKernelCycles(with_work(made), state or cycle.initial_state(made), compiled=False)


ODDS = ("history_", "fault_", "none_", "unknown_")


def test_one_kernel_gives_the_bits_of_the_parts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Same bits in flight and from a record, before and after a jet sticks, which is left to the parts."""
    scenario = load_scenario(
        "orbiter_maneuver",
        ["failures=[{kind: stuck_on, jet: R4R, start_s: 6.2}]", "duration_s=6.8", "execution.engine=loop"],
    )
    parts = simulate(scenario, look_back=False)
    record = parts.save(tmp_path / "run", pictures=False, report=False) / "telemetry.csv"
    monkeypatch.setattr(quiet_cycles, "Quiet", Counted)
    for runner in (loop, recorded):
        monkeypatch.setattr(runner, "make_cycles", as_one)
    for run_of, rows in (
        (lambda: simulate(scenario, look_back=False), slice(None)),
        (lambda: estimate(record, scenario), slice(-1)),  # a record does not have the last command
    ):
        TAKEN.clear()
        found = run_of()
        for signal in set(found.signals) & set(parts.signals):
            rounding = 1e-12 if signal.startswith(ODDS) else 0.0  # likelihoods are sums that begin elsewhere
            one, expected = found[signal][rows], parts[signal][rows]
            np.testing.assert_allclose(one, expected, rtol=rounding, atol=rounding, err_msg=signal)
        np.testing.assert_array_equal(found.covariance, parts.covariance)
        assert found.summary["detections"] == parts.summary["detections"]
        assert sum(TAKEN) > 20
    assert [entry["jet"] for entry in parts.summary["detections"]] == ["R4R"]


def test_parameters_that_the_kernel_does_not_cover_are_left_to_the_parts() -> None:
    def covers(name: str, *overrides: str, compiled: bool = False) -> bool:
        made = params.estimation_params(load_scenario(name, list(overrides)))
        return quiet_cycles.covers(with_work(made) if compiled else made)

    assert covers("orbiter_maneuver", compiled=True)
    assert not covers("orbiter_maneuver", "detector.kind=off")
    assert not covers("orbiter_maneuver")
    assert not covers("sample_maneuver")
