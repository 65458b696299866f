"""Rows of a campaign as if it had been flown, for tests of what is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.inputs.campaign_file import load_campaign
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.studies.campaign import store
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.measure import failing_reasons

Row = dict[str, Any]
LENGTH_S = 60.0
JETS = ("R4R", "F1U", "L5D", "F2F")
SWEPT = """
name: made_up
description: Rows that nobody has flown
base: stuck_on_29
cases: {cases}
seed: 3
draw:
  plant.thrust_dispersion: {{uniform: {{low: 0.0, high: 0.02}}}}
  detector.threshold: {{uniform: {{low: 0.0, high: 1.0}}}}
sweep: {{detector.margin: [4.0, 6.0]}}
keep: none
gates:
  false_declarations_per_hour: {{max: 1000}}
  nees_in_band: {{min: 0.99, on: lower_bound}}
"""


def failure(jet: str | None = "R4R", outcome: str = "named", **given: Any) -> Row:
    """An injected failure, at 20 s, found after half a second where it was found."""
    acted = None if outcome == "never_acted" else given.pop("acted_s", 20.0)
    declared = given.pop("declared_s", 20.5) if outcome in ("named", "group", "wrong") else None
    return {
        "kind": "stuck_on", "jet": jet, "start_s": 20.0, "first_acted_s": acted, "first_alarm_s": declared,
        "declared_s": declared, "outcome": outcome, "taken_for": None, "force": 100.0, "magnitude": 101.0,
        "magnitude_std": 2.0, **given,
    }  # fmt: skip


def declaration(jet: str | None = "R4R", time_s: float = 20.5, cause: str | None = None, **given: Any) -> Row:
    """A declaration; false where it has a cause."""
    return {
        "kind": "jet_on", "cluster": 5, "jet": jet, "onset_s": time_s - 0.1, "time_s": time_s, "magnitude": 101.0,
        "magnitude_std": 2.0, "statistic": 50.0, "withdrawn_s": None, "false": cause is not None, "cause": cause,
        **given,
    }  # fmt: skip


def jump(time_s: float = 20.5, cause: str | None = None) -> Row:
    """A jump of the mass properties, as it is declared."""
    return declaration(None, time_s, cause, kind="mass_property_jump", cluster=None, magnitude=None, magnitude_std=None)


def row(
    case_id: int = 0, injected: Sequence[Row] = (), declared: Sequence[Row] = (), *,
    z: Mapping[str, float] | float = 0.5, **given: Any,
) -> Row:  # fmt: skip
    """A case that has been flown.

    Args:
        case_id: its number.
        injected, declared: what failed and what was declared.
        z: error over sigma, of all parameters or by name.
        given: other columns.
    """
    errors = {name: z if isinstance(z, float) else z.get(name, 0.5) for name in NAMES}
    worst = max(errors, key=lambda name: abs(errors[name]))
    found: Row = {
        "case_id": case_id, "status": "flown", "reason": None, "failing": [], "duration_s": LENGTH_S,
        **{f"estimate.{name}": 3.0 + 0.1 * value for name, value in errors.items()},
        **{f"error.{name}": 0.1 * value for name, value in errors.items()},
        **{f"sigma.{name}": 0.1 for name in NAMES},
        **{f"truth.{name}": 3.0 for name in NAMES},
        "largest_sigmas": abs(errors[worst]), "worst_parameter": worst,
        "nees.rotation": sum(errors[name] ** 2 for name in NAMES[:9]), "nees.mass": errors[NAMES[9]] ** 2,
        "nis.rotation": 3.0, "nis.translation": 2.9, "samples": 100, "converged_s": 12.0,
        "injected": list(injected), "declared": list(declared),
        "n_false": sum(entry["false"] for entry in declared), "jets_out_of_use": [], "healthy_jets_out": [],
        "firings": 40, "propellant_mass": 2.0, "lp_infeasible": 0, "wall_s": 1.0, "cpu_s": 0.9, "worker": None,
        **given,
    }  # fmt: skip
    found["failing"] = failing_reasons(found)
    return found


def lost(case_id: int, reason: str) -> Row:
    """A case that failed to run."""
    return {"case_id": case_id, "status": "failed", "reason": reason, "wall_s": 2.0, "cpu_s": None}


def many(n_cells: int, samples: int, seed: int = 0) -> list[Row]:
    """Cases with failures of every outcome, leaks of many sizes, jumps and false declarations."""
    random = np.random.default_rng(seed)
    rows = []
    for sample in range(samples):
        jet = JETS[sample % len(JETS)]
        z = dict(zip(NAMES, random.normal(size=10).tolist(), strict=True))
        size = float(np.exp(random.uniform(1.0, 5.0)))
        delay, lucky, spurious = random.exponential(3.0), random.random(), random.random()
        for cell in range(n_cells):
            case_id = sample * n_cells + cell
            found = lucky < size / (size + 10.0 + 10.0 * cell)
            size_of = {"force": size, "magnitude": size * 1.02, "magnitude_std": 0.02 * size}
            declared = []
            match sample % 6:
                case 0:
                    injected = [failure(jet, "never_acted", kind="stuck_off")]
                case 1:
                    injected = [failure(None, "named", kind="release", force=None, magnitude=None, magnitude_std=None)]
                    declared = [jump()]
                case 2:
                    injected = [failure(jet, "wrong", kind="degraded", taken_for="cluster 12", **size_of)]
                    declared = [declaration("L1A", cause="failure")]
                case _:
                    outcome = "named" if found and sample % 2 else "group" if found else "missed"
                    injected = [failure(jet, outcome, kind="leak", declared_s=20.0 + delay, **size_of)]
                    declared = [declaration(jet, 20.0 + delay, statistic=30.0 + size)] if found else []
            out = {}
            if spurious < 0.3 - 0.15 * cell:
                declared = [*declared, declaration("F2F", 10.0, "healthy", statistic=20.0 + 40.0 * spurious)]
                out = {"jets_out_of_use": ["F2F"], "healthy_jets_out": ["F2F"]}
            rows.append(row(case_id, injected, declared, z=z, **out))
    return rows


def folder(path: Path, text: str, rows: Sequence[Row]) -> Path:
    """The folder of a campaign whose cases have become these rows."""
    path.with_suffix(".yaml").write_text(text)
    campaign = Campaign(load_campaign(path.with_suffix(".yaml")))
    campaign.plan(path)
    store.write_rows(path, rows, store.schema(campaign.spec.file.times_s))
    return path
