"""Meaning of the verdicts: three short flights, and what a run says of them.

python verdicts.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

from massprop_drake import load_scenario, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

# Turns about two axes. The estimates begin near the truth, so that the start is soon over.
BASE = [
    "duration_s=10",
    "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
    "joint={settled_after: 10, tank_fraction: 0}",
]
FLIGHTS = {
    "healthy": [],
    "leak": ["failures=[{kind: leak, jet: L4D, start_s: 7, force: 10}]"],  # lbf
    "wrong_thrusts": ["plant.thrust_dispersion=0.04"],  # 4 %, and the filter is told 1 %
}
runs = {
    name: simulate(load_scenario("orbiter_maneuver", [f"name={name}", *BASE, *change]))
    for name, change in FLIGHTS.items()
}

# Do the readings agree with what the filter claims?
for name in ("healthy", "wrong_thrusts"):
    consistency = runs[name].summary["consistency"]
    print(f"{name}: {consistency['verdict']}", *consistency["reasons"], sep="\n   ")

# Which parameters has the flight shown at all?
for entry in runs["healthy"].summary["identifiability"]:
    print(f"{entry['parameter']}: {entry['flag']}")

# What failed, and how surely? Beside it, what was done to the vehicle.
for name, run in runs.items():
    for found in run.summary["detections"]:
        force = f"{found['magnitude']:+.1f} +- {found['magnitude_std']:.1f} lbf"
        print(f"{name}: {found['kind']} of {' or '.join(found['jets'])}, {force}")
        print("   declared", f"{found['time_s'] - 7.0:.1f} s after it began")
    for injected in run.summary["injected"]:
        print(f"   injected: {injected['kind']} of {injected['jet']}, {injected['outcome']}")

runs["leak"].plot.failure_magnitude().savefig(folder / "failure_magnitude.png")
