"""A sensor of your own: a second gyro package, written as a Drake system, that loses readings.

python add_a_sensor.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake import load_scenario
from massprop_drake.diagrams import autopilot, estimation, vehicle
from massprop_drake.display.graphs import dot_text
from massprop_drake.inputs.vehicle_sensors import Gyro
from massprop_drake.maths.noise import normal_sample, uniform_sample
from massprop_drake.maths.vehicle.rigid_body import N_STATE, RATE

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())


class RadioGyro(LeafSystem):
    """Three rate gyros behind a radio link: noisy, and some readings never arrive.

    Ports:
        body_state (in, 23): the truth, see `RigidBodyPlant`.
        reading (out, 3): rate, rad/s, body axes; NaN where it is lost.
    """

    def __init__(self, name, *, noise_std, loss_rate, period_s, seed):
        super().__init__()
        self.set_name(name)
        self._noise_std, self._loss_rate = noise_std, loss_rate
        self._period_s, self._seed = period_s, seed
        self._body_state = self.DeclareVectorInputPort("body_state", N_STATE)
        self.DeclareVectorOutputPort("reading", 3, self._calc_reading)

    def _calc_reading(self, context, output):
        # a function of the sample number alone: the log and the filter both ask for it
        number = round(context.get_time() / self._period_s)
        rate = self._body_state.Eval(context)[RATE]
        lost = uniform_sample(self._seed, "radio losses", number) < self._loss_rate
        noise = self._noise_std * normal_sample(self._seed, "radio noise", number, 3)
        output.SetFromVector(np.full(3, np.nan) if lost else rate + noise)


# The estimators must know of the package: an entry in the vehicle gives it a port and a variance.
scenario = load_scenario("sample_maneuver", ["sensors.combine.gyros=weighted_average"])
period_s, noise_std = scenario.vehicle_data.sample_period_s, 1.0e-6
gyros = (*scenario.vehicle_data.gyros, Gyro(name="radio_gyro", noise_std=noise_std))
orbiter = scenario.vehicle_data.model_copy(update={"gyros": gyros})
known = scenario.model_copy(update={"vehicle": orbiter})

# The vehicle diagram is built without the package: ours stands beside it.
builder = DiagramBuilder()
pilot = builder.AddNamedSystem("autopilot", autopilot.build(scenario))
body = builder.AddNamedSystem("vehicle", vehicle.build(scenario))
radio_gyro = builder.AddSystem(
    RadioGyro(
        "radio_gyro", noise_std=noise_std, loss_rate=0.3, period_s=period_s, seed=scenario.seed
    )
)
estimators = builder.AddNamedSystem("estimation", estimation.build(known))

for name in ("command", "held_command"):
    builder.Connect(pilot.GetOutputPort(name), body.GetInputPort(name))
builder.Connect(body.GetOutputPort("gyro"), pilot.GetInputPort("gyro"))
builder.Connect(pilot.GetOutputPort("held_command"), estimators.GetInputPort("jet_commands"))
for name in scenario.vehicle_data.sensor_names():
    builder.Connect(body.GetOutputPort(name), estimators.GetInputPort(name))
builder.Connect(body.GetOutputPort("body_state"), radio_gyro.GetInputPort("body_state"))
builder.Connect(radio_gyro.GetOutputPort("reading"), estimators.GetInputPort("radio_gyro"))

# Logs take the name of an output port and the sample period.
wanted = {
    "reading": radio_gyro,
    "estimate": estimators,
    "standard_deviation": estimators,
    "mass_properties": body,
}
logs = {
    name: LogVectorOutput(part.GetOutputPort(name), builder, period_s)
    for name, part in wanted.items()
}
diagram = builder.Build()
diagram.set_name("with_radio_gyro")
(folder / "with_radio_gyro.dot").write_text(dot_text(diagram, depth=1), encoding="utf-8")

simulator = Simulator(diagram)
simulator.AdvanceTo(scenario.duration_s)
data = {name: log.FindLog(simulator.get_context()).data().copy() for name, log in logs.items()}

lost = int(np.isnan(data["reading"][0]).sum())
error = (data["estimate"] - data["mass_properties"])[:, -1]
ratio = error / data["standard_deviation"][:, -1]
print(f"{lost} of {data['reading'].shape[1]} readings lost")
print("errors in units of their own 1-sigma:", np.round(ratio, 1))
