"""A real vehicle: a satellite on air bearings with a jet that hardly pushes, and its twin.

python a_real_vehicle.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from massprop_drake import Run, estimate, load_scenario

records = Path(__file__).parent / "air_bearing"
folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

# Of the scenario the vehicle and the settings count, all of them the usual ones.
settings = load_scenario("air_bearing_pulses")


def estimated(name: str) -> Run:
    """Estimates from a record, by the map beside it."""
    return estimate(records / f"{name}.csv", settings, record_map=records / f"{name}_map.yaml")


hardware, twin = estimated("hardware"), estimated("twin")

# Which jets have failed?
for name, run in (("hardware", hardware), ("twin", twin)):
    print(f"{name}: {len(run.summary['detections'])} failed")
    for found in run.summary["detections"]:
        lost = f"{found['magnitude']:+.2f} +- {found['magnitude_std']:.2f} N"
        print(f"   {found['jet']}: {lost}, since {found['onset_s']:.1f} s")
        print(f"   declared after {found['time_s']:.1f} s, {found['statistic']:.1f} nats ahead")

# What do they weigh? Three scales said 23.09 kg; the Izz of the twin is 0.324 kg-m^2.
for name, run in (("hardware", hardware), ("twin", twin)):
    derived = run.summary["derived"]
    turn, sigma = (derived[key][2][2] for key in ("inertia", "inertia_std"))
    mass = f"m {derived['mass']:.1f} +- {derived['mass_std']:.1f} kg"
    print(f"{name}: {mass}, Izz {turn:.3f} +- {sigma:.3f}")

# What else moves the twin? Its simulator has a drag of 1.8 N/(m/s) and 0.3 N-m/(rad/s), and a
# torque that goes with the heading, -0.039 rad/s^2 times its cosine and 0.0055 times its sine.
own = twin.summary["derived"]
body = np.array([own["mass"], own["inertia"][2][2]])
for what, times in (("drag_rate", body), ("heading_turn", 1.0)):
    value, sigma = (times * twin[name][-1] for name in (what, f"{what}_std"))
    print(f"{what}: {value[0]:.3f} +- {sigma[0]:.3f}, {value[1]:.3f} +- {sigma[1]:.3f}")

# A fit by least squares, for comparison: turns over spans of rows against the impulses of the
# jets without T2, 0.12 s before.
vehicle = settings.vehicle_data
jets = vehicle.wrenches[:, 2] * (np.array(vehicle.designations) != "T2")
table = np.genfromtxt(records / "hardware.csv", delimiter=",", names=True)
torque = np.nan_to_num(hardware["command"]) @ jets
impulse = np.append(0.0, np.cumsum(torque[:-1] * np.diff(hardware.time_s)))
impulse = np.interp(hardware.time_s - 0.12, hardware.time_s, impulse)
for span in (5, 10, 20, 40):
    pushed, turned = (part[span:] - part[:-span] for part in (impulse, table["yaw_rate_radps"]))
    pushed, turned = pushed - pushed.mean(), turned - turned.mean()
    print(f"spans of {span} rows: Izz {pushed @ pushed / (pushed @ turned):.3f}")

hardware.save(folder / "hardware", pictures=False)
