"""Designs maneuvers: for a servicer's mass, for a jet that may leak, and for the orbiter.

python docs/tutorials/design_a_maneuver.py OUT
"""

import sys
from pathlib import Path

from massprop_drake import InputError, design, load_scenario, load_vehicle, simulate
from massprop_drake.display.figures import draw_plot
from massprop_drake.studies.design.pictures import firings
from massprop_drake.studies.design.saving import save, verdict

out = Path(sys.argv[1])

# What to fire
servicer = load_vehicle("servicer")
asked = {"mass": "1%", "inertia": "0.5%"}
found = design(servicer, asked, limits={"rate": "1 deg/s"}, flights=3)
for line in verdict(found):
    print(line["text"])
for pulse in found.scenario.jet_schedule:
    print(f"{pulse.jet} from {pulse.start_s:.1f} to {pulse.end_s:.1f} s")
save(found, out / "servicer_design")

# What cannot be had
for wanted, limits in (({"mass": "0.1%"}, {}), (asked, {"propellant": "0.0005 kg"})):
    try:
        design(servicer, wanted, limits=limits)
    except InputError as error:
        print(error)

# Which jet leaks
settings = ["estimation.filter=joint", "duration_s=30", "detector.kind=off"]
run = simulate(load_scenario("small_satellite_maneuver", settings))
test = design(run.scenario, suspects=["YP1", "YN2"], force="0.25 N", known=run)
for pair in test.pairs:
    print(f"{pair.jet} from {pair.other or 'nothing'}: {pair.after_s:.1f} s")
for jet, expected_s in test.expected_s.items():
    print(f"{jet} from all jets: {expected_s:.1f} s")
print(f"begins at {test.begins_s:.0f} s, {1000 * test.propellant:.2f} g")

# The orbiter
wanted = {"mass": "1%", "inertia": "1%"}
orbiter = design(load_vehicle("orbiter"), wanted, limits={"rate": "1 deg/s"})
print(f"{orbiter.propellant:.2f} slug in {orbiter.duration_s:.1f} s")

draw_plot(firings(found, servicer)).savefig(out / "design.png")
