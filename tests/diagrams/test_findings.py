"""Findings while a flight goes on: ports of the estimation diagram, and a user's system that reads them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from systems_probe import LEAKS, feedthrough, inputs, leaked, outputs

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, estimation, open_loop, replay
from massprop_drake.results.consistency import TOO_LITTLE

Array = NDArray[np.float64]

SOON = "estimation={filter: thesis, start: nominal, std_fraction: 0.001}"  # near the truth
SCENARIOS = {
    "thesis": load_scenario("stuck_on_29", ["duration_s=8", SOON, "failures=[{kind: stuck_on, jet: R4R, start_s: 4}]"]),
    "joint": LEAKS,
    "pose": load_scenario("air_bearing_pulses", ["duration_s=1.2"]),
    "no detector": load_scenario("sample_maneuver", ["duration_s=5", "detector={kind: off}"]),
}
FINDINGS = ("failed_jets", "detections", "verdict")
ONLY_A_WHOLE_FLIGHT_TELLS = ("earliest_s", "latest_s", "jet_index")
MEANS = ("rotation_nis_mean", "translation_nis_mean", "rotation_nis_beyond", "translation_nis_within")


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_ports_say_what_the_summary_says_and_change_nothing(name: str) -> None:
    scenario = SCENARIOS[name]
    run: Run = leaked() if scenario is LEAKS else simulate(scenario, look_back=False)
    diagram = (open_loop if scenario.jet_schedule else closed_loop).build(scenario, findings=True)
    simulator, samples = Simulator(diagram), []

    def said(*ports: str) -> list[Any]:
        return [diagram.GetOutputPort(port).Eval(simulator.get_context()) for port in ports]

    failed, detections, verdict = said(*FINDINGS)
    assert (failed.any(), detections, verdict.verdict, verdict.samples) == (False, (), TOO_LITTLE, 0)
    for row in range(0, len(run.time_s), 5):
        simulator.AdvanceTo(run.time_s[row])
        samples.append(said(*FINDINGS)[-1].samples)
        np.testing.assert_array_equal(said("estimate")[0], run["estimate"][row])  # whoever reads them or not
    assert sorted(samples) == samples
    simulator.AdvanceTo(run.time_s[-1])
    simulator.AdvancePendingEvents()
    failed, detections, verdict = said(*FINDINGS)
    found = [entry._replace(**dict.fromkeys(ONLY_A_WHOLE_FLIGHT_TELLS)) for entry in run.results.detections]
    assert list(detections) == found
    assert bool(found) == (name in ("thesis", "joint"))
    named = {jet for entry in found if entry.withdrawn_s is None for jet in entry.jets}
    marked = zip(scenario.vehicle_data.designations, failed.tolist(), strict=True)
    assert {jet for jet, mark in marked if mark} == named
    summed = run.results.consistency
    assert verdict.samples == summed.samples
    for mean in MEANS:
        assert getattr(verdict, mean) == pytest.approx(getattr(summed, mean), rel=1e-9), mean
    explains = [entry.kind == "mass_property_jump" or entry.isolated_to == "jet" for entry in found]
    if not any(explains):  # what was seen until then, which only the summary looks back at
        assert list(verdict.reasons) == [reason for reason in summed.reasons if "sigmas off" not in reason]


@pytest.mark.parametrize("name", SCENARIOS)
def test_ports_are_there_where_they_are_asked_for_and_close_no_loop(name: str) -> None:
    scenario = SCENARIOS[name]
    dut = estimation.build(scenario, findings=True)
    added = {"failed_jets": len(scenario.vehicle_data.jets), "detections": 0, "verdict": 0}
    assert outputs(dut) == {**outputs(estimation.build(scenario)), **added}
    assert outputs(replay.build(scenario, findings=True)) == {**outputs(replay.build(scenario)), **added}
    depends = feedthrough(dut)
    assert [depends[port] for port in FINDINGS] == [set()] * 3
    assert len(inputs(dut)) > 1
