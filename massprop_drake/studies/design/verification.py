"""Verification of a design by flights, against its forecast."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from massprop_drake.inputs.asked import Target, derivative_and_value
from massprop_drake.inputs.estimation_blocks import CglrBlock
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.scheduled import Degraded, Leak
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.maneuver.planning import LEAD
from massprop_drake.runners.simulate import simulate
from massprop_drake.studies.design.found import LISTENING_S, Design


def fly_design(design: Design, requested: Sequence[Target], vehicle: Vehicle, n_flights: int) -> Design:
    """Returns a design with the results of flights added: sigmas and errors of targets, times until found."""
    quiet = design.scenario.model_copy(update={"detector": CglrBlock(kind="off")})
    results = [_fly_once(quiet, seed, requested) for seed in range(n_flights)] if requested else []
    targets = tuple(
        target._replace(
            flown=tuple(deviations[index] for deviations, _ in results),
            errors=tuple(errors[index] for _, errors in results),
        )
        for index, target in enumerate(design.targets)
    )
    named = {}
    for jet in dict.fromkeys(pair.jet for pair in design.pairs):
        force = next(pair.force for pair in design.pairs if pair.jet == jet)
        named[jet] = tuple(fly_until_named_s(design, jet, force, seed, vehicle) for seed in range(n_flights))
    return design._replace(targets=targets, named_s=named)


def _fly_once(scenario: Scenario, seed: int, targets: Sequence[Target]) -> tuple[list[float], list[float]]:
    """Simulates a maneuver; returns final 1-sigmas and errors, one of each per target."""
    run = simulate(scenario.model_copy(update={"seed": seed}), look_back=False)
    estimate, covariance, truth = run.results.estimates, run.covariance, run["truth"][-1]
    deviations, errors = [], []
    for target in targets:
        combination, value = derivative_and_value(target.name, estimate)
        known = np.flatnonzero(combination)  # what no sensor shows has no covariance
        deviations.append(math.sqrt(combination[known] @ covariance[np.ix_(known, known)] @ combination[known]))
        errors.append(value - derivative_and_value(target.name, truth)[1])
    return deviations, errors


def fly_until_named_s(design: Design, jet: str, force: float, seed: int, vehicle: Vehicle) -> float | None:
    """Simulates a design with its suspect failing; returns time until its declaration, s, or None if never."""
    at_s = design.begins_s + LEAD * vehicle.sample_period_s
    thrust = float(np.linalg.norm(vehicle.thrusts[vehicle.designations.index(jet)]))
    failure = (
        Leak(kind="leak", jet=jet, start_s=at_s, force=force)
        if force > 0.0
        else Degraded(kind="degraded", jet=jet, start_s=at_s, fraction=1.0 + force / thrust)
    )
    longer_s = design.scenario.duration_s + LISTENING_S
    case = design.scenario.model_copy(update={"seed": seed, "failures": (failure,), "duration_s": longer_s})
    run = simulate(case, look_back=False)
    named = [one.time_s for one in run.results.detections if one.jet == jet and one.withdrawn_s is None]
    return min(named) - at_s if named else None
