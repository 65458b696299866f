"""A closed loop with a second gyro package: python build_a_diagram.py [FOLDER]."""

import sys
import tempfile
from pathlib import Path

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from massprop_drake import load_scenario
from massprop_drake.diagrams import autopilot, estimation, vehicle
from massprop_drake.display.graphs import dot_text
from massprop_drake.inputs.vehicle_sensors import Gyro

# the orbiter with a second gyro package; the filters average the two
scenario = load_scenario("sample_maneuver", ["sensors.combine.gyros=weighted_average"])
gyros = (*scenario.vehicle_data.gyros, Gyro(name="gyro_2", quantum=1.52e-6))  # rad/s
orbiter = scenario.vehicle_data.model_copy(update={"gyros": gyros})
scenario = scenario.model_copy(update={"vehicle": orbiter})

# the parts, then the signals between them by name
builder = DiagramBuilder()
pilot = builder.AddNamedSystem("autopilot", autopilot.build(scenario))
body = builder.AddNamedSystem("vehicle", vehicle.build(scenario))
estimators = builder.AddNamedSystem("estimation", estimation.build(scenario))
for name in ("command", "held_command"):
    builder.Connect(pilot.GetOutputPort(name), body.GetInputPort(name))
builder.Connect(body.GetOutputPort("gyro"), pilot.GetInputPort("gyro"))
for name in orbiter.sensor_names():  # gyro, gyro_2, acc1, acc2, acc3
    builder.Connect(body.GetOutputPort(name), estimators.GetInputPort(name))
builder.Connect(pilot.GetOutputPort("held_command"), estimators.GetInputPort("jet_commands"))
builder.ExportOutput(estimators.GetOutputPort("estimate"), "estimate")
loop = builder.Build()

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
(folder / "my_loop.dot").write_text(dot_text(loop, depth=1), encoding="utf-8")
simulator = Simulator(loop)
simulator.AdvanceTo(scenario.duration_s)
mass = 1.0 / loop.GetOutputPort("estimate").Eval(simulator.get_context())[9]
print(f"mass {mass:.0f} slug; the graph is {folder / 'my_loop.dot'}")
