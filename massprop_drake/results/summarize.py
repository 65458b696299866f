"""Summary of a run from its signals: use of the jets, consistency of the filters, outcome of failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.model import digest
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths import mass_properties
from massprop_drake.maths.mass_properties import Derived
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.records.completeness import Loss, completeness
from massprop_drake.results.batch_analysis import analyze_run
from massprop_drake.results.consistency import (
    COMPONENTS,
    TOO_LITTLE,
    Consistency,
    Diagnosis,
    Tally,
    find_forks,
    fork_signals,
    innovations,
    judge_consistency,
    likeliest_innovations,
    used_nis,
)
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.fault_probabilities import gives_probabilities
from massprop_drake.results.identifiability_flags import classify_parameters
from massprop_drake.results.injected import InjectedRecord, injected_outcomes
from massprop_drake.results.parts import PartsMade
from massprop_drake.results.record_stretches import used_propellant
from massprop_drake.results.spool import Spool, blocks
from massprop_drake.results.summary import AutopilotSummary, Findings, Provenance, RunTiming, Summary

Array = NDArray[np.float64]


def summarize(
    scenario: Scenario,
    signals: Spool,
    findings: Findings,
    covariance: Array,
    timing: RunTiming,
    parts_made: PartsMade,
) -> Summary:
    """Makes a simulated run's summary, without the batch analysis, which `add_batch_analysis` adds.

    Args:
        scenario: as run.
        signals: all of them, by name, with `time_s`.
        findings: of the detector.
        covariance: of the ten estimates at the end, shape (10, 10).
        timing: of the run.
        parts_made: makes the parts that may fail.
    """
    estimate, deviation = signals.last("estimate"), signals.last("standard_deviation")
    truth = _final_truth(scenario, signals)
    return compose_summary(
        scenario,
        duration_s=float(signals.last("time_s")),
        estimate=estimate,
        deviation=deviation,
        covariance=covariance,
        truth=truth,
        findings=findings,
        consistency=parts_made.make(
            "consistency",
            lambda: _judge_run(signals, estimate, deviation, truth, findings.detections),
            Consistency(None, None, 0, TOO_LITTLE),
        ),
        bound=None,
        autopilot=parts_made.make("autopilot", lambda: _autopilot_summary(scenario, signals), AutopilotSummary(0, 0.0)),
        timing=timing,
        injected=parts_made.make("injected", lambda: injected_outcomes(scenario, signals, findings.detections), None)
        if "thrust" in signals
        else None,
    )


def _final_truth(scenario: Scenario, signals: Spool) -> Array:
    """Returns the true ten parameters at the end, NaN where unknown, shape (10,).

    Where the estimators track swinging parts, those at the start, when a model's parts rest.
    """
    if "truth" not in signals:
        return np.full(10, np.nan)
    if scenario.vehicle_data.moving and isinstance(scenario.plant, MultibodyBlock) and not scenario.plant.moves:
        first: Array = next(iter(signals.blocks("truth")))["truth"][0]
        return first
    return signals.last("truth")


def _autopilot_summary(scenario: Scenario, signals: Spool) -> AutopilotSummary:
    """Computes jet firings, propellant used, jet selections and jets out of use of a run."""
    flows = true_params.plant_mass_flows(scenario)
    return AutopilotSummary(
        firings=_count_run_firings(signals),
        propellant_mass=used_propellant(scenario, signals, flows, by_thrust="thrust" in signals),
        **_count_selections(signals),
        **_jets_in_question(scenario.vehicle_data, signals),
    )


def summarize_last_estimates(scenario: Scenario, signals: Spool, timing: RunTiming) -> Summary:
    """Makes a run's summary from its last estimates and 1-sigma alone, without detections or verdict."""
    vehicle, unknown = scenario.vehicle_data, np.full(10, np.nan)
    return Summary(
        version("massprop-drake"),
        scenario.name,
        vehicle.name,
        vehicle.units,
        scenario.seed,
        float(signals.last("time_s")),
        estimates=signals.last("estimate"),
        standard_deviations=signals.last("standard_deviation"),
        covariance=np.full((10, 10), np.nan),
        derived=Derived(None, None, None, None, False),
        truth=_final_truth(scenario, signals),
        percent_error=unknown,
        detections=(),
        consistency=Consistency(None, None, 0, TOO_LITTLE),
        autopilot=AutopilotSummary(0, 0.0),
        provenance=Provenance(version("drake"), version("numpy"), digest(vehicle), digest(scenario)),
        timing=timing,
    )


def add_batch_analysis(results: Summary, scenario: Scenario, signals: Spool) -> Summary:
    """Returns the summary with batch diagnoses in its consistency verdict, and with identifiability."""
    estimate, covariance = results.estimates, results.covariance
    back = analyze_run(scenario, signals, estimate, results.detections, results.events)
    verdict = results.consistency
    if back.diagnoses:
        verdict = _judge_run(
            signals, estimate, results.standard_deviations, results.truth, results.detections, back.diagnoses
        )
    return replace(
        results, consistency=verdict, identifiability=classify_parameters(scenario, estimate, covariance, back.bound)
    )


def _judge_run(
    signals: Spool,
    estimate: Array,
    deviation: Array,
    truth: Array,
    detections: Sequence[DetectionRecord],
    diagnoses: Sequence[Diagnosis] = (),
) -> Consistency:
    """Judges a run's consistency by both filters' NIS, and by parameter errors over 1-sigma where known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (estimate - truth) / deviation
    rotation, mass = (_tally_nis(signals, name, detections) for name in ("rotation", "mass"))
    return judge_consistency(rotation, mass, ratios, SYMBOLS, diagnoses)


def compose_summary(
    scenario: Scenario,
    *,
    duration_s: float,
    estimate: Array,
    deviation: Array,
    covariance: Array,
    truth: Array,
    findings: Findings,
    consistency: Consistency,
    bound: Array | None,
    autopilot: AutopilotSummary,
    timing: RunTiming,
    telemetry: str | None = None,
    telemetry_sha256: str | None = None,
    data_quality: Mapping[str, Any] | None = None,
    injected: tuple[InjectedRecord, ...] | None = None,
    losses: Sequence[Loss] = (),
) -> Summary:
    """Makes a summary; derives mass, inertia, percent errors, identifiability and provenance.

    Args:
        scenario: as run.
        duration_s: from the first sample to the last, s.
        estimate, deviation: of the ten parameters at the end, shape (10,).
        covariance: at the end, shape (10, 10).
        truth: at the end, NaN where unknown, shape (10,).
        findings: of the detector.
        bound: least 1-sigma that the run allows for rounding taken as noise, NaN where not known, shape (10,); None:
            identifiability is added later.
        consistency, autopilot, timing: taken as they are.
        telemetry, telemetry_sha256, data_quality: name, digest and quality of a record.
        injected: outcomes of the failures and jumps of a simulated run.
        losses: unreadable parts of a record.
    """
    vehicle = scenario.vehicle_data
    known = params.known_parameters(scenario)
    reduced = covariance.copy()  # what is not estimated is taken for known
    reduced[known], reduced[:, known] = 0.0, 0.0
    return Summary(
        version=version("massprop-drake"),
        scenario=scenario.name,
        vehicle=vehicle.name,
        units=vehicle.units,
        seed=scenario.seed,
        duration_s=duration_s,
        estimates=estimate,
        standard_deviations=deviation,
        covariance=covariance,
        derived=mass_properties.derive_mass_and_inertia(estimate, reduced),
        truth=truth,
        percent_error=mass_properties.percent_error(estimate, truth),
        detections=findings.detections,
        consistency=consistency,
        autopilot=autopilot,
        provenance=Provenance(
            version("drake"),
            version("numpy"),
            digest(vehicle),
            digest(scenario),
            telemetry,
            telemetry_sha256,
            _execution_in_words(scenario, simulated=telemetry is None),
        ),
        timing=timing,
        data_quality=data_quality,
        injected=injected,
        identifiability=() if bound is None else classify_parameters(scenario, estimate, covariance, bound),
        events=findings.events,
        unconfirmed=findings.unconfirmed,
        untested=findings.untested,
        fault_probability=findings.fault_probability,
        completeness=completeness(losses),
        completeness_detail=tuple(loss.text for loss in losses),
    )


@cache
def version(package: str) -> str:
    """Returns the version of an installed package; cached, as the look-up is slow."""
    return metadata.version(package)


def _execution_in_words(scenario: Scenario, *, simulated: bool) -> str | None:
    """Returns engine and compiler, such as "loop, compiled by numba 0.60.0"; None where neither applies."""
    words: list[str] = [scenario.execution.engine] if simulated else []
    if scenario.execution.compiled:
        words.append(f"compiled by numba {version('numba')}")
    return ", ".join(words) or None


def count_firings(on: NDArray[np.bool_], before: NDArray[np.bool_]) -> int:
    """Counts transitions from off to on, summed over all jets.

    Args:
        on: whether each jet is told to fire, shape (n_samples, n_jets).
        before: the same in the sample before the first, shape (n_jets,).
    """
    return int((on & ~np.vstack([before, on[:-1]])).sum())


def _count_run_firings(signals: Spool) -> int:
    """Counts off-to-on transitions of a run's jets, without the last row, which acts after its end."""
    count, before = 0, np.zeros(signals.last("command").size, dtype=bool)
    earlier = before
    for block in signals.blocks("command"):
        on = block["command"] > 0.0
        count += count_firings(on, before)
        earlier, before = (on[-2] if len(on) > 1 else before), on[-1]
    return count - count_firings(before[None], earlier)


def _tally_nis(signals: Spool, filter_name: str, detections: Sequence[DetectionRecord]) -> Tally:
    """Tallies the NIS of a filter over a run; samples that declarations explain are no faults."""
    tally = Tally()
    if f"{filter_name}_nis" in signals:
        parts = [used_nis(filter_name, block) for block in blocks(signals, *_nis_signals(filter_name, signals))]
        tally.add(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return exclude_explained(tally, signals, filter_name, detections)


def _nis_signals(filter_name: str, signals: Spool) -> list[str]:
    """Lists the names of a filter's signals for `used_nis`: NIS, use, and components if logged."""
    return [one for one in (f"{filter_name}_nis", f"{filter_name}_used", COMPONENTS[filter_name]) if one in signals]


def exclude_explained(tally: Tally, signals: Spool, filter_name: str, detections: Sequence[DetectionRecord]) -> Tally:
    """Returns a filter's NIS tally less samples that declarations explain, or that of the finally likeliest hypothesis.

    Where hypotheses are followed it is the tally of the likeliest history in hindsight. Other detectors explain the
    samples between an onset and its declaration, of a payload or of a jet named alone, if it is not withdrawn.

    Args:
        tally: of all samples.
        signals: of the run.
        filter_name: see `used_nis`.
        detections: declared in the run.
    """
    if f"{filter_name}_nis" not in signals:
        return tally
    if gives_probabilities(signals):
        return _tally_likeliest_history(tally, signals, filter_name)
    named = [one for one in detections if one.kind == JUMP or one.isolated_to == "jet"]
    spans = [(one.onset_s, one.time_s) for one in named if one.withdrawn_s is None]
    if spans:
        names, parts = _nis_signals(filter_name, signals), []
        for block in blocks(signals, "time_s", *names):
            within = np.zeros(block["time_s"].shape[0], dtype=np.bool_)
            for onset_s, declared_s in spans:
                within |= (block["time_s"] > onset_s) & (block["time_s"] <= declared_s)
            parts.append(used_nis(filter_name, {one: block[one][within] for one in names}))
        tally.exclude_from_faults(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return tally


def _tally_likeliest_history(tally: Tally, signals: Spool, filter_name: str) -> Tally:
    """Tallies NIS of the hypothesis likeliest in hindsight, sample by sample; the given tally if it never changed."""
    names = ("time_s", *_nis_signals(filter_name, signals), *fork_signals(filter_name))
    columns = {one: np.concatenate([block[one] for block in blocks(signals, one)]) for one in names}
    forks = find_forks(filter_name, columns)
    if not forks.rows.size:
        return tally
    likeliest = Tally()
    likeliest.add_innovations(likeliest_innovations(innovations(filter_name, columns), columns["time_s"], forks))
    return likeliest


def _jets_in_question(vehicle: Vehicle, signals: Spool) -> dict[str, Any]:
    """Maps "jets_out_of_use" and "jets_left_in" (needed for control) to jet designations at the end."""
    if "out_of_use" not in signals:
        return {}
    state = signals.last("out_of_use")
    return {
        name: [jet for jet, value in zip(vehicle.designations, state, strict=True) if value == code]
        for name, code in (("jets_out_of_use", 1.0), ("jets_left_in", -1.0))
    }


def _count_selections(signals: Spool) -> dict[str, Any]:
    """Returns the entries with numbers of jet selections and of unmet requests; {} without an autopilot."""
    if "selection_counts" not in signals:
        return {}
    solved, reduced, closest, _ = signals.last("selection_counts").tolist()
    return {"lp_solves": int(solved), "lp_infeasible": int(reduced + closest)}
