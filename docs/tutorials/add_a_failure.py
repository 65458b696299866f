"""A failed thruster: put it into a scenario, run it, read what was found.

python add_a_failure.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

from massprop_drake import load_scenario, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

# Two failures after the sample maneuver: a jet leaks, another one is dead when it is needed.
scenario = load_scenario(
    "sample_maneuver",
    [
        "name=leak_and_dead_jet",
        "duration_s=62",
        "failures[0]={kind: leak, jet: L4D, start_s: 50, force: 60}",  # lbf
        "failures[1]={kind: stuck_off, jet: F2R, start_s: 54}",
        "maneuver[13]={controller: rhc, axis: -z, start_s: 55, end_s: 60}",
    ],
)
run = simulate(scenario)

# One entry for each failure, not for each alarm.
for found in run.summary["detections"]:
    who = found["jet"] or f"one of cluster {found['cluster']}"
    magnitude = f"{found['magnitude']:+.1f} +- {found['magnitude_std']:.1f} lbf"
    print(f"{found['kind']}: {who}, {magnitude}, declared at {found['time_s']:.2f} s")

# Behind it: the likelihood argument of every jet at every sample, and which samples were tested.
tested = run["tested"][:, 0] == 1.0
before = run["likelihood"][tested & (run.time_s < 50.0)].max()
after = run["likelihood"][tested & (run.time_s >= 50.0)].max()
print(f"largest likelihood argument: {before:.0f} before 50 s, {after:.0f} after")

# What the autopilot does with it.
print("out of use:", run.summary["autopilot"]["jets_out_of_use"])

run.plot.detection_timeline().savefig(folder / "detection_timeline.png")
run.plot.failure_magnitude().savefig(folder / "failure_magnitude.png")
