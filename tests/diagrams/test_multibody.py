"""Vehicles that are MultibodyPlants: scenarios with a model, and jets and sensors beside a plant of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from multibody_probe import ARM, arm
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake import InputError, Run, load_scenario, load_vehicle, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation
from massprop_drake.diagrams.multibody import add_thrusters_and_sensors, require_model, set_initial_velocities
from massprop_drake.maths.vehicle.rigid_body import RATE
from massprop_drake.systems.multibody import StarTracker

EARLY = ("duration_s=4", "plant.moves=[{joint: shoulder, start_s: 1, end_s: 3, position: 1.0}]")
GOOD = load_scenario("servicer_arm").plant.model  # type: ignore[union-attr]


@pytest.fixture(scope="module")
def run() -> Run:
    """The servicer whose arm moves early."""
    return simulate(load_scenario("servicer_arm", list(EARLY)))


def test_a_scenario_flies_a_model_with_the_truth_of_its_bodies(run: Run) -> None:
    joints, truth = run["joint_positions"], run["truth"]
    assert run.components["joint_positions"] == ("shoulder", "elbow")
    assert run.units["joint_positions"] == "rad"
    np.testing.assert_allclose(joints[0], [1.57, -2.8], atol=0.0)
    assert joints[-1, 0] == pytest.approx(1.0, abs=2e-3)
    assert np.ptp(joints[:, 1]) > 0.05  # the elbow is free
    np.testing.assert_allclose(truth[:, 9], 1.0 / 183.0, rtol=1e-13)
    assert np.ptp(truth[:, 6]) > 0.005
    assert np.abs(run["gyro"] - run["rate"]).max() < 1e-4
    # pairs of jets turn it without a net force, so that the common center of mass stays while the arm moves
    assert run["command"].any()
    np.testing.assert_allclose(run["velocity"], 0.0, atol=1e-8)


def test_a_run_folder_runs_again_without_the_model_and_reads_back(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    again = simulate(load_scenario(folder))
    read = Run.load(folder)
    for name in ("rate", "truth", "estimate", "joint_positions", "command"):
        np.testing.assert_array_equal(again[name], run[name], err_msg=name)
        np.testing.assert_array_equal(read[name], run[name], err_msg=name)
    assert read.components["joint_positions"] == ("shoulder", "elbow")


def test_joints_start_where_and_as_fast_as_they_are_told(tmp_path: Path) -> None:
    start = ("plant.joints=[{joint: shoulder, position: 0.5, rate: 0.2}, {joint: elbow, held: true}]", "plant.moves=[]")
    found = simulate(load_scenario("servicer_arm", ["duration_s=0.5", "maneuver=[]", *start]))
    joints = found["joint_positions"]
    np.testing.assert_array_equal(joints[0], [0.5, 0.0])
    assert joints[1, 0] - joints[0, 0] == pytest.approx(0.02, rel=0.05)
    np.testing.assert_allclose(joints[:, 1], 0.0, atol=1e-3)  # held
    np.testing.assert_allclose(found["velocity"][:1], 0.0, atol=1e-15)


def test_a_simulator_of_ones_own_starts_with_the_scenarios_rates_or_not_at_all() -> None:
    scenario = load_scenario("servicer_slosh", ["plant.initial_rate=[0.01, 0, 0]"])
    diagram = closed_loop.build(scenario)
    simulator = Simulator(diagram)
    with pytest.raises(InputError, match=r"moves at the start.*multibody.set_initial_velocities\(diagram, context\)"):
        simulator.Initialize()
    set_initial_velocities(diagram, simulator.get_mutable_context())
    simulator.Initialize()
    state = diagram.GetOutputPort("body_state").Eval(simulator.get_context())
    np.testing.assert_allclose(state[RATE], [0.01, 0.0, 0.0], atol=1e-15)
    Simulator(closed_loop.build(load_scenario("servicer_slosh"))).Initialize()  # at rest there is nothing to set


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["plant.body=hull"], r"plant\.body: 'hull' is no body of the MultibodyPlant; bodies are: bus, forearm"),
        (["plant.joints=[{joint: wrist}]"], r"plant\.joints\[0\]\.joint: 'wrist' is no joint of one degree of freedom"),
        (
            ["plant.moves=[{joint: grip, start_s: 0, end_s: 1, position: 0}]"],
            r"plant\.moves\[0\]\.joint: 'grip' is no joint of one degree of freedom in the model; joints are: elbow",
        ),
        (
            [f"plant.model={GOOD.replace('51.3', '-51.3')!r}"],
            r"plant\.model: Drake cannot read this SDF: A link named bus",
        ),
        (
            [f"plant.model={GOOD.replace('51.3', '513')!r}"],
            r"plant\.model: Drake cannot read this SDF: A link named bus",
        ),
        (
            [f"plant.model={GOOD.replace('revolute', 'turning')!r}"],
            r"Drake cannot read this SDF: Joint type of turning",
        ),
        (
            [f"plant.model={GOOD.replace('<parent>bus<', '<parent>world<')!r}", "plant.body=forearm"],
            r"plant\.body: body 'forearm' must be free, but a joint holds it to the world; leave that joint out",
        ),
    ],
)
def test_what_drake_or_the_model_does_not_have_gets_one_message(overrides: list[str], message: str) -> None:
    scenario = load_scenario("servicer_arm", [one.replace("\\n", " ").replace("\\'", "'") for one in overrides])
    with pytest.raises(InputError, match=message) as caught:
        simulate(scenario)
    assert len(caught.value.problems) == 1
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=message):
        require_model(scenario)


def test_a_urdf_flies_too() -> None:
    urdf = (
        "<robot name='m'><!-- not <sdf> --><link name='bus'><inertial><origin xyz='0.02 0 -0.01'/><mass value='180'/>"
        "<inertia ixx='50' iyy='26' izz='55' ixy='0' ixz='0' iyz='0'/></inertial></link></robot>"
    )
    found = simulate(load_scenario("servicer_slosh", ["duration_s=0.5", f'plant.model="{urdf}"']))
    np.testing.assert_allclose(found["truth"][-1, 6:], [0.02, 0.0, -0.01, 1.0 / 180.0], rtol=1e-12, atol=1e-14)
    assert "joint_positions" not in found.signals


def test_a_rigid_plant_has_no_model_to_check() -> None:
    require_model(load_scenario("sample_maneuver"))


# --------------------------------------------------------------------- beside a plant of one's own


def _flown(plant: MultibodyPlant, *overrides: str, **given: Any) -> tuple[Run, dict[str, np.ndarray]]:
    """A run of a user's own plant, flown by our autopilot and estimated, and what star trackers read."""
    scenario = load_scenario("servicer_slosh", ["duration_s=3", "plant.kind=rigid", *overrides])
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
    found = simulate(scenario, diagram=builder, log=seen)
    return found, {name: found[name] for name in found.signals if "stars" in name}


def test_a_plant_of_ones_own_is_flown_estimated_and_reported(tmp_path: Path) -> None:
    found, seen = _flown(arm(), star_trackers=(StarTracker("stars", noise_std=1e-4),))
    assert found["command"].any()
    assert found["rate"][-1, 0] > 0.01
    np.testing.assert_allclose(found["truth"][:, 9], 1.0 / 183.0, rtol=1e-13)
    (readings,) = seen.values()
    error = np.abs(np.sum(readings * found["attitude"], axis=1))
    assert 0.0 < np.arccos(np.minimum(error, 1.0)).max() < 4e-4
    folder = found.save(tmp_path / "own", pictures=False)
    assert (folder / "report.html").exists()


def test_the_documentations_script_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "multibody.md").read_text(encoding="utf-8")
    script = page.partition("```python\n")[2].partition("```")[0]
    assert len([line for line in script.splitlines() if line]) <= 30
    monkeypatch.chdir(tmp_path)
    Path("my_servicer.sdf").write_text(ARM, encoding="utf-8")
    exec(script.replace('"plant.kind', '"duration_s=1", "plant.kind'), {})
    assert Run.load("runs/mine")["command"].any()
    assert Path("runs/mine/report.html").exists()


def test_jets_and_sensors_come_with_a_vehicle_alone() -> None:
    plant, builder = arm(), DiagramBuilder()
    builder.AddSystem(plant)
    flown = add_thrusters_and_sensors(builder, plant, load_vehicle("servicer"), "bus", name="servicer")
    log = LogVectorOutput(flown.GetOutputPort("acc"), builder, 0.1)
    assert flown.get_name() == "servicer"
    assert {"command", "held_command"} <= {flown.get_input_port(i).get_name() for i in range(flown.num_input_ports())}
    assert log.get_input_port().size() == 3


def test_what_cannot_carry_them_is_refused() -> None:
    vehicle, builder = load_vehicle("servicer"), DiagramBuilder()
    discrete = builder.AddSystem(arm(time_step=0.01))
    with pytest.raises(ValueError, match=r"is discrete, with a time step of 0\.01 s"):
        add_thrusters_and_sensors(builder, discrete, vehicle, "bus")
    plant = builder.AddNamedSystem("continuous", arm())
    with pytest.raises(ValueError, match=r"'hull' is no body of the MultibodyPlant; bodies are: bus"):
        add_thrusters_and_sensors(builder, plant, vehicle, "hull")
    with pytest.raises(ValueError, match=r"body 'bus' must be one of the MultibodyPlant's own, and not its world"):
        add_thrusters_and_sensors(builder, plant, vehicle, arm().GetBodyByName("bus"))
    with pytest.raises(ValueError, match=r"body 'world' must be one of the MultibodyPlant's own, and not its world"):
        add_thrusters_and_sensors(builder, plant, vehicle, plant.world_body())
    with pytest.raises(ValueError, match=r"body 99: must be from 1 to 4, an index"):
        add_thrusters_and_sensors(builder, plant, vehicle, BodyIndex(99))
    with pytest.raises(ValueError, match=r"vehicle 'air_bearing' moves in a plane"):
        add_thrusters_and_sensors(builder, plant, load_vehicle("air_bearing"), "bus")
    for names in (["gyro"], ["body_state"], ["stars", "stars"]):
        stars = [StarTracker(name, noise_std=0.0) for name in names]
        with pytest.raises(ValueError, match=rf"star tracker '{names[0]}': the vehicle has that name already"):
            add_thrusters_and_sensors(builder, plant, vehicle, "bus", star_trackers=stars)
    add_thrusters_and_sensors(builder, plant, vehicle, "bus")
    with pytest.raises(ValueError, match=r"'applied_spatial_force' is connected already"):
        add_thrusters_and_sensors(builder, plant, vehicle, "bus", name="again")


def test_a_plant_may_have_a_body_that_is_not_part_of_the_vehicle() -> None:
    plant = MultibodyPlant(0.0)
    for name in ("bus", "debris"):
        plant.AddRigidBody(name, SpatialInertia.SolidCubeWithDensity(100.0, 1.0))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    found, _ = _flown(plant, "duration_s=0.5")
    np.testing.assert_allclose(found["truth"][:, 9], 1.0 / 100.0, rtol=1e-13)
