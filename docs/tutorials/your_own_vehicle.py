"""A vehicle of your own: check its file, fly it, and estimate from the log, row by row.

python your_own_vehicle.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from massprop_drake import Estimator, load_scenario, load_vehicle, simulate
from massprop_drake.studies.vehicle_report import vehicle_report

here = Path(__file__).parent
folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

# What the jets and sensors can do at all, before anything flies: massprop check says the same.
tug = load_vehicle(here / "tug.yaml")
report = vehicle_report(tug)
rank, seen = report["control"]["rank"], report["observability"]["rank"]
print(
    f"{len(tug.jets)} jets push in {rank} directions of 6; {seen} of 10 mass properties can show"
)

# A simulated flight stands in for the real one. Its log is telemetry.csv.
scenario = load_scenario(here / "tug_with_load.yaml")
flight = simulate(scenario)
log = flight.save(folder / "flight", pictures=False) / "telemetry.csv"

# The log alone: time, readings in body axes, commanded fractions. Empty cells become NaN.
rows = np.genfromtxt(log, delimiter=",", names=True)
rates = np.stack([rows[f"gyro_{axis}"] for axis in "xyz"], axis=1)
velocities = np.stack([rows[f"imu_{axis}"] for axis in "xyz"], axis=1)
commands = np.stack([rows[f"jet_{jet.designation}"] for jet in tug.jets], axis=1)

# One call for each row. It starts at the vehicle file's values with their uncertainty. Of the
# scenario only the settings of sensors, filters and detector count: its truth stays unknown.
estimator = Estimator(tug, scenario)
log_rows = zip(rows["time_s"], rates, velocities, commands, strict=True)
steps = [estimator.step(*row) for row in log_rows]
last = steps[-1]
mass, mass_std = 1.0 / last.estimate[9], last.standard_deviation[9] / last.estimate[9] ** 2
print(f"mass {mass:.1f} +- {mass_std:.1f} kg; the truth is {1.0 / flight['truth'][-1][9]:.1f} kg")
center, true_center = last.estimate[6:9], flight["truth"][-1][6:9]
print("center of mass", np.round(center, 4), "m; the truth is", true_center)
print("the flight's own estimates again:", np.array_equal(last.estimate, flight["estimate"][-1]))
print("samples used:", sum(step.used for step in steps), "of", len(steps))
print("jets that have failed:", last.removed.sum())

flight.plot.center_of_mass().savefig(folder / "tug_center_of_mass.png")
