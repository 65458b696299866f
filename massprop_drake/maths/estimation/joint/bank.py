r"""The bank of onsets, and the telescoped test of what has happened since each of them.

For an onset theta the state after it is carried on without learning. The residual e of the newest readings against
that prediction has the covariance

    Y = M P_theta M^T + R + noise since,    M = H Phi ... Phi,

with P_theta the filter's own covariance at the onset, so that lag, thrust errors and coupling are in it. A force f of
jet j since the onset adds c_j f, c_j = (effect of unit force) x seconds, and

    T = e^T Y^-1 e,    l_j = (c_j^T Y^-1 e)^2 / (c_j^T Y^-1 c_j).

The prediction need not be run for every onset: what the filter has learned since, D, is carried by the filter's own
linearization (`sensitivity`), and e is the filter's innovation and H D. Mean over packages: six rows, rate first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import RATE, VELOCITY, JointParams, JointState, Places
from massprop_drake.maths.estimation.joint.sensitivity import Link, carried
from massprop_drake.maths.linear_algebra import Array

ONSETS = 20  # held at most: with gaps of a third of their age they reach back 200 cycles
OLDEST = 200  # cycles; a weaker failure has changed the state by less than the filter's own noise by then
_GAP = 1.0 / 3.0  # of the age: an onset known to a third of its age costs a leak a few percent of its statistic
_LEAST_GAP = 2.0  # cycles between neighbors of an entry that may go
_KEPT_YOUNG = 2  # youngest that never go: the onset of what is found at once
_ALLOWED = 0.5  # samples that a jet must have been on (off) in all for a loss (a leak) of it to show


class Bank(NamedTuple):
    """Past onsets, oldest first, and what has happened since each.

    Attributes:
        states: after the cycle of each.
        cycles: number of that cycle, shape (k,).
        learned: D, what the filter has learned since, shape (k, size).
        rows: derivative of w and of what all c have gathered, by the state at the onset, shape (k, 6, size).
        noise: covariance of process noise on w and c since, shape (k, 6, 6).
        elapsed_s: time since, shape (k,).
        missing: seconds of full thrust that each jet could have given on top, shape (k, n_jets).
        given: seconds of full thrust that it gave, shape (k, n_jets).
    """

    states: tuple[JointState, ...]
    cycles: np.ndarray
    learned: Array
    rows: Array
    noise: Array
    elapsed_s: Array
    missing: Array
    given: Array


class Telescoped(NamedTuple):
    """What the test says of each onset; zero where nothing can be found.

    Attributes:
        total: T, shape (k,).
        likelihood: l of every jet, shape (k, n_jets).
        force: its estimated force, positive: it gives more than it is told, lbf or N, shape (k, n_jets).
    """

    total: Array
    likelihood: Array
    force: Array


def empty(places: Places) -> Bank:
    """A bank without onsets."""
    n, jets = places.size, places.jets
    return Bank(
        states=(),
        cycles=np.zeros(0),
        learned=np.zeros((0, n)),
        rows=np.zeros((0, 6, n)),
        noise=np.zeros((0, 6, 6)),
        elapsed_s=np.zeros(0),
        missing=np.zeros((0, jets)),
        given=np.zeros((0, jets)),
    )


def advanced(bank: Bank, over: Link, places: Places) -> Bank:
    """The bank after one more interval, before what the filter learns from its readings."""
    if not bank.states:
        return bank
    learned = carried(bank.learned.T, np.zeros((6, 1)), over, places).T
    rate, gathered = bank.rows[:, :3], bank.rows[:, 3:]
    by_parameters, by_velocity = over.rate_rows.copy(), over.velocity_rows.copy()
    by_parameters[:, RATE] = by_velocity[:, RATE] = 0.0
    rows = np.empty_like(bank.rows)
    rows[:, :3] = rate + by_parameters + over.rate_rows[:, RATE] @ rate
    rows[:, 3:] = gathered + by_velocity + over.velocity_rows[:, RATE] @ rate
    duration = over.duration_s
    return bank._replace(
        learned=learned,
        rows=rows,
        noise=bank.noise + over.noise,
        elapsed_s=bank.elapsed_s + duration,
        missing=bank.missing + (duration - over.amount),
        given=bank.given + over.amount,
    )


def taken(bank: Bank, over: Link, state: JointState, cycle: int) -> Bank:
    """The bank after the update of a cycle, with it as the youngest onset; one of the old goes if it is full."""
    places_size, jets = bank.learned.shape[1], bank.given.shape[1]
    ages = cycle - bank.cycles
    keep = np.flatnonzero(ages <= OLDEST)
    if keep.shape[0] >= ONSETS:
        keep = np.delete(keep, _dispensable(ages[keep]))
    start = np.zeros((1, 6, places_size))
    start[0, :3, RATE] = np.eye(3)
    return Bank(
        states=(*(bank.states[index] for index in keep), state),
        cycles=np.append(bank.cycles[keep], float(cycle)),
        learned=np.vstack((bank.learned[keep] + over.correction, np.zeros((1, places_size)))),
        rows=np.concatenate((bank.rows[keep], start)),
        noise=np.concatenate((bank.noise[keep], np.zeros((1, 6, 6)))),
        elapsed_s=np.append(bank.elapsed_s[keep], 0.0),
        missing=np.vstack((bank.missing[keep], np.zeros((1, jets)))),
        given=np.vstack((bank.given[keep], np.zeros((1, jets)))),
    )


def _dispensable(ages: Array) -> int:
    """Index of the entry that goes: the youngest that its neighbors can stand for, else the oldest."""
    for index in range(ages.shape[0] - 1 - _KEPT_YOUNG, 0, -1):
        if ages[index - 1] - ages[index + 1] <= max(_LEAST_GAP, _GAP * ages[index]):
            return index
    return 0


def averaging(read: Array, places: Places) -> Array | None:
    """Means over the packages that read, rate first, shape (6, m); None where an axis has no reading."""
    weights = np.zeros((6, read.shape[0]))
    for row, begin, packages in ((0, 0, places.gyros), (3, 3 * places.gyros, places.accelerometers)):
        for axis in range(3):
            present = [begin + 3 * k + axis for k in range(packages) if not np.isnan(read[begin + 3 * k + axis])]
            if not present:
                return None
            weights[row + axis, present] = 1.0 / len(present)
    return weights


def testable(bank: Bank, over: Link, places: Places) -> bool:
    """Whether there is an onset, and a reading of every axis.

    Args:
        bank: see `Bank`.
        over: the interval that ends now.
        places: see `Places`.
    """
    return bool(bank.states) and averaging(over.read, places) is not None


def tested(bank: Bank, over: Link, least: float, params: JointParams) -> Telescoped | None:
    """The test of every onset after `advanced`; None where a reading is missing or nothing can reach a level.

    Args:
        bank: see `Bank`.
        over: the interval that ends now.
        least: e^T R^-1 e below which an onset is not looked at; T and l are smaller still.
        params: see `JointParams`.
    """
    places = params.places
    mean = averaging(over.read, places) if bank.states else None
    if mean is None:
        return None
    present = np.flatnonzero(mean.any(axis=0))
    mean, jacobian = mean[:, present], mean[:, present] @ over.jacobian[present]
    variances = mean**2 @ params.variances[present]
    residual = mean @ over.innovation[present] + bank.learned @ jacobian.T
    bounds = np.sum(residual**2 / variances, axis=1)
    looked_at = np.flatnonzero((bounds >= least) & (bank.elapsed_s > 0.0))
    if looked_at.shape[0] == 0:
        return None
    covariance = _covariances(bank, looked_at, jacobian, params) + np.diag(variances)
    half = np.linalg.inv(np.linalg.cholesky(covariance))
    whitened = np.einsum("kij,kj->ki", half, residual[looked_at])
    on_outputs = _on_outputs(jacobian, places)
    signature = half @ (on_outputs @ over.effects.T)
    projection = np.einsum("kij,ki->kj", signature, whitened)
    energy = np.maximum(np.sum(signature**2, axis=1), np.finfo(np.float64).tiny)
    positive = projection > 0.0
    seconds = np.where(positive, bank.missing[looked_at], bank.given[looked_at])
    enough = seconds > _ALLOWED * over.duration_s
    k, jets = bank.missing.shape
    total, likelihood, force = np.zeros(k), np.zeros((k, jets)), np.zeros((k, jets))
    total[looked_at] = np.sum(whitened**2, axis=1)
    likelihood[looked_at] = np.where(enough, projection**2 / energy, 0.0)
    force[looked_at] = np.where(enough, projection / energy / np.maximum(seconds, 1e-9), 0.0)
    return Telescoped(total, likelihood, np.clip(force, -params.thrusts, params.thrusts))


def _on_outputs(jacobian: Array, places: Places) -> Array:
    """Derivative of the averaged outputs by w and by what all c gather, shape (6, 6)."""
    result = np.zeros((6, 6))
    result[:, :3] = jacobian[:, RATE]
    for package in range(places.accelerometers):
        result[:, 3:] += jacobian[:, VELOCITY + 3 * package : VELOCITY + 3 * package + 3]
    return result


def output_rows(bank: Bank, index: int, jacobian: Array, params: JointParams) -> Array:
    """M: derivative of the averaged outputs now by the state at an onset, shape (6, size)."""
    places = params.places
    rows = jacobian.copy()
    rows[:, RATE] = 0.0
    rows += _on_outputs(jacobian, places) @ bank.rows[index]
    if places.n_acceleration_bias > 0:
        for package in range(places.accelerometers):
            part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
            begin = places.acceleration_bias + 3 * package
            rows[:, begin : begin + 3] += bank.elapsed_s[index] * params.acceleration_bias_sigma * jacobian[:, part]
    return rows


def _covariances(bank: Bank, looked_at: np.ndarray, jacobian: Array, params: JointParams) -> Array:
    """Covariance of the prediction's averaged outputs from each onset, shape (number, 6, 6)."""
    on_outputs = _on_outputs(jacobian, params.places)
    result = np.empty((looked_at.shape[0], 6, 6))
    for place, index in enumerate(looked_at):
        half = output_rows(bank, index, jacobian, params) @ bank.states[index].root
        result[place] = half @ half.T + on_outputs @ bank.noise[index] @ on_outputs.T
    return result


def onset_of(total: Array, share: float) -> int:
    """Index of the youngest onset whose statistic comes near the best one's; older ones explain as much.

    Args:
        total: T of each onset, shape (k,).
        share: of the largest that is near.
    """
    return int(np.flatnonzero(total >= share * total.max())[-1])
