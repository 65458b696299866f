"""Claims of a probability: how sure the filter is of a leak, and how often it is right.

python probability.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from massprop_drake import load_scenario, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
ONSET_S, LEAKING = 47.0, "ZP1"
SEEDS = range(4)  # more seeds say more; each takes a few seconds


def flown(*overrides, leak=0.05, until_s=52):
    """Simulates a flight of the small satellite, one of whose jets leaks 1 % of its thrust."""
    failure = f"{{kind: leak, jet: {LEAKING}, start_s: {ONSET_S}, force: {leak}}}"  # N
    given = [f"duration_s={until_s}", f"failures=[{failure}]", *overrides]
    return simulate(load_scenario("small_satellite_leak", given))


# What does it say, sample by sample?
run = flown()
jets = run.scenario.vehicle_data.designations
probability, none = run["fault_probability"], run["none_probability"][:, 0]
print("time, s   nothing   likeliest jets")
for time_s in (46.9, 47.2, 47.4, 47.6, 47.8, 49.0, 51.0):
    row = int(np.argmin(abs(run.time_s - time_s)))
    order = np.argsort(-probability[row], kind="stable")
    likely = [jet for jet in order if probability[row, jet] > 0.001]
    said = ", ".join(f"{jets[jet]} {probability[row, jet]:.3f}" for jet in likely)
    print(f"{time_s:7.1f}   {none[row]:7.3f}   {said or 'no jet'}")

# How sure must it be?
doubted = {rate: flown(f"faults.false_per_hour={rate}") for rate in ("3e-4", "1e-10")}
for rate, flight in doubted.items():
    for found in flight.results.detections:
        after_s = found.time_s - ONSET_S
        print(f"{rate} per hour: {found.jet} declared {after_s:.1f} s after its onset")

# What if no jet has failed, or nothing known explains the readings?
gusts = ["plant.disturbance.force_std=[0.5, 0.5, 0.5]", "plant.disturbance.correlation_time_s=1"]
others = {
    "healthy": flown("failures=[]"),
    "gusts": flown("failures=[]", *gusts, until_s=30),
}
for name, other in others.items():
    end = other.summary["fault_probability"]
    print(f"{name}: none {end['none']:.3f}, unknown {end['unknown']:.3f}")

# How often is it right?
EDGES = (0.5, 0.9, 0.99, 0.999)
claims, right = [], []
for seed in SEEDS:
    for leak in (0.02, 0.05):
        flight = flown(f"seed={seed}", leak=leak)
        rows, which = np.nonzero(flight["fault_probability"] >= EDGES[0])
        claims.extend(flight["fault_probability"][rows, which])
        right.extend((which == jets.index(LEAKING)) & (flight.time_s[rows] > ONSET_S))
claims, right = np.array(claims), np.array(right)
for low, high in zip(EDGES, (*EDGES[1:], 1.1), strict=True):
    among = (claims >= low) & (claims < high)
    print(f"from {low}: {right[among].sum()} of {among.sum()} right")

figure = Figure(figsize=(7.0, 3.0), dpi=100, layout="constrained")
axes = figure.subplots()
around = run.time_s > ONSET_S - 0.5
for jet in np.flatnonzero(probability.max(axis=0) > 0.1):
    axes.step(run.time_s[around], probability[around, jet], where="post", label=jets[jet])
axes.step(run.time_s[around], none[around], where="post", color="black", label="none")
for found in run.results.detections:
    axes.axvline(found.time_s, color="0.5", linestyle=":", label="declared")
axes.set(xlabel="time, s", ylabel="probability")
axes.legend(fontsize=8)
figure.savefig(folder / "probability.png")
