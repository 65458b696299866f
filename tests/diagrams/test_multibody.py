"""Vehicles that are MultibodyPlants: scenarios with a model, and jets and sensors beside a plant of one's own."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from multibody_probe import ARM, arm
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from systems_probe import inputs, outputs

from massprop_drake import InputError, Run, load_scenario, load_vehicle, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation
from massprop_drake.diagrams.multibody import add_thrusters_and_sensors, set_initial_velocities
from massprop_drake.display import figures
from massprop_drake.maths.vehicle.rigid_body import RATE
from massprop_drake.systems.multibody import StarTracker

MOVE = "plant.moves=[{joint: shoulder, start_s: 0.1, end_s: 1.1, position: 1.3}]"
EARLY = ["duration_s=1.4", "estimation.filter=thesis", "detector={kind: off}", MOVE]
GOOD = load_scenario("servicer_arm").plant.model  # type: ignore[union-attr]


def test_a_scenario_flies_a_model_with_the_truth_of_its_bodies_and_its_folder_again(tmp_path: Path) -> None:
    run = simulate(load_scenario("servicer_arm", EARLY))
    joints, truth = run["joint_positions"], run["truth"]
    assert run.units["joint_positions"] == "rad"
    np.testing.assert_allclose(joints[0], [1.57, -2.8], atol=0.0)
    assert joints[-1, 0] == pytest.approx(1.3, abs=2e-3)
    assert np.ptp(joints[:, 1]) > 0.01  # the elbow is free
    np.testing.assert_allclose(truth[:, 9], 1.0 / 183.0, rtol=1e-13)
    assert np.ptp(truth[:, 6]) > 0.002
    assert np.abs(run["gyro"] - run["rate"]).max() < 1e-4
    # pairs of jets turn it without a net force, so that the common center of mass stays while the arm moves
    assert run["command"].any()
    np.testing.assert_allclose(run["velocity"], 0.0, atol=1e-8)
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    for other in (simulate(load_scenario(folder)), Run.load(folder)):
        for name in ("rate", "truth", "estimate", "joint_positions", "command"):
            np.testing.assert_array_equal(other[name], run[name], err_msg=name)
        assert other.components["joint_positions"] == ("shoulder", "elbow")


def test_joints_and_body_start_where_and_as_fast_as_they_are_told() -> None:
    start = ["plant.joints=[{joint: shoulder, position: 0.5, rate: 0.2}, {joint: elbow, held: true}]", "plant.moves=[]"]
    found = simulate(load_scenario("servicer_arm", ["duration_s=0.5", "maneuver=[]", *start]))
    joints = found["joint_positions"]
    np.testing.assert_array_equal(joints[0], [0.5, 0.0])
    assert joints[1, 0] - joints[0, 0] == pytest.approx(0.02, rel=0.05)
    np.testing.assert_allclose(joints[:, 1], 0.0, atol=1e-3)  # held
    # a simulator of one's own starts with the scenario's rates, or not at all
    diagram = closed_loop.build(load_scenario("servicer_slosh", ["plant.initial_rate=[0.01, 0, 0]"]))
    simulator = Simulator(diagram)
    with pytest.raises(InputError, match=r"moves at the start.*multibody.set_initial_velocities\(diagram, context\)"):
        simulator.Initialize()
    set_initial_velocities(diagram, simulator.get_mutable_context())
    simulator.Initialize()
    state = diagram.GetOutputPort("body_state").Eval(simulator.get_context())
    np.testing.assert_allclose(state[RATE], [0.01, 0.0, 0.0], atol=1e-15)
    Simulator(closed_loop.build(load_scenario("servicer_slosh"))).Initialize()  # at rest there is nothing to set


# --------------------------------------------------------------------- beside a plant of one's own


def flown_by(plant: MultibodyPlant, *overrides: str, **given: Any) -> Run:
    """A run of a user's own plant, flown by our autopilot and estimated."""
    scenario = load_scenario("servicer_slosh", ["duration_s=2", "plant.kind=rigid", *overrides])
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    flown = add_thrusters_and_sensors(builder, plant, scenario, "bus", **given)
    pilot, estimator = builder.AddSystem(autopilot.build(scenario)), builder.AddSystem(estimation.build(scenario))
    builder.Connect(flown.GetOutputPort("gyro"), pilot.GetInputPort("gyro"))
    for name in ("command", "held_command"):
        builder.Connect(pilot.GetOutputPort(name), flown.GetInputPort(name))
    for name in ("gyro", "acc"):
        builder.Connect(flown.GetOutputPort(name), estimator.GetInputPort(name))
    builder.Connect(pilot.GetOutputPort("held_command"), estimator.GetInputPort("jet_commands"))
    builder.Connect(estimator.GetOutputPort("reconfiguration"), pilot.GetInputPort("reconfiguration"))
    seen = [flown.GetOutputPort(tracker.get_name()) for tracker in given.get("star_trackers", ())]
    return simulate(scenario, diagram=builder, log=seen)


def test_a_plant_of_ones_own_is_flown_and_estimated() -> None:
    found = flown_by(arm(), star_trackers=(StarTracker("stars", noise_std=1e-4),))
    assert found["command"].any()
    assert found["rate"][-1, 0] > 0.01
    np.testing.assert_allclose(found["truth"][:, 9], 1.0 / 183.0, rtol=1e-13)
    (stars,) = (name for name in found.signals if "stars" in name)
    error = np.abs(np.sum(found[stars] * found["attitude"], axis=1))
    assert 0.0 < np.arccos(np.minimum(error, 1.0)).max() < 4e-4
    plant = MultibodyPlant(0.0)
    for name in ("bus", "debris"):  # which is not part of the vehicle
        plant.AddRigidBody(name, SpatialInertia.SolidCubeWithDensity(100.0, 1.0))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    found = flown_by(plant, "duration_s=0.5")
    np.testing.assert_allclose(found["truth"][:, 9], 1.0 / 100.0, rtol=1e-13)


def test_the_documentations_script_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (REPOSITORY / "docs" / "multibody.md").read_text(encoding="utf-8")
    script = page.partition("```python\n")[2].partition("```")[0]
    assert len([line for line in script.splitlines() if line]) <= 30
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    Path("my_servicer.sdf").write_text(ARM, encoding="utf-8")
    exec(script.replace('"plant.kind', '"duration_s=1", "plant.kind'), {})
    assert Run.load("runs/mine")["command"].any()
    assert Path("runs/mine/report.html").exists()


def test_the_tutorial_of_a_named_thruster_has_thirty_lines_at_most() -> None:
    text = (REPOSITORY / "docs" / "tutorials" / "named_thruster.py").read_text(encoding="utf-8")
    docstring, *code = ast.parse(text).body
    lines = [line for line in text.splitlines()[docstring.end_lineno :] if line and not line.startswith("#")]
    assert len(lines) <= 30
    assert all(len(line) <= 98 and ";" not in line for line in lines)
    assert len({statement.lineno for statement in code}) == len(code)


OWN = arm()


@pytest.mark.parametrize(
    ("plant", "body", "message"),
    [
        (arm(time_step=0.01), "bus", r"is discrete, with a time step of 0\.01 s"),
        (MultibodyPlant(0.0), "bus", r"is not finalized; call its Finalize\(\) first"),
        (OWN, "hull", r"'hull' is no body of the MultibodyPlant; bodies are: bus, forearm, payload, upper_arm"),
        (OWN, arm().GetBodyByName("bus"), r"body 'bus' must be one of the MultibodyPlant's own, and not its world"),
        (OWN, OWN.world_body(), r"body 'world' must be one of the MultibodyPlant's own, and not its world"),
        (OWN, BodyIndex(99), r"body 99: must be from 1 to 4, an index"),
    ],
)
def test_what_cannot_carry_jets_and_sensors_is_refused(plant: MultibodyPlant, body: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        add_thrusters_and_sensors(DiagramBuilder(), plant, load_vehicle("servicer"), body)


def test_jets_and_sensors_come_with_a_vehicle_alone_once_and_under_names_that_are_free() -> None:
    vehicle, builder, plant = load_vehicle("servicer"), DiagramBuilder(), arm()
    builder.AddSystem(plant)
    with pytest.raises(ValueError, match=r"vehicle 'air_bearing' moves in a plane"):
        add_thrusters_and_sensors(builder, plant, load_vehicle("air_bearing"), "bus")
    for names in (["gyro"], ["body_state"], ["stars", "stars"]):
        stars = [StarTracker(name, noise_std=0.0) for name in names]
        with pytest.raises(ValueError, match=rf"star tracker '{names[0]}': the vehicle has that name already"):
            add_thrusters_and_sensors(builder, plant, vehicle, "bus", star_trackers=stars)
    added = add_thrusters_and_sensors(builder, plant, vehicle, "bus", name="servicer")
    assert added.get_name() == "servicer"
    assert {"command", "held_command"} <= inputs(added).keys()
    assert outputs(added)["acc"] == 3
    with pytest.raises(ValueError, match=r"'applied_spatial_force' is connected already"):
        add_thrusters_and_sensors(builder, plant, vehicle, "bus", name="again")
