r"""Separation of the members of a group of jets: by one of them fired alone, or by time.

A screen's columns go on (`screen`), with what would be commanded in place of what was: with s the innovation that a
unit force of a member would add in the cycles to come, and A of the past,

    A' = A + sum S^T Y^-1 S,    separation of i from the likeliest j = f_j^2 (A'_jj - A'_ji^2 / A'_ii),

every cycle with the Phi, H, K and Y of the newest. A jet outside the group adds to what all of its members predict
alike, and so tells nothing; a member that is said to give less shows only while it fires, one that is stuck on only
while it rests, a leak always.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams
from massprop_drake.maths.estimation.joint.screen import Screen, columns_matching_forces
from massprop_drake.maths.estimation.joint.sensitivity import Link, propagate_to_update, propagate_update
from massprop_drake.maths.linear_algebra import Array

_SPAN_S = 2.0  # of firing or coasting that is predicted: a jet fired alone for longer turns the vehicle
_MIN_CYCLES = 4  # that are predicted: a rate over their second half takes two
_LONGEST_S = 600.0  # of coasting that is worth naming
_NOBODY = -1


class Separation(NamedTuple):
    """Firing or coasting that separates the jets of a group; neither: nothing does.

    Attributes:
        jet: index of the member that separates them when fired alone; -1: none.
        coasting_s: time without any jet after which they are separated, s; NaN: never, or not before ten minutes.
    """

    jet: int = _NOBODY
    coasting_s: float = np.nan


def find_separation(
    screen: Screen, interval: Link, onset: int, members: list[tuple[int, int, float]], level: float, params: JointParams
) -> Separation:
    """Finds which jet firing alone, or what coasting time, separates a group's likeliest jet from the others soonest.

    Args:
        interval: the newest cycle.
        onset: one of the screen's, whose columns go on.
        members: jet, sign and force of each, lbf or N; the likeliest first.
        level: separation that suffices, twice a log likelihood ratio.
    """
    jets = params.places.jets
    index = screen.onsets.index(onset)
    h = 5 * jets + interval.read.shape[0]
    ways = np.array([jet + (jets if sign < 0 else 0) for jet, sign, _ in members])
    steps = columns_matching_forces(ways, np.array([force for _, _, force in members]), params)
    columns = screen.columns[:, N_PROPERTIES + index * h + steps]
    information = screen.information[index][np.ix_(steps, steps)]
    force = members[0][2]

    def separations(lone_jet: int) -> Array:
        """Computes the separation of the first jet from the nearest other after each cycle, shape (cycles,)."""
        return _least_separation(information, _predicted_information(columns, steps, interval, lone_jet, params), force)

    by_jet = {jet: separations(jet) for jet in dict.fromkeys(jet for jet, _, _ in members)}
    soonest = {jet: np.flatnonzero(found >= level) for jet, found in by_jet.items()}
    firing = [(int(when[0]), -float(by_jet[jet][-1]), jet) for jet, when in soonest.items() if when.shape[0] > 0]
    coasting_s = _coasting_s(separations(_NOBODY), level, interval.duration_s)
    if firing and not coasting_s <= (min(firing)[0] + 1) * interval.duration_s:
        return Separation(min(firing)[2])
    return Separation(coasting_s=coasting_s)


def _predicted_information(
    columns: Array, indices: np.ndarray, interval: Link, lone_jet: int, params: JointParams
) -> Array:
    """Predicts information gained per future cycle with one jet firing alone, or none, shape (cycles, k, k)."""
    jets = params.places.jets
    jet = indices % jets
    less, stuck = (jets <= indices) & (indices < 2 * jets), indices >= 4 * jets
    acts = np.where(less, np.where(jet == lone_jet, -1.0, 0.0), np.where(stuck & (jet == lone_jet), 0.0, 1.0))
    forcing = interval.duration_s * interval.effects[jet].T * acts
    present = np.flatnonzero(~np.isnan(interval.read))
    half = np.linalg.cholesky(interval.covariance[np.ix_(present, present)])
    n_cycles = max(round(_SPAN_S / interval.duration_s), _MIN_CYCLES)
    gained = np.zeros((n_cycles, indices.shape[0], indices.shape[0]))
    for cycle in range(n_cycles):
        columns = propagate_to_update(columns, forcing, interval, params.places)
        shown = interval.jacobian @ columns
        columns = propagate_update(columns, shown, interval)
        whitened = np.linalg.solve(half, shown[present])
        gained[cycle] = whitened.T @ whitened
    return gained


def _least_separation(information: Array, gained_information: Array, force: float) -> Array:
    """Computes the least separation of the first jet from any other after each cycle, shape (cycles,)."""
    total = information + np.cumsum(gained_information, axis=0)
    others = np.diagonal(total, axis1=1, axis2=2)[:, 1:]
    shared = np.divide(total[:, 0, 1:] ** 2, others, out=np.zeros_like(others), where=others > 0.0)
    result: Array = force**2 * (total[:, :1, 0] - shared).min(axis=1)
    return result


def _coasting_s(separation: Array, threshold: float, period_s: float) -> float:
    """Returns coasting time until a separation reaches its threshold, extrapolated linearly, s; NaN: too long."""
    enough = np.flatnonzero(separation >= threshold)
    if enough.shape[0] > 0:
        return float(enough[0] + 1) * period_s
    half = separation.shape[0] // 2
    rate = float(separation[-1] - separation[half]) / (separation.shape[0] - 1 - half)
    if rate <= 0.0:
        return float(np.nan)
    seconds = (separation.shape[0] + (threshold - float(separation[-1])) / rate) * period_s
    return seconds if seconds <= _LONGEST_S else float(np.nan)
