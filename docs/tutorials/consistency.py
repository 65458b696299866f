"""Test of the stated uncertainty: NIS of samples, NEES of runs, and the effect of differencing.

python consistency.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from massprop_drake import load_scenario, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
SEEDS = range(3)  # more seeds say more; each takes half a second
SETTLED_S = 25.0  # the estimates are good from here on: what is left in the innovations is noise

# The same case with other sensors: Gaussian noise of the quantizers' variance, and no quantizer.
vehicle = load_scenario("sample_maneuver").vehicle_data
errors = [
    f"{{sensor: {package.name}, quantum: 0, noise_std: {package.quantum / 12**0.5}}}"
    for package in (*vehicle.gyros, *vehicle.accelerometers)
]
cases = {"quantized": [], "Gaussian": [f"sensors.errors=[{', '.join(errors)}]"]}


def repeatedly(overrides):
    """Runs the sample maneuver once for each seed."""
    return [
        simulate(load_scenario("sample_maneuver", [*overrides, f"seed={seed}"])) for seed in SEEDS
    ]


def nis(run, name):
    """Returns the NIS of a filter at the samples that it used, without those of the start."""
    used = (run[f"{name}_used"][:, 0] == 1.0) & (run.time_s > SETTLED_S)
    return run[f"{name}_nis"][used, 0]


def nees(run):
    """Computes the final squared error in units of its covariance: nine parameters, and 1/m."""
    error = run["estimate"][-1] - run["truth"][-1]
    # elements lie 20 powers of ten apart: solve in units of 1-sigma
    scale = np.sqrt(run.covariance.diagonal())
    correlation = run.covariance[:9, :9] / np.outer(scale[:9], scale[:9])
    rotation = error[:9] / scale[:9]
    return rotation @ np.linalg.solve(correlation, rotation), (error[9] / scale[9]) ** 2


def correlation_of_neighbors(run):
    """Correlates consecutive innovations of the rotation filter, where both were used."""
    used = run["rotation_used"][:, 0] == 1.0
    both = np.flatnonzero(used[:-1] & used[1:] & (run.time_s[1:] > SETTLED_S))
    innovation = run["rotation_innovation"]
    first, second = innovation[both].ravel(), innovation[both + 1].ravel()
    return float(first @ second / np.sqrt((first @ first) * (second @ second)))


results = {}
for name, overrides in cases.items():
    runs = repeatedly(overrides)
    rotation, mass = (
        np.concatenate([nis(run, which) for run in runs]) for which in ("rotation", "mass")
    )
    nees_rotation, nees_mass = np.mean([nees(run) for run in runs], axis=0)
    neighbors = np.mean([correlation_of_neighbors(run) for run in runs])
    results[name] = (rotation, mass, nees_rotation, nees_mass, neighbors)
    means = f"{rotation.mean():.2f} rotation, {mass.mean():.2f} mass"
    print(f"{name}: mean NIS {means} (3 where the model holds)")
    print(f"   mean NEES {nees_rotation:.1f} of nine parameters (9), {nees_mass:.2f} of 1/m (1)")
    print(f"   correlation of consecutive innovations {neighbors:+.2f}")

figure = Figure(figsize=(7.0, 3.0), dpi=100, layout="constrained")
marks = np.linspace(0.0, 14.0, 29)
panels = figure.subplots(1, 2, sharey=True)
for panel, (name, (rotation, mass, *_)) in zip(panels, results.items(), strict=True):
    panel.hist(rotation, marks, density=True, histtype="step", label="rotation")
    panel.hist(mass, marks, density=True, histtype="step", label="mass")
    panel.plot(marks, chi2.pdf(marks, 3), color="black", linewidth=0.8, label="chi-square, 3")
    panel.set(title=f"{name} sensors", xlabel="NIS", ylim=(0.0, 0.5))
    panel.legend(fontsize=8)
figure.savefig(folder / "nis.png")
