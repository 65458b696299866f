"""Names for the elements of port vectors: of every port, and as the logged signals are called."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from systems_probe import outputs

from massprop_drake import Scenario, load_scenario, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation
from massprop_drake.systems.views import port_view

FLOWN = load_scenario("sample_maneuver", ["duration_s=4"])
SCENARIOS = {"thesis": FLOWN, "joint": load_scenario("leak_named"), "pose": load_scenario("air_bearing_pulses")}
FEW = 3  # elements that need no names
# a system's own names for what the diagram exports, or another takes, under another
OWN = {
    "rotation_estimator": "rotation",
    "mass_estimator": "mass",
    "failure_detector": "detector",
    "jet_selection": "selection",
}


def name_of(system: str, port: str) -> str:
    """The port's name in a diagram."""
    inside = port in ("report", "counts", "estimate", "covariance", "innovation", "innovation_covariance")
    return f"{OWN[system]}_{port}" if inside and system in OWN else port


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_every_port_of_more_than_a_few_elements_has_names(scenario: Scenario) -> None:
    diagrams: list[Any] = [estimation.build(scenario)]
    if not scenario.jet_schedule:
        diagrams.append(autopilot.build(scenario))
    jets, seen = scenario.vehicle_data.designations, 0
    for diagram in diagrams:
        systems = {"": diagram, **{system.get_name(): system for system in diagram.GetSystems()}}
        for name, system in systems.items():
            for port, size in outputs(system).items():
                if size > FEW:
                    named = () if port == "turning" else jets  # thrust errors are not considered
                    fields = port_view(name_of(name, port), named).get_fields()
                    assert len(fields) == len(set(fields)) == size, (name, port)
                    seen += 1
    assert seen > 10


def test_a_view_reads_a_port_of_a_simulation() -> None:
    scenario = FLOWN
    run, diagram = simulate(scenario, look_back=False), closed_loop.build(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(run.time_s[-1])
    said = {
        name: port_view(name, scenario.vehicle_data.designations)(
            diagram.GetOutputPort(name).Eval(simulator.get_context())
        )
        for name in ("estimate", "covariance", "rotation_report", "detector_report", "request", "command", "impulses")
    }
    last, jet = {name: run[name][-1] for name in run.signals}, scenario.vehicle_data.jet_index("R4R")
    assert said["estimate"].Ixx_inv == said["rotation_report"].estimate_Ixx_inv == last["estimate"][0]
    assert said["covariance"].m_inv_m_inv == pytest.approx(last["standard_deviation"][9] ** 2)
    assert said["covariance"].Ixx_inv_x_cm == said["covariance"].x_cm_Ixx_inv
    np.testing.assert_equal(said["rotation_report"].rotation_nis, last["rotation_nis"][0])
    assert said["detector_report"].known_force_R4R == last["known_force"][jet]
    assert said["request"].dv_y == last["request"][4]
    assert said["impulses"].linear_impulse_z == last["linear_impulse"][2]
    assert len(said["command"]) == 44


def test_designations_that_no_name_may_have_and_what_cannot_be_viewed() -> None:
    assert port_view("fault_probability", ("A1", "B2")).get_fields() == ("A1", "B2", "none", "unknown")
    assert port_view("command", ["1", "RCS+X", "RCS Y"]).get_fields() == ("_1", "RCS_X", "RCS_Y")
    assert port_view("closed", ["RCS+X", "RCS-X"]).get_fields() == ("RCS_X_0", "RCS_X_1")
    with pytest.raises(ValueError, match="'estimates' with named elements; there are adaptation, "):
        port_view("estimates")
    with pytest.raises(ValueError, match="'detector_report' has elements of jets: give their designations"):
        port_view("detector_report")
    assert port_view("estimate").__name__ == "EstimateView"
