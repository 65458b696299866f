"""What `summary.json` says of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.model import digest
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.maths import mass_properties
from massprop_drake.maths.estimation.detector import Event
from massprop_drake.maths.mass_properties import six_elements

Array = NDArray[np.float64]

# parts of the detector's status port, and so signals
DETECTOR_STATUS = {
    "tested": 1,
    "alarm": 1,
    "detector_event": 1,
    "suspected_cluster": 1,
    "suspected_jet": 1,
    "jet_isolated": 1,
    "suspected_magnitude": 1,
    "suspected_magnitude_std": 1,
    "suspected_likelihood": 1,
    "cluster_margin": 1,
    "jet_margin": 1,
    "unexplained": 1,
    "onset": 1,
    "alarms": 1,
}


def summarize(
    scenario: Scenario,
    time_s: Array,
    signals: dict[str, Array],
    covariance: Array,
    timing: dict[str, Any],
    control_authority: dict[str, Any] | None,
) -> dict[str, Any]:
    """The content of `summary.json`.

    Args:
        scenario: as run.
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        covariance: of the ten estimates at the end, shape (10, 10).
        timing: how long it took.
        control_authority: what the autopilot could do before and after failures; None without one.
    """
    vehicle = scenario.vehicle_data
    used = signals["rotation_used"][:, 0] != 0.0
    translation_nis = signals["mass_nis"][signals["mass_used"][:, 0] != 0.0, 0] if "mass_nis" in signals else None
    commands = signals["command"][:-1] > 0.0
    consistency = {
        "rotation_nis_mean": _mean(signals["rotation_nis"][used, 0]),
        "translation_nis_mean": None if translation_nis is None else _mean(translation_nis),
        "samples": int(used.sum()),
    }
    autopilot = {
        "firings": int(firings(commands)),
        "propellant_mass": _propellant(scenario, signals),
        **_selection(signals),
        **_jets_in_question(vehicle, signals),
        "control_authority": control_authority,
    }
    return composed(
        scenario,
        duration_s=float(time_s[-1]),
        estimate=signals["estimate"][-1],
        deviation=signals["standard_deviation"][-1],
        covariance=covariance,
        truth=signals["truth"][-1],
        found=detections(vehicle, time_s, signals),
        consistency=consistency,
        autopilot=autopilot,
        timing=timing,
    )


def composed(
    scenario: Scenario,
    *,
    duration_s: float,
    estimate: Array,
    deviation: Array,
    covariance: Array,
    truth: Array,
    found: list[dict[str, Any]],
    consistency: dict[str, Any],
    autopilot: dict[str, Any],
    timing: dict[str, Any],
) -> dict[str, Any]:
    """The content of `summary.json` from its parts.

    Args:
        scenario: as run.
        duration_s: from the first sample to the last, s.
        estimate, deviation: of the ten parameters at the end, shape (10,).
        covariance: at the end, shape (10, 10).
        truth: at the end, NaN where unknown, shape (10,).
        found: detections, as `settled` gives them.
        consistency, autopilot, timing: as they are to stand there.
    """
    vehicle = scenario.vehicle_data
    return {
        "format": 1,
        "version": version("massprop-drake"),
        "scenario": scenario.name,
        "vehicle": vehicle.name,
        "units": vehicle.units,
        "seed": scenario.seed,
        "duration_s": duration_s,
        "estimates": by_name(estimate),
        "standard_deviations": by_name(deviation),
        "covariance": null_for_nan(covariance),
        "derived": _derived(estimate, covariance),
        "truth": by_name(truth),
        "percent_error": by_name(mass_properties.percent_error(estimate, truth)),
        "detections": found,
        "consistency": consistency,
        "autopilot": autopilot,
        "provenance": {
            "drake": version("drake"),
            "numpy": version("numpy"),
            "vehicle_sha256": digest(vehicle),
            "scenario_sha256": digest(scenario),
        },
        "timing": timing,
    }


def detections(vehicle: Vehicle, time_s: Array, signals: dict[str, Array]) -> list[dict[str, Any]]:
    """One entry per declared failure or jump, as `summary.json` has them."""
    entries = detection_entries(vehicle, time_s, signals)
    return settled(entries, signals["known_force"][-1], signals["known_force_variance"][-1]) if entries else []


def detection_entries(
    vehicle: Vehicle, time_s: Array, signals: Mapping[str, Array], earlier: Sequence[Mapping[str, Any]] = ()
) -> list[dict[str, Any]]:
    """One entry per declared failure or jump, as it was declared.

    Args:
        vehicle: for its jets.
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        earlier: entries from before these samples, of which some may be withdrawn now.
    """
    entries = [dict(entry) for entry in earlier]
    if "detector_event" not in signals:
        return entries
    for k in np.flatnonzero(signals["detector_event"][:, 0]):
        at = {name: float(signals[name][k, 0]) for name in DETECTOR_STATUS}
        jet = int(at["suspected_jet"])
        event = int(at["detector_event"])
        if event == Event.WITHDRAWN:
            for entry in entries:
                if entry["jet_index"] == jet and entry["withdrawn_s"] is None:
                    entry["withdrawn_s"] = float(time_s[k])
            continue
        entry = {
            "onset_s": at["onset"],
            "time_s": float(time_s[k]),
            "kind": "mass_property_jump",
            "cluster": None,
            "jet": None,
            "isolated_to": None,
            "magnitude": None,
            "magnitude_std": None,
            "statistic": float(signals["rotation_nis"][k, 0]),
            "alarms": int(at["alarms"]),
            "withdrawn_s": None,
            "jet_index": None,
        }
        if event == Event.DECLARED:
            magnitude, std = at["suspected_magnitude"], at["suspected_magnitude_std"]
            isolated = bool(at["jet_isolated"])
            entry |= {
                "kind": _kind(magnitude, std, vehicle.jets[jet].thrust),
                "cluster": vehicle.jets[jet].cluster,
                "jet": vehicle.designations[jet] if isolated else None,
                "isolated_to": "jet" if isolated else "cluster",
                "magnitude": magnitude,
                "magnitude_std": std,
                "statistic": at["suspected_likelihood"],
                "jet_index": jet,
            }
        entries.append(entry)
    return entries


def settled(entries: Sequence[Mapping[str, Any]], force: Array, variance: Array) -> list[dict[str, Any]]:
    """Entries as `summary.json` has them: a force that has been followed since is given as it is known now.

    Args:
        entries: as `detection_entries` gives them.
        force, variance: known force of each jet at the end, and its variance, shape (n_jets,).
    """
    found = []
    for declared in entries:
        entry = dict(declared)
        jet = entry.pop("jet_index")
        if entry["kind"] == "jet_on" and variance[jet] > 0.0:
            entry["magnitude"] = float(force[jet])
            entry["magnitude_std"] = float(np.sqrt(variance[jet]))
        found.append(entry)
    return found


def _kind(magnitude: float, std: float, thrust: float) -> str:
    if magnitude > 0.0:
        return "jet_on"
    lost_all = -magnitude > 0.9 * thrust or abs(magnitude + thrust) < 3.0 * std
    return "jet_off" if lost_all else "jet_degraded"


def null_for_nan(values: Array) -> Any:
    """An array as nested lists, NaN as None."""
    if values.ndim > 1:
        return [null_for_nan(row) for row in values]
    return [None if math.isnan(value) else value for value in values.tolist()]


def by_name(parameters: Array) -> dict[str, Any]:
    """Ten parameters as files have them: matrix, vector and number; NaN becomes null."""
    values = [None if np.isnan(value) else float(value) for value in parameters]
    matrix = [[values[index] for index in row] for row in mass_properties.ELEMENT.tolist()]
    return {"inverse_inertia": matrix, "center_of_mass": values[6:9], "mass_reciprocal": values[9]}


def from_names(values: dict[str, Any]) -> Array:
    """The inverse of `by_name`: ten parameters, null as NaN, shape (10,)."""
    inverse = np.array(values["inverse_inertia"], dtype=float)
    center = np.array(values["center_of_mass"], dtype=float)
    reciprocal = np.array([values["mass_reciprocal"]], dtype=float)
    return np.concatenate([six_elements(inverse), center, reciprocal])


def _derived(estimate: Array, covariance: Array) -> dict[str, Any]:
    derived = mass_properties.derived(estimate, covariance)
    return {
        "mass": derived.mass,
        "mass_std": derived.mass_std,
        "inertia": None if derived.inertia is None else derived.inertia.tolist(),
        "inertia_std": None if derived.inertia_std is None else derived.inertia_std.tolist(),
        "physically_possible": derived.physically_possible,
    }


def firings(commands: NDArray[np.bool_]) -> int:
    """Number of off-to-on transitions over all jets, shape (n_samples, n_jets)."""
    before = np.vstack([np.zeros((1, commands.shape[1]), dtype=bool), commands[:-1]])
    return int((commands & ~before).sum())


def _propellant(scenario: Scenario, signals: dict[str, Array]) -> float:
    """Propellant used, slug or kg: what the thrust of every sample took."""
    vehicle = scenario.vehicle_data
    level = signals["thrust"][:-1] / np.linalg.norm(vehicle.thrusts, axis=1)
    return float((level @ params.plant_wrenches(scenario)[:, 6]).sum() * vehicle.sample_period_s)


def _jets_in_question(vehicle: Vehicle, signals: dict[str, Array]) -> dict[str, list[str] | None]:
    """Designations of the jets taken out of use, and of those left in because control needs them."""
    if "out_of_use" not in signals:
        return {"jets_out_of_use": None, "jets_left_in": None}
    state = signals["out_of_use"][-1]
    return {
        name: [jet for jet, value in zip(vehicle.designations, state, strict=True) if value == wanted]
        for name, wanted in (("jets_out_of_use", 1.0), ("jets_left_in", -1.0))
    }


def _selection(signals: dict[str, Array]) -> dict[str, int | None]:
    if "selection_counts" not in signals:
        return {"lp_solves": None, "lp_infeasible": None}
    solved, reduced, closest, _ = signals["selection_counts"][-1].tolist()
    return {"lp_solves": int(solved), "lp_infeasible": int(reduced + closest)}


def _mean(values: Array) -> float | None:
    return float(values.mean()) if values.size else None
