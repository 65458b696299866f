"""A MultibodyPlant and its named thruster: python named_thruster.py [FOLDER]."""

import sys
from pathlib import Path

from pydrake.all import DiagramBuilder, MultibodyPlant, Parser

from massprop_drake import Scenario, simulate
from massprop_drake.diagrams import autopilot, multibody
from massprop_drake.systems import MassPropertyEstimator

# a plant of your own
builder = DiagramBuilder()
plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
Parser(plant).AddModels(str(Path(__file__).with_name("satellite.sdf")))
plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
plant.Finalize()

# what its designer knows, what it is told to do, and what fails, of which nobody is told
told = zip(3 * ["rhc"] + 3 * ["thc"], 2 * ["+x", "+y", "+z"], range(1, 31, 5), strict=True)
windows = [{"controller": c, "axis": a, "start_s": t, "end_s": t + 3} for c, a, t in told]
leak = {"jet": "YP1", "kind": "leak", "force": 0.2, "start_s": 35.0}
flight = Scenario(vehicle="servicer", duration_s=40.0, maneuver=windows, failures=[leak])

# thrusters and sensors on the plant, an autopilot, the estimator
body = multibody.add_thrusters_and_sensors(builder, plant, flight, "bus")
pilot = builder.AddSystem(autopilot.build(flight))
estimator = builder.AddSystem(MassPropertyEstimator(flight))
for name in ("command", "held_command"):
    builder.Connect(pilot.GetOutputPort(name), body.GetInputPort(name))
for name, reader in (("gyro", pilot), ("gyro", estimator), ("acc", estimator)):
    builder.Connect(body.GetOutputPort(name), reader.GetInputPort(name))
builder.Connect(pilot.GetOutputPort("held_command"), estimator.GetInputPort("jet_commands"))
builder.Connect(estimator.GetOutputPort("reconfiguration"), pilot.GetInputPort("reconfiguration"))

run = simulate(flight, diagram=builder)
for name, value, sigma, truth, _ in run.results.parameters:
    print(f"{name:8} {value:10.6f} ± {sigma:.6f}, truth {truth:10.6f}")
for found in run.results.detections:
    print(f"{found.jet}: {found.mode}, {found.magnitude:+.3f} N, named at {found.time_s:.1f} s")
run.save(Path(*sys.argv[1:]) / "named_thruster")
