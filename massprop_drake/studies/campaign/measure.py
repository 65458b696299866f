"""Results that a campaign keeps of each case: errors, consistency, failures and their detection, and cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.maths.mass_properties import N_ROTATION, NAMES
from massprop_drake.results.injected import false_declarations
from massprop_drake.studies.campaign.counts import ends_wrong

Array = NDArray[np.float64]


def measure_case(run: Run, times_s: Sequence[float]) -> dict[str, Any]:
    """Returns the row of results of one case: errors, sigmas, NEES, NIS, detections and cost, by column.

    Args:
        run: of the case, simulated or estimated from telemetry.
        times_s: at which errors are kept besides those at the end.

    Returns:
        Plain values by column, NaN as None; `injected` and `declared` are lists of mappings.
    """
    results = run.results
    row: dict[str, Any] = {"duration_s": results.duration_s}
    row |= _error_columns("", results.estimates, results.standard_deviations, results.truth)
    row |= _nees_columns(results.estimates - results.truth, results.covariance)
    for at_s in times_s:
        index = int(np.searchsorted(run.time_s, at_s + 1e-9, side="right")) - 1
        truth = run["truth"][index] if "truth" in run.signals else np.full(10, np.nan)
        row |= _error_columns(f"@{at_s:g}", run["estimate"][index], run["standard_deviation"][index], truth)
    row |= _consistency_columns(run)
    row |= _detection_columns(run)
    autopilot = results.autopilot
    return row | {
        "firings": autopilot.firings,
        "propellant_mass": autopilot.propellant_mass,
        "lp_infeasible": autopilot.lp_infeasible,
    }


def failing_reasons(row: dict[str, Any]) -> list[str]:
    """Returns the reasons for which a case counts as failing, in words; empty if it does not."""
    reasons = []
    if ends_wrong(row):
        reasons.append(f"{row['worst_parameter']} {row['largest_sigmas']:.3g} sigma off")
    if row["n_false"]:
        reasons.append(f"{row['n_false']} false declaration{'s' if row['n_false'] > 1 else ''}")
    if row["healthy_jets_out"]:
        reasons.append(f"healthy jets out of use: {', '.join(row['healthy_jets_out'])}")
    for failure in row["injected"]:
        if failure["outcome"] in ("wrong", "missed", "not_tested"):
            name = failure["jet"] or failure["kind"]
            taken = f" for {failure['taken_for']}" if failure["taken_for"] else ""
            reasons.append(f"{name} {failure['outcome'].replace('_', ' ')}{taken}")
    return reasons


def _finite(value: float) -> float | None:
    """Returns the value as a float, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None


def _error_columns(suffix: str, estimate: Array, sigma: Array, truth: Array) -> dict[str, Any]:
    """Returns estimate, error and sigma by column; at the end also truth and largest error in sigma."""
    row: dict[str, Any] = {}
    for name, x, s, t in zip(NAMES, estimate.tolist(), sigma.tolist(), truth.tolist(), strict=True):
        row[f"estimate{suffix}.{name}"] = _finite(x)
        row[f"error{suffix}.{name}"] = _finite(x - t)
        row[f"sigma{suffix}.{name}"] = _finite(s)
        if not suffix:
            row[f"truth.{name}"] = _finite(t)
    if not suffix:
        ratios = np.abs(estimate - truth) / np.where(sigma > 0.0, sigma, np.nan)
        known = np.isfinite(ratios)
        worst = int(np.nanargmax(ratios)) if known.any() else None
        row["largest_sigmas"] = None if worst is None else float(ratios[worst])
        row["worst_parameter"] = None if worst is None else NAMES[worst]
    return row


def _nees_columns(error: Array, covariance: Array) -> dict[str, Any]:
    """Computes NEES of the rotational parameters and of 1/m, by column; None where not known."""
    row: dict[str, Any] = {}
    for name, part in (("rotation", slice(0, N_ROTATION)), ("mass", slice(N_ROTATION, 10))):
        e, p = error[part], covariance[part, part]
        scale = np.sqrt(p.diagonal())
        known = np.isfinite(e).all() and (scale > 0.0).all()
        value = None
        if known:
            unit = p / np.outer(scale, scale)
            value = _finite(float((e / scale) @ np.linalg.solve(unit, e / scale)))
        row[f"nees.{name}"] = value
    return row


def _consistency_columns(run: Run) -> dict[str, Any]:
    """Returns mean NIS, number of samples used, and time of convergence, s, by column."""
    consistency = run.results.consistency
    converged = np.flatnonzero(run["converged"][:, 0])
    return {
        "nis.rotation": consistency.rotation_nis_mean,
        "nis.translation": consistency.translation_nis_mean,
        "samples": consistency.samples,
        "converged_s": float(run.time_s[converged[0]]) if converged.size else None,
    }


def _detection_columns(run: Run) -> dict[str, Any]:
    """Returns injected failures, declarations and false ones by column; false ones None of a record (truth unknown)."""
    results = run.results
    known = results.injected is not None
    injected = results.injected or ()
    false = false_declarations(run.scenario.vehicle_data, injected, results.detections)
    columns = ("kind", "cluster", "jet", "onset_s", "time_s", "magnitude", "magnitude_std", "statistic", "withdrawn_s")
    declared = [{name: getattr(entry, name) for name in columns} for entry in results.detections]
    for index, entry in enumerate(declared if known else ()):
        entry |= {"false": index in false, "cause": false.get(index)}
    failed = {record.jet for record in injected if record.first_acted_s is not None}
    out = results.autopilot.jets_out_of_use or ()
    return {
        "injected": [record._asdict() for record in injected],
        "declared": declared,
        "n_false": len(false) if known else None,
        "jets_out_of_use": list(out),
        "healthy_jets_out": [jet for jet in out if jet not in failed] if known else None,
    }
