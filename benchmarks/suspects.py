"""Predicted against flown times to tell which jet of a group leaks: drawn groups, forces and seeds.

    python benchmarks/suspects.py --groups 40 --first 0 --out suspects.json

Each vehicle flies its bundled maneuver first; then firings are designed that tell one of two or four jets near each
other, and flown with one of these that leaks. Beside it, how soon it is named where nothing is fired.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from massprop_drake import Run, design, load_scenario, simulate
from massprop_drake.studies.design.verification import fly_until_named_s

BEFORE = ("small_satellite_maneuver", "lander_maneuver", "cubesat_leak", "orbiter_maneuver")
SHORTER = ["estimation.filter=joint", "detector.kind=hypotheses", "failures=[]", "duration_s=40"]


def near(positions: np.ndarray, one: int, number: int) -> list[int]:
    """Returns the indices of a number of jets, the nearest to one of them, with it."""
    order = np.argsort(np.linalg.norm(positions - positions[one], axis=1), kind="stable")
    return [int(each) for each in order[:number]]


def measured(run: Run, number: int) -> dict[str, object]:
    """Computes predicted and flown time of one drawn group."""
    random, vehicle = np.random.default_rng([number, 45]), run.scenario.vehicle_data
    one, size = int(random.integers(len(vehicle.jets))), int(random.choice((2, 4)))
    jets = near(np.array([jet.position for jet in vehicle.jets]), one, size)
    names, leaks = [vehicle.designations[jet] for jet in jets], bool(random.integers(2))
    share = float(random.uniform(0.03, 0.1) if leaks else -random.uniform(0.2, 0.5))
    failing = names[int(random.integers(len(names)))]
    made = design(vehicle, suspects=names, force=f"{100 * share:.3g}%", known=run)
    (size, *_) = [pair.force for pair in made.pairs if pair.jet == failing]
    named = fly_until_named_s(made, failing, size, number, vehicle)
    return {
        "vehicle": vehicle.name,
        "group": names,
        "failing": failing,
        "force": size,
        "predicted_s": made.expected_s[failing],
        "flown_s": named,
        "propellant": made.propellant,
    }


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--groups", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--out", type=Path, help="file for all numbers, JSON")
    asked = parser.parse_args()
    runs = [simulate(load_scenario(name, SHORTER), look_back=False) for name in BEFORE]
    rows = []
    for number in range(asked.first, asked.first + asked.groups):
        rows.append(measured(runs[number % len(runs)], number))
        print(json.dumps(rows[-1]), flush=True)
        if asked.out:
            asked.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    ratios = [row["flown_s"] / row["predicted_s"] for row in rows if row["flown_s"] and row["predicted_s"]]
    within = sum(1 / 1.5 <= ratio <= 1.5 for ratio in ratios)
    print(f"named: {len(ratios)} of {len(rows)}; flown within a factor of 1.5 of predicted: {within}")


if __name__ == "__main__":
    main()
