"""Test firings that are designed in flight, from the estimates by then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES
from massprop_drake.maths.linear_algebra import Array, scaled_inverse
from massprop_drake.maths.maneuver.actions import Craft, candidate_actions
from massprop_drake.maths.maneuver.aims import Aims, Known
from massprop_drake.maths.maneuver.information import prior_information
from massprop_drake.maths.maneuver.planning import (
    Cost,
    ManeuverLimits,
    Task,
    begin_plan,
    characterize_actions,
    extend_plan,
    trim_plan,
)

_LENGTHS = (1, 2, 4, 8)  # samples that an action lasts, compute budget
_LIKELY = 0.01  # probability that makes a jet a suspect
_FAILED = 0.5  # probability that some jet has failed, from which on it is asked which, and whether
_MOST = 6  # suspects, the likeliest; compute budget


class FiringTest(NamedTuple):
    """Settings of test firings in flight.

    Attributes:
        craft: as the vehicle's file has it.
        targets: without pairs, and with no margin taken off; those of a group have none.
        forces: by which a suspect may fail, lbf or N, shape (n_jets,).
        thrusts: of the jets, lbf or N, shape (n_jets,).
        odds: by which suspects are to be told apart, nats.
        limits: of one test.
        cost: see `Cost`.
        margin: by which share aims are narrower.
        patience_s: for which the question must stand, and between two tests.
        groups: whether suspects are told apart; else targets are reached.
    """

    craft: Craft
    targets: Aims
    forces: Array
    thrusts: Array
    odds: float
    limits: ManeuverLimits
    cost: Cost
    margin: float
    patience_s: float
    groups: bool


def suspects(probability: Array, settings: FiringTest) -> tuple[int, ...]:
    """Returns indices of jets among which a failure is not isolated yet, likeliest few; empty: no test needed.

    Args:
        probability: of each jet, then of nothing and of something unknown, shape (n_jets + 2,).
    """
    of_jets = probability[: settings.craft.params.places.jets]
    likely = np.flatnonzero(of_jets > _LIKELY)
    declared = 1.0 / (1.0 + math.exp(-settings.odds))
    if not _LIKELY < float(of_jets.max()) < declared or 1.0 - float(probability[-2:].sum()) < _FAILED:
        return ()
    return tuple(sorted(likely[np.argsort(-of_jets[likely])][:_MOST].tolist()))


def misses_target(covariance: Array, settings: FiringTest) -> bool:
    """Tests whether the 1-sigma of any wanted combination of parameters exceeds its aim.

    Args:
        covariance: of the ten estimates, shape (10, 10).
    """
    for combination, deviation in zip(settings.targets.combinations, settings.targets.deviations, strict=True):
        of = np.flatnonzero(combination)
        variance = combination[of] @ covariance[np.ix_(of, of)] @ combination[of]
        if not variance <= deviation**2:
            return True
    return False


def design_commands(
    sets: Sequence[tuple[int, ...]],
    estimate: tuple[Array, Array],
    rate: Array,
    suspect_jets: tuple[int, ...],
    settings: FiringTest,
) -> Array:
    """Designs a test firing's commands, shape (n_samples, n_jets); no rows: no firing helps.

    Args:
        sets: of jets that fire together.
        estimate: the ten parameters, shape (10,), and their covariance, shape (10, 10), NaN where not estimated.
        rate: rad/s, shape (3,).
        suspect_jets: suspects; none: targets are reached.
    """
    n = settings.craft.params.places.jets
    mean = np.where(np.isnan(estimate[0]), settings.craft.properties, estimate[0])
    craft = settings.craft._replace(properties=mean, rate=rate, torques=np.zeros_like(settings.craft.torques))
    aims = _separation_aims(suspect_jets, settings) if suspect_jets else settings.targets
    narrow = aims._replace(deviations=aims.deviations / (1.0 + settings.margin))
    known = _known_from_estimates(estimate[1], craft)
    task = Task(craft, known, narrow, settings.limits, settings.cost, settings.margin)
    choice = characterize_actions(candidate_actions(sets, craft, _LENGTHS), task)
    plan = extend_plan(begin_plan(task), choice, 1.0, task)
    plan = trim_plan(plan, task) if plan.reached[-1].shortfall == 0.0 else plan
    rows = []
    for action in plan.actions[1:]:  # what comes before is past
        row = np.zeros((action.length, n))
        row[: action.samples, list(action.jets)] = 1.0
        rows.append(row)
    return np.vstack(rows) if rows else np.zeros((0, n))


def _separation_aims(suspect_jets: tuple[int, ...], settings: FiringTest) -> Aims:
    """Makes the aims that tell suspect jets from each other and from no failure, by leak and by loss of thrust."""
    n = settings.craft.params.places.jets
    pairs = [
        (one + kind, other + kind if other >= 0 else -1)
        for kind in (0, n)
        for one in suspect_jets
        for other in (*suspect_jets, -1)
        if one != other
    ]
    first = np.array(pairs)[:, 0] % n
    odds = np.full(len(pairs), settings.odds * (1.0 + settings.margin) ** 2)
    of = np.zeros((0, settings.targets.combinations.shape[1]))
    return Aims(of, np.zeros(0), np.array(pairs), settings.forces[first], settings.thrusts[first], odds)


def _known_from_estimates(covariance: Array, craft: Craft) -> Known:
    """Computes prior information: the ten estimates' covariance inverted, the filter's prior on the rest."""
    information, of = prior_information(initial_joint_state(craft.params), craft.params)
    ten = of[of < N_PROPERTIES]
    ten = ten[np.isfinite(np.diagonal(covariance)[ten])]
    rest = np.isin(of, ten, invert=True)
    whole = np.zeros_like(information)
    whole[np.ix_(rest, rest)] = information[np.ix_(rest, rest)]
    whole[np.ix_(~rest, ~rest)] = scaled_inverse(covariance[np.ix_(ten, ten)])
    return Known(whole, of)
