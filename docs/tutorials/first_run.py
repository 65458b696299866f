"""A first run: simulate a scenario, read the estimates, draw them, keep the run.

python first_run.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

from massprop_drake import Run, load_scenario, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

# A scenario says what the vehicle is told to do, what is true of it, and how it is estimated.
scenario = load_scenario("sample_maneuver", ["seed=3"])
run = simulate(scenario)

# The estimates at the end, beside the truth. Both have ten elements in one fixed order.
names = run.components["estimate"]
estimate, sigma, truth = (run[name][-1] for name in ("estimate", "standard_deviation", "truth"))
for name, value, deviation, true in zip(names, estimate, sigma, truth, strict=True):
    print(f"{name:6} {value:12.5g} +- {deviation:8.2g}   truth {true:12.5g}")

# The same by quantity, and what follows from it, as in summary.json.
mass, mass_std = run.summary["derived"]["mass"], run.summary["derived"]["mass_std"]
print(f"mass   {mass:.0f} +- {mass_std:.0f} slug")

# Every logged signal is an array with a row for each sample; its unit is beside it.
print("rate:", run["rate"].shape, run.units["rate"], run.components["rate"])

# When did the estimates become good enough to act on?
converged = run["converged"][:, 0] == 1.0
converged_s = float(run.time_s[converged][0])
print(f"converged at {converged_s:.2f} s")

# Figures are matplotlib figures; a run's folder holds all of them, and everything else.
run.plot.mass_reciprocal().savefig(folder / "mass_reciprocal.png")
run.save(folder / "first", pictures=False)
again = Run.load(folder / "first")
print("read back:", again)
