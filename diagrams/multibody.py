"""Jets and sensors of a vehicle beside a MultibodyPlant of the user's own.

command, held_command --> reaction_jets --wrench--> body_bridge --spatial_forces--> MultibodyPlant
gyros, accelerometers <--------------body_state---- body_bridge <--body_poses, ...--------'
"""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from massprop_drake.diagrams import vehicle as vehicle_diagram
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.systems.multibody.body_motion import FROM_PLANT
from massprop_drake.systems.multibody.multibody_vehicle import TRUTH, BodyBridge, MultibodyVehicle
from massprop_drake.systems.multibody.star_tracker import StarTracker


def set_initial_velocities(diagram: Diagram, context: Context) -> None:
    """Writes the velocities at the start into a context: in a MultibodyPlant's default one, all are zero.

    `simulate` does so. A simulator of the user's own needs it where the scenario has rates at the start.

    Args:
        diagram: whole, with vehicles of scenarios somewhere in it; a plant of the user's own is left alone.
        context: of the diagram, mutable.
    """
    for system in diagram.GetSystems():
        if isinstance(system, MultibodyVehicle):
            system.set_initial_velocities(context)
        elif isinstance(system, Diagram):
            set_initial_velocities(system, context)


def add_thrusters_and_sensors(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    vehicle: Vehicle | Scenario,
    body: str | RigidBody | BodyIndex,
    *,
    star_trackers: Sequence[StarTracker] = (),
    name: str = "thrusters_and_sensors",
) -> Diagram:
    """Adds jets and sensors of a vehicle to a MultibodyPlant that is in a builder already, and connects them.

    The diagram that is added has the ports of the `vehicle` diagram: `command` and `held_command`, of wheels
    `wheel_torque` in; each gyro and accelerometer, `body_state`, `structure`, `mass_properties` and `thrust` out. The
    plant's port `applied_spatial_force` is connected then.

    Args:
        builder: that the plant is in.
        plant: continuous and finalized.
        vehicle: such as `load_vehicle("servicer")`, in the units of the plant; or a scenario with one, for failures,
            sensor errors, disturbance and seed. Its `plant` but for these plays no part.
        body: name, index or the body itself, which carries jets and sensors; its frame is the vehicle frame.
        star_trackers: sensors of the attitude besides; a port each, by its name.
        name: of the diagram.

    Raises:
        ValueError: when the plant is discrete, not finalized, has no such body, or its forces come from elsewhere; the
            vehicle moves in a plane; or a star tracker has the name of another part.
    """
    scenario = vehicle if isinstance(vehicle, Scenario) else Scenario(vehicle=vehicle)
    if scenario.vehicle_data.motion == "planar":
        raise ValueError(f"vehicle '{scenario.vehicle_data.name}' moves in a plane, which a MultibodyPlant knows not")
    taken = [*TRUTH, "thrust", "spatial_forces", "reaction_jets", "body_bridge", "noise_source", "noise_seed"]
    taken += ["reaction_wheels", "wheel_torque", "wheel_speeds"]
    taken += [sensor.name for sensor in (*scenario.vehicle_data.sensors, *scenario.vehicle_data.tracked)]
    for tracker in star_trackers:
        if tracker.get_name() in taken:
            raise ValueError(f"star tracker '{tracker.get_name()}': the vehicle has that name already; give another")
        taken.append(tracker.get_name())
    if isinstance(scenario.plant, PlantBlock):
        continuous = scenario.plant.model_copy(update={"time_step": 0.0})
        scenario = scenario.model_copy(update={"plant": continuous})
    bridge = BodyBridge(plant, body, wheels=bool(scenario.vehicle_data.wheels))
    forces = plant.get_applied_spatial_force_input_port()
    if builder.IsConnectedOrExported(forces):
        raise ValueError(
            "the MultibodyPlant's port 'applied_spatial_force' is connected already; connect an "
            "ExternallyAppliedSpatialForceMultiplexer in its place, and to that Thrusters and the sensors one by one"
        )
    added = vehicle_diagram.build(scenario, bridge, star_trackers)
    added.set_name(name)
    builder.AddSystem(added)
    for port in FROM_PLANT:
        builder.Connect(plant.GetOutputPort(port), added.GetInputPort(port))
    builder.Connect(added.GetOutputPort("spatial_forces"), forces)
    return added
