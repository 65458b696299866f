"""Findings while a flight goes on: ports of the estimation diagram, and a user's system that reads them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from systems_probe import feedthrough, inputs, outputs

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation, open_loop, replay, vehicle
from massprop_drake.results.consistency import CONSISTENT, TOO_LITTLE, Consistency
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.systems.views import port_view

Array = NDArray[np.float64]

LEAK_S = 5.0
SOON = [
    "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
    "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
]
LEAKS = load_scenario(
    "leak_named", ["duration_s=9", *SOON, f"failures=[{{kind: leak, jet: L4D, start_s: {LEAK_S}, force: 10}}]"]
)
SCENARIOS = {
    "thesis": load_scenario("stuck_on_29", ["duration_s=52"]),
    "thesis, a payload": load_scenario("payload_release", ["duration_s=50"]),
    "joint": LEAKS,
    "pose": load_scenario("air_bearing_pulses", ["duration_s=13"]),
    "no detector": load_scenario("sample_maneuver", ["duration_s=10", "detector={kind: off}"]),
}
PORTS = ("command", "failed_jets")
ONLY_A_WHOLE_FLIGHT_TELLS = ("earliest_s", "latest_s", "jet_index")


def flown(diagram: Any, scenario: Scenario, until_s: float | None = None) -> Context:
    """The context at the end of a flight, the sample there included."""
    simulator = Simulator(diagram)
    simulator.AdvanceTo(scenario.duration_s if until_s is None else until_s)
    simulator.AdvancePendingEvents()
    return simulator.get_context()


def told(diagram: Any, context: Context) -> tuple[Array, tuple[DetectionRecord, ...], Consistency]:
    failed, detections, verdict = (
        diagram.GetOutputPort(name).Eval(context) for name in ("failed_jets", "detections", "verdict")
    )
    return failed, detections, verdict


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_at_the_end_the_ports_say_what_the_summary_says(scenario: Scenario) -> None:
    run: Run = simulate(scenario, look_back=False)
    diagram = (open_loop if scenario.jet_schedule else closed_loop).build(scenario, findings=True)
    failed, detections, verdict = told(diagram, flown(diagram, scenario, run.time_s[-1]))
    found = [entry._replace(**dict.fromkeys(ONLY_A_WHOLE_FLIGHT_TELLS)) for entry in run.results.detections]
    assert list(detections) == found
    assert bool(found) == (scenario.detector.kind != "off")
    named = [jet for entry in found if entry.withdrawn_s is None for jet in entry.jets]
    marked = dict(zip(scenario.vehicle_data.designations, failed.tolist(), strict=True))
    assert [jet for jet, mark in marked.items() if mark] == sorted(named, key=list(marked).index)
    summed = run.results.consistency
    assert verdict.samples == summed.samples
    means = ("rotation_nis_mean", "translation_nis_mean", "rotation_nis_beyond", "translation_nis_within")
    for name in means:
        assert getattr(verdict, name) == pytest.approx(getattr(summed, name), rel=1e-9), name
    explains = [entry.kind == "mass_property_jump" or entry.isolated_to == "jet" for entry in found]
    if not any(explains):  # what was seen until then, which only the summary looks back at
        by_truth = [reason for reason in summed.reasons if "sigmas off" in reason]
        assert list(verdict.reasons) == [reason for reason in summed.reasons if reason not in by_truth]


@pytest.mark.parametrize("build", [estimation.build, closed_loop.build, replay.build])
def test_ports_are_there_where_they_are_asked_for(build: Any) -> None:
    scenario = SCENARIOS["thesis"]
    asked, plain = outputs(build(scenario, findings=True)), outputs(build(scenario))
    added = {"failed_jets": 44, "detections": 0, "verdict": 0}
    assert asked == {**plain, **added}
    assert not added.keys() & plain.keys()


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_findings_close_no_loop(scenario: Scenario) -> None:
    dut = estimation.build(scenario, findings=True)
    depends = feedthrough(dut)
    for name in ("failed_jets", "detections", "verdict"):
        assert depends[name] == set()
    assert len(inputs(dut)) > 1


def test_reading_them_changes_nothing() -> None:
    diagram, plain = closed_loop.build(LEAKS, findings=True), closed_loop.build(LEAKS)
    simulator, other = Simulator(diagram), Simulator(plain)
    for reached_s in np.arange(0.4, LEAKS.duration_s, 0.4):
        simulator.AdvanceTo(reached_s)
        other.AdvanceTo(reached_s)
        told(diagram, simulator.get_context())
        for name in ("estimate", "hypothesis_report", "command"):
            seen = diagram.GetOutputPort(name).Eval(simulator.get_context())
            np.testing.assert_array_equal(seen, plain.GetOutputPort(name).Eval(other.get_context()))


def test_a_verdict_grows_with_the_flight() -> None:
    scenario = SCENARIOS["no detector"]
    diagram = closed_loop.build(scenario, findings=True)
    simulator = Simulator(diagram)
    early = told(diagram, simulator.get_context())
    assert early[0].tolist() == [0.0] * 44
    assert early[1] == ()
    assert (early[2].verdict, early[2].samples) == (TOO_LITTLE, 0)
    simulator.AdvanceTo(scenario.duration_s)
    late = told(diagram, simulator.get_context())[2]
    assert (late.verdict, late.reasons) == (CONSISTENT, [])
    assert late.samples > 20


class Guard(LeafSystem):
    """A user's system: passes commands on, but for those of jets that have failed, and notes what it was told.

    It says nothing of what its ports depend on, so Drake takes it to depend on everything at once.
    """

    def __init__(self, jets: int, period_s: float):
        super().__init__()
        self.set_name("guard")
        self._command = self.DeclareVectorInputPort("command", jets)
        self._failed = self.DeclareVectorInputPort("failed_jets", jets)
        self._held = self.DeclareDiscreteState(jets)
        self.DeclareVectorOutputPort("command", jets, self._calc)
        self.DeclareStateOutputPort("held_command", self._held)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _guarded(self, context: Any) -> Array:
        guarded: Array = self._command.Eval(context) * (1.0 - self._failed.Eval(context))
        return guarded

    def _calc(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._guarded(context))

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._held, self._guarded(context))


def test_an_autopilot_of_ones_own_stops_commanding_a_jet_that_has_failed() -> None:
    scenario = load_scenario("stuck_off_11", ["duration_s=56"])
    jets = scenario.vehicle_data.designations
    builder = DiagramBuilder()
    pilot = builder.AddNamedSystem("autopilot", autopilot.build(scenario))  # not told of failures
    guard = builder.AddSystem(Guard(len(jets), scenario.vehicle_data.sample_period_s))
    body = builder.AddNamedSystem("vehicle", vehicle.build(scenario))
    known = builder.AddNamedSystem("estimation", estimation.build(scenario, findings=True))
    builder.Connect(pilot.GetOutputPort("command"), guard.GetInputPort("command"))
    builder.Connect(known.GetOutputPort("failed_jets"), guard.GetInputPort("failed_jets"))
    for name in ("command", "held_command"):
        builder.Connect(guard.GetOutputPort(name), body.GetInputPort(name))
    builder.Connect(guard.GetOutputPort("held_command"), known.GetInputPort("jet_commands"))
    builder.Connect(body.GetOutputPort("gyro"), pilot.GetInputPort("gyro"))
    for name in scenario.vehicle_data.sensor_names():
        builder.Connect(body.GetOutputPort(name), known.GetInputPort(name))
    simulator = Simulator(builder.Build())  # no algebraic loop
    root = simulator.get_context()

    def said(system: Any, port: str) -> Any:
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(root))

    period_s, view = scenario.vehicle_data.sample_period_s, {port: port_view(port, jets) for port in PORTS}
    told_s, asked, given = [], 0.0, 0.0
    for sample in range(1, round(scenario.duration_s / period_s)):
        simulator.AdvanceTo(sample * period_s)
        if view["failed_jets"](said(known, "failed_jets")).F2R:
            told_s.append(root.get_time())
            asked += view["command"](said(pilot, "command")).F2R
            given += view["command"](said(guard, "command")).F2R
    (entry,) = said(known, "detections")
    assert (entry.jet, entry.kind, entry.mode) == ("F2R", "jet_off", "stuck_off")
    assert told_s[0] == pytest.approx(entry.time_s + period_s)  # from the sample after it on
    assert given == 0.0 < asked
