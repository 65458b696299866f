"""Wheels, on-times, trackers, tanks, engines: python your_spacecraft.py [FOLDER]."""

import sys
import tempfile
from pathlib import Path

import numpy as np

from massprop_drake import Run, estimate, load_scenario, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())


def told(run: Run) -> None:
    """Prints the findings of a run."""
    found = run.results
    off = np.nanmax(abs(found.estimates - found.truth) / found.standard_deviations)
    within = 3 if off < 3.0 else f"{off:.0f}"
    print(f"  {found.consistency.verdict}; all parameters within {within} sigma")
    for one in found.detections:
        print(f"  {one.jet} {one.mode}, named after {one.time_s - one.onset_s:.1f} s")


# A servicer: wheels hold it, thrusters pulse for 10 ms and longer, a tracker at 4 Hz, a tank.
servicer = simulate(load_scenario("servicer_on_wheels_leak"))
print("servicer on wheels")
told(servicer)
share = 100.0 * servicer.results.standard_deviations / abs(servicer.results.truth)
print(f"  moments known to {share[:3].max():.1f} %, mass to {share[9]:.1f} %, thrusts to 2 %")

# Its telemetry: a column for each wheel's speed, on-times and their onsets.
log = servicer.save(folder / "servicer", pictures=False) / "telemetry.csv"
rows = [line.split(",") for line in log.read_text(encoding="utf-8").splitlines()]
print(
    "  columns:", *(name for name in rows[0] if name.startswith(("RW1", "tracker", "onset_XP1")))
)

# The same from files, each with its own times: here the tracker's alone, and all the others.
for file, own in (("tracker.csv", True), ("bus.csv", False)):
    keep = [k for k, name in enumerate(rows[0]) if k > 0 and name.startswith("tracker") is own]
    lines = [",".join(row[k] for k in (0, *keep)) for row in rows if any(row[k] for k in keep)]
    (folder / file).write_text("\n".join(lines) + "\n", encoding="utf-8")
again = estimate([folder / "bus.csv", folder / "tracker.csv"], servicer.scenario)
moved = abs(again.results.estimates - servicer.results.estimates).max()
jet, same = again.results.detections[0].jet, "the same" if moved < 1e-9 else f"off by {moved}"
print(f"  from two files: {jet} named again, estimates {same}")

# A lander that burns its engine, which points half a degree beside its axis.
print("lander, engine half a degree off")
told(simulate(load_scenario("lander_burn")))

# A CubeSat without an accelerometer.
print("CubeSat, no accelerometer")
told(simulate(load_scenario("cubesat_leak")))
