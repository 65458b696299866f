"""Batch analysis of a run: how well it could have shown each parameter, and what its readings contradict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.offline import flight_bound, flight_model, regression
from massprop_drake.results import prior
from massprop_drake.results.common_factors import find_common_factors
from massprop_drake.results.consistency import Diagnosis
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.diagnoses import (
    FEWEST,
    diagnose_readings,
    excess_misfit,
    find_negative_gains,
    find_oscillation,
    fit_start,
    try_switching,
)
from massprop_drake.results.events import EventRecord, disturbance_in_words
from massprop_drake.results.record_stretches import (
    is_off_ticks,
    remove_false_readings,
    select_short_pieces,
    whole_record,
)
from massprop_drake.results.regression_model import make_model, propellant_variances, vehicle_names, without_shifts
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]
_OF_DISTURBANCES = ("oscillation", "drift", "torque", "drag", "momentum")  # diagnoses of what acts besides the jets
_OF_SIGNS = ("gyro_sign", "accelerometer_sign")


class BatchAnalysis(NamedTuple):
    """Result of the batch analysis of a run.

    Attributes:
        bound: least 1-sigma of the ten parameters that the run allows for rounding taken as noise, NaN where not known,
            shape (10,).
        diagnoses: what the readings contradict, the clearest first.
    """

    bound: Array
    diagnoses: tuple[Diagnosis, ...]


def analyze_run(
    scenario: Scenario,
    signals: Spool,
    estimate: Array,
    detections: Sequence[DetectionRecord],
    events: Sequence[EventRecord] = (),
    *,
    resumed: bool = False,
) -> BatchAnalysis:
    """Computes the bound on 1-sigma of the ten parameters, and diagnoses of assumptions that readings contradict.

    Samples after the first failure or jump that was declared, and not withdrawn, are not tested.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        estimate: of the ten parameters at the end, NaN where not observed, shape (10,).
        detections: failures and jumps that were declared.
        events: declared besides; readings declared false are left out.
        resumed: whether it goes on from another run, which the signals do not show.
    """
    back = _analyze_readings(scenario, signals, estimate, (detections, events), resumed=resumed)
    return back._replace(diagnoses=(*back.diagnoses, *_diagnose_disturbance(scenario, events, back.diagnoses)))


def _diagnose_disturbance(
    scenario: Scenario, events: Sequence[EventRecord], diagnoses: Sequence[Diagnosis]
) -> list[Diagnosis]:
    """Returns a diagnosis of the largest declared disturbance; [] without any, or if another diagnosis explains it."""
    disturbances = [event for event in events if event.kind == "disturbance" and event.torque_std is not None]
    if not disturbances or any(one.kind in (*_OF_DISTURBANCES, *_OF_SIGNS) for one in diagnoses):
        return []
    largest = max(disturbances, key=lambda event: event.torque_std or 0.0)
    words = (
        f"{disturbance_in_words(largest, scenario.vehicle_data.unit_names)} acts besides the jets; nothing states it"
    )
    return [Diagnosis("disturbance", words, largest.torque_std or 0.0, 0.0)]


def _analyze_readings(
    scenario: Scenario,
    signals: Spool,
    estimate: Array,
    declared: tuple[Sequence[DetectionRecord], Sequence[EventRecord]],
    *,
    resumed: bool,
) -> BatchAnalysis:
    """Runs the batch regression of `analyze_run`; `declared`: detections (failures and jumps), and events."""
    detections, events = declared
    standing = [one for one in detections if one.withdrawn_s is None]
    jumped = any(one.kind == JUMP for one in standing)
    apart = None if resumed or jumped else prior.find_contradiction(scenario, signals, estimate)
    if scenario.estimation.filter == "pose":  # what it looks back on are rates at regular intervals
        return BatchAnalysis(np.full(10, np.nan), () if apart is None else (apart,))
    model = make_model(scenario)
    unseen_s = model.period_s if scenario.estimation.filter == "joint" else _UNSEEN_S
    until_s = min((one.onset_s - unseen_s for one in standing), default=math.inf)
    with np.errstate(all="ignore"):
        pieces = remove_false_readings(whole_record(scenario, signals), list(events), vehicle_names(scenario))
        begin = np.where(np.isnan(estimate) | jumped, model.prior[:10], estimate)  # that at the end is of after a jump
        every = select_short_pieces(pieces, math.inf, model)
        if until_s < math.inf and is_off_ticks(pieces, model):  # what was declared may be the clock's doing
            whole = regression.fit_flight(every, fit_start(begin, model), model)
            until_s = math.inf if try_switching(every, whole, model)[-1] else until_s
        names = vehicle_names(scenario)
        chosen = select_short_pieces(pieces, until_s, model) if until_s < math.inf else every
        diagnoses, fit = diagnose_readings(chosen, begin, model, names)
        if until_s < math.inf and excess_misfit(fit) > 0.0:  # what was declared may be the doing of what moves inside
            whole = regression.fit_flight(every, fit_start(begin, model), model)
            diagnoses = find_oscillation(every, whole, model, names) or diagnoses
        # or of a wheel or a sign that is wrong
        if until_s < math.inf and every and (names.wheels or find_negative_gains(every, model)):
            whole_of_it, _ = diagnose_readings(every, begin, model, names)
            diagnoses = whole_of_it if any(one.kind in ("wheel", *_OF_SIGNS) for one in whole_of_it) else diagnoses
        if diagnoses or apart is not None or excess_misfit(fit) > 0.0 or fit.normal.readings < FEWEST:
            scaled = find_common_factors(pieces, begin, model, scenario)
            if scaled is not None:
                pieces, apart = scaled.parts, None
                others, fit = diagnose_readings(select_short_pieces(pieces, until_s, model), scaled.begin, model, names)
                diagnoses = [*scaled.found, *others]
        if apart is not None and not any(one.kind in _OF_SIGNS for one in diagnoses):  # else it follows from them
            diagnoses = [apart, *diagnoses] if apart.kind == "factor" else [*diagnoses, apart]
        tracked = bool(params.trackers(scenario))  # whose readings it does not go over: they allow less
        if resumed or jumped or tracked or not flight_model.is_physical(fit.at):
            return BatchAnalysis(np.full(10, np.nan), tuple(diagnoses))
        start, drift = params.initial_covariance(scenario), propellant_variances(scenario, fit.at)
        all_of_it = sum(one.time_s.size for one in chosen) == sum(one.time_s.size for one in pieces)
        known = fit.normal.information if all_of_it and not flight_model.has_accumulating_noise(model) else None
        bound = flight_bound.cramer_rao_deviation(pieces, fit.at, start, drift, without_shifts(model), known)
    return BatchAnalysis(bound, tuple(diagnoses))


_UNSEEN_S = 2.0  # for which a failure or a jump may have been there before detectors of the thesis see it
