"""Predicted against flown: designs of maneuvers for several vehicles and targets, flown with drawn vehicles.

    python benchmarks/designs.py --seeds 20 --out designs.json

Each vehicle is designed for as its file has it, and flown with mass, center of mass, axes and thrusts drawn about that.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from massprop_drake import Scenario, design, load_vehicle
from massprop_drake.inputs.true_blocks import Dispersion, PlantBlock

VEHICLES = ("small_satellite", "servicer", "servicer_on_wheels", "lander", "orbiter")
TARGETS = ({"mass": "1%"}, {"inertia": "1%"}, {"mass": "1%", "inertia": "0.5%"})
SPREAD = Dispersion(mass_percent=5.0, axes_deg=2.0)


def case(name: str, start: str) -> Scenario:
    """Draws a vehicle's truth, estimated from its stated start or from zero."""
    vehicle = load_vehicle(name)
    plant = PlantBlock(thrust_dispersion=float(vehicle.thrust_uncertainties.max()), dispersion=SPREAD)
    return Scenario(vehicle=vehicle, plant=plant, estimation={"filter": "joint", "start": start})


def measured(name: str, start: str, targets: dict[str, str], seeds: int) -> dict[str, object]:
    """Computes ratios of flown to predicted 1-sigma, and errors in flown sigmas, of one design."""
    began = time.perf_counter()
    found = design(case(name, start), targets, limits={"rate": "2 deg/s"}, flights=seeds)
    return {
        "vehicle": name,
        "start": start,
        "targets": targets,
        "propellant": found.propellant,
        "duration_s": found.duration_s,
        "ratios": {one.name: [flown / one.predicted for flown in one.flown] for one in found.targets},
        "errors": {
            one.name: [error / flown for error, flown in zip(one.errors, one.flown, strict=True)]
            for one in found.targets
        },
        "asked": {one.name: [flown / one.asked for flown in one.flown] for one in found.targets},
        "spent_s": time.perf_counter() - began,
    }


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="flights of each design")
    parser.add_argument("--vehicles", nargs="*", default=VEHICLES)
    parser.add_argument("--out", type=Path, help="file for all numbers, JSON")
    asked = parser.parse_args()
    rows = []
    for start in ("nominal", "zero"):
        for name in asked.vehicles:
            for targets in TARGETS:
                row = measured(name, start, targets, asked.seeds)
                ratios = np.concatenate([np.array(each) for each in row["ratios"].values()])
                errors = np.concatenate([np.array(each) for each in row["errors"].values()])
                print(
                    f"{start:8}{name:20}{json.dumps(targets):40}{row['propellant']:10.4g}{row['duration_s']:7.3g} s "
                    f"flown / predicted {np.median(ratios):.3f} ({ratios.min():.3f} to {ratios.max():.3f}), "
                    f"RMS error {np.sqrt(np.mean(errors**2)):.2f} sigma, {row['spent_s']:.0f} s",
                    flush=True,
                )
                rows.append(row)
                if asked.out:
                    asked.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    every = np.concatenate([np.array(each) for row in rows for each in row["ratios"].values()])
    within = np.mean((every > 0.75) & (every < 1.33))
    print(f"all: median {np.median(every):.3f}, {100 * within:.1f} % within 0.75 to 1.33, of {every.size}")


if __name__ == "__main__":
    main()
