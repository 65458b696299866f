r"""The bank of past onsets, and the first-order test of all readings since each of them.

For an onset theta the state after it is carried on without learning. The residual e of the newest readings against
that prediction has the covariance

    Y = M P_theta M^T + R + noise since,    M = H Phi ... Phi,

with P_theta the filter's own covariance at the onset, so that lag, thrust errors and coupling are in it. A force f of
jet j since the onset adds c_j f, c_j = (effect of unit force) x seconds, and

    T = e^T Y^-1 e,    l_j = (c_j^T Y^-1 e)^2 / (c_j^T Y^-1 c_j).

The prediction need not be run for every onset: what the filter has learned since, D, is carried by the filter's own
linearization (`sensitivity`), and e is the filter's innovation and H D. Mean over packages: six rows, rate first; or
three, where no accelerometer reads: then rates alone tell.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import RATE, VELOCITY, JointParams, JointState, Places
from massprop_drake.maths.estimation.joint.sensitivity import Link, Traces, link_from_traces, propagate_to_update
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import (
    Array,
    inverses,
    sparse_product,
    stack_times,
    stack_times_vectors,
    times_stack,
    triangular_roots,
)

ONSETS = 20  # a compute budget, held at most: with gaps of a third of their age they reach back 200 periods
OLDEST = 200  # control periods; a weaker failure has changed the state by less than the filter's own noise by then
_GAP = 1.0 / 3.0  # of the age: an onset known to a third of its age costs a leak a few percent of its statistic
_LEAST_GAP = 2.0  # a compute budget: control periods between neighbors of an entry that may go
_KEPT_YOUNG = 2  # youngest that never go: the onset of what is found at once
_ALLOWED = 0.5  # samples that a jet must have been on (off) in all for a loss (a leak) of it to show
ALARM = 22.0  # GLR of a single jet, chi-square of one degree: once in 4e5 samples of a jet
_ALARM_ANY = 40.0  # of anything, chi-square of six degrees: once in 2e6
_LEAST_SECONDS = 1e-9
_ROUNDING = 1e-13  # of a covariance: sums of some forty products, and the root of six rows
_TINY = float(np.finfo(np.float64).tiny)  # smallest normal double: no division by zero
_IDENTITY = np.eye(3)


class Since(NamedTuple):
    """Recursion of the filter since each onset, oldest first.

    Attributes:
        cycles: number of that cycle, shape (k,).
        learned: D, what the filter has learned since, shape (k, size).
        rows: derivative of w, of what all c have gathered, and of eta and eta' of modes, by the state at the onset,
            shape (k, 6 + n_swing, size).
        noise: covariance of process noise on w, c and z since, see `sensitivity.Link`, shape (k, d, d).
        kept: share of each z at the onset that is left, shape (k, n_slow).
        elapsed_s: time since, shape (k,).
        missing: seconds of full thrust that each jet could have given on top, shape (k, n_jets).
        given: seconds of full thrust that it gave, shape (k, n_jets).
    """

    cycles: Array
    learned: Array
    rows: Array
    noise: Array
    kept: Array
    elapsed_s: Array
    missing: Array
    given: Array


class Bank(NamedTuple):
    """Past onsets, oldest first: the states after the cycle of each, and the filter's recursion since."""

    states: tuple[JointState, ...]
    since: Since


class Roots(NamedTuple):
    """Roots of the covariances at the onsets.

    Attributes:
        stack: shape (n, size, size).
        places: of each onset's among them, shape (k,) or more.
    """

    stack: Any
    places: Any


class OnsetTests(NamedTuple):
    """Result of the test for each onset; zero where nothing can be found.

    Attributes:
        total: T, shape (k,).
        likelihood: l of every jet, shape (k, n_jets).
        force: its estimated force, positive: it gives more than it is told, lbf or N, shape (k, n_jets).
    """

    total: Array
    likelihood: Array
    force: Array


def empty_bank(places: Places) -> Bank:
    """Returns a bank of past onsets that has none: no states, and a recursion of zero length."""
    n, jets, disturbed = places.size, places.jets, 6 + places.n_slow
    since = Since(
        cycles=np.zeros(0),
        learned=np.zeros((0, n)),
        rows=np.zeros((0, 6 + places.n_swing, n)),
        noise=np.zeros((0, disturbed, disturbed)),
        kept=np.zeros((0, places.n_slow)),
        elapsed_s=np.zeros(0),
        missing=np.zeros((0, jets)),
        given=np.zeros((0, jets)),
    )
    return Bank((), since)


@kernel
def advance_recursion(since: Since, over: Link, places: Places) -> Since:
    """Advances corrections, derivatives and noise since each onset by an interval, before its update."""
    learned = since.learned + over.crossing_correction
    if over.stamp_row.any():
        learned[:, places.ticks : places.ticks + places.n_ticks] *= over.ticks_kept
        learned += over.stamp_correction
    learned = propagate_to_update(learned.T, np.zeros((6, 1)), over, places).T
    rate, gathered = since.rows[:, :3], since.rows[:, 3:6]
    by_parameters, by_velocity = over.rate_rows.copy(), over.velocity_rows.copy()
    swing = slice(places.swing, places.swing + places.n_swing)
    by_parameters[:, RATE], by_parameters[:, swing] = 0.0, 0.0
    by_velocity[:, RATE], by_velocity[:, swing] = 0.0, 0.0
    slow = slice(places.slow, places.slow + places.n_slow)
    rows = np.empty_like(since.rows)
    rows[:, :3] = rate + by_parameters + times_stack(over.rate_rows[:, RATE], rate)
    rows[:, 3:6] = gathered + by_velocity + times_stack(over.velocity_rows[:, RATE], rate)
    if places.n_swing > 0:
        modes, by_state = since.rows[:, 6:], over.swing_rows.copy()
        by_state[:, RATE], by_state[:, swing] = 0.0, 0.0
        rows[:, :3] += times_stack(over.rate_rows[:, swing].copy(), modes)
        rows[:, 3:6] += times_stack(over.velocity_rows[:, swing].copy(), modes)
        rows[:, 6:] = by_state + times_stack(over.swing_rows[:, RATE].copy(), rate)
        rows[:, 6:] += times_stack(over.swing_rows[:, swing].copy(), modes)
    for index in range(rows.shape[0] if places.n_slow > 0 else 0):  # of z at the onset less and less is left
        rows[index, :3, slow] += (since.kept[index] - 1.0) * over.rate_rows[:, slow]
        rows[index, 3:6, slow] += (since.kept[index] - 1.0) * over.velocity_rows[:, slow]
        if places.n_swing > 0:
            rows[index, 6:, slow] += (since.kept[index] - 1.0) * over.swing_rows[:, slow]
    duration = over.duration_s
    return Since(
        since.cycles,
        learned,
        rows,
        _noise_since(since.noise, over, places),
        since.kept * over.kept,
        since.elapsed_s + duration,
        since.missing + (duration - over.amount),
        since.given + over.amount,
    )


@kernel
def _noise_since(noise: Array, over: Link, places: Places) -> Array:
    """Advances covariances of process noise since the onsets by one interval, shape (k, d, d)."""
    n, slow = places.n_slow, slice(places.slow, places.slow + places.n_slow)
    if n == 0:
        return noise + over.noise
    through = np.eye(6 + n)
    through[:3, 6:] = over.rate_rows[:, slow]
    through[3:6, 6:] = over.velocity_rows[:, slow]
    through[6:, 6:] *= over.kept
    after = np.empty_like(noise)
    for index in range(noise.shape[0]):
        after[index] = through @ noise[index] @ through.T + over.noise
    return after


@kernel
def add_onset(since: Since, correction: Array, cycle: float, params: JointParams) -> tuple[Since, np.ndarray]:
    """Adds a cycle as youngest onset, drops one if the bank is full; returns recursion and indices that stay.

    Args:
        correction: of the mean by the update of the cycle, shape (size,).
    """
    size, jets, places = since.learned.shape[1], since.given.shape[1], params.places
    ages = (cycle - since.cycles) / params.rates.steps
    keep = np.flatnonzero(ages <= OLDEST)
    if keep.shape[0] >= ONSETS:
        keep = np.delete(keep, _onset_to_drop(ages[keep]))
    start = np.zeros((1, 6 + places.n_swing, size))
    start[0, :3, RATE] = _IDENTITY
    for element in range(places.n_swing):
        start[0, 6 + element, places.swing + element] = 1.0
    after = Since(
        np.append(since.cycles[keep], cycle),
        np.vstack((since.learned[keep] + correction, np.zeros((1, size)))),
        np.concatenate((since.rows[keep], start)),
        np.concatenate((since.noise[keep], np.zeros((1, *since.noise.shape[1:])))),
        np.vstack((since.kept[keep], np.ones((1, since.kept.shape[1])))),
        np.append(since.elapsed_s[keep], 0.0),
        np.vstack((since.missing[keep], np.zeros((1, jets)))),
        np.vstack((since.given[keep], np.zeros((1, jets)))),
    )
    return after, keep


@kernel
def _onset_to_drop(ages: Array) -> int:
    """Returns the index of the onset to drop: the youngest whose neighbors can stand for it, else the oldest."""
    for index in range(ages.shape[0] - 1 - _KEPT_YOUNG, 0, -1):
        if ages[index - 1] - ages[index + 1] <= max(_LEAST_GAP, _GAP * ages[index]):
            return index
    return 0


@kernel
def averaging_matrix(read: Array, places: Places) -> tuple[Array, bool]:
    """Returns the matrix that averages readings over packages, and whether rates about all axes are read.

    Its shape is (6, m), or (3, m) where an axis has no velocity.
    """
    weights, turns, moves = np.zeros((6, read.shape[0])), True, True
    for row, begin, packages in ((0, 0, places.gyros), (3, 3 * places.gyros, places.accelerometers)):
        for axis in range(3):
            present = 0
            for package in range(packages):
                if not np.isnan(read[begin + 3 * package + axis]):
                    present += 1
            if row == 0:
                turns = turns and present > 0
            else:
                moves = moves and present > 0
            for package in range(packages):
                if not np.isnan(read[begin + 3 * package + axis]):
                    weights[row + axis, begin + 3 * package + axis] = 1.0 / present
    return weights if moves else weights[:3].copy(), turns


@kernel
def test_onsets(since: Since, roots: Roots, over: Link, least: float, params: JointParams) -> tuple[OnsetTests, bool]:
    """Computes the likelihood ratios of faults at every onset, and whether any onset could be tested.

    None can where a rate is missing, or nothing can reach a level.

    Args:
        over: the interval that ends now.
        least: e^T R^-1 e below which an onset is not looked at; T and l are smaller still.
    """
    k, jets = since.missing.shape
    total, likelihood, force = np.zeros(k), np.zeros((k, jets)), np.zeros((k, jets))
    nothing = OnsetTests(total, likelihood, force)
    mean, complete = averaging_matrix(over.read, params.places)
    if not complete:
        return nothing, False
    present = np.flatnonzero(~np.isnan(over.read))
    mean = mean[:, present]
    jacobian = mean @ over.jacobian[present]
    variances = mean**2 @ params.variances[present]
    residual = mean @ over.innovation[present] + since.learned @ jacobian.T
    bounds = np.sum(residual**2 / variances, axis=1)
    looked_at = np.flatnonzero((bounds >= least) & (since.elapsed_s > 0.0))
    if looked_at.shape[0] == 0:
        return nothing, False
    on_outputs = rate_output_derivative(jacobian, params.places)
    covariance = _output_covariances(since, roots, looked_at, (jacobian, on_outputs), params) + np.diag(variances)
    looked_at, covariance = _select_resolved(looked_at, covariance, variances)
    if looked_at.shape[0] == 0:
        return nothing, False
    half = inverses(triangular_roots(covariance))
    whitened = stack_times_vectors(half, residual[looked_at])
    signature = stack_times(half, on_outputs @ over.effects.T)
    projection = stack_times_vectors(signature.transpose(0, 2, 1), whitened)
    energy = np.maximum(np.sum(signature**2, axis=1), _TINY)
    seconds = np.where(projection > 0.0, since.missing[looked_at], since.given[looked_at])
    enough = seconds > _ALLOWED * over.duration_s
    total[looked_at] = np.sum(whitened**2, axis=1)
    likelihood[looked_at] = np.where(enough, projection**2 / energy, 0.0)
    force[looked_at] = np.where(enough, projection / energy / np.maximum(seconds, _LEAST_SECONDS), 0.0)
    return OnsetTests(total, likelihood, np.minimum(np.maximum(force, -params.thrusts), params.thrusts)), True


@kernel
def _select_resolved(looked_at: np.ndarray, covariance: Array, variances: Array) -> tuple[np.ndarray, Array]:
    """Returns indices and covariances of onsets whose predictions are accurate enough despite rounding.

    Of others the covariance may have no root. A filter that is lost may know as little from one sample to the next.
    """
    resolved = np.ones(looked_at.shape[0], dtype=np.bool_)
    for place in range(looked_at.shape[0]):
        resolved[place] = (variances > _ROUNDING * np.diag(covariance[place])).all()
    return looked_at[resolved], covariance[resolved]


@kernel
def rate_output_derivative(jacobian: Array, places: Places) -> Array:
    """Computes the derivative of averaged outputs by rate and by a common velocity change, shape (r, 6)."""
    result = np.zeros((jacobian.shape[0], 6))
    result[:, :3] = jacobian[:, RATE]
    for package in range(places.accelerometers):
        result[:, 3:] += jacobian[:, VELOCITY + 3 * package : VELOCITY + 3 * package + 3]
    return result


@kernel
def output_rows(since: Since, index: int, jacobian: Array, on_outputs: Array, params: JointParams) -> Array:
    """Computes the derivative of the averaged outputs now by the filter's state at an onset, shape (r, size).

    Args:
        jacobian: derivative of the averaged outputs by the state now, shape (r, size).
        on_outputs: see `rate_output_derivative`.
    """
    places = params.places
    rows = jacobian.copy()
    rows[:, RATE] = 0.0
    rows += on_outputs @ np.ascontiguousarray(since.rows[index, :6])
    if places.n_acceleration_bias > 0:
        for package in range(places.accelerometers):
            part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
            begin = places.acceleration_bias + 3 * package
            rows[:, begin : begin + 3] += since.elapsed_s[index] * params.acceleration_bias_sigma * jacobian[:, part]
    return rows


@kernel
def _output_covariances(
    since: Since,
    roots: Roots,
    looked_at: np.ndarray,
    derivatives: tuple[Array, Array],
    params: JointParams,
) -> Array:
    """Computes the covariance of the predicted averaged outputs from each onset, shape (number, r, r)."""
    jacobian, on_outputs = derivatives
    result = np.empty((looked_at.shape[0], jacobian.shape[0], jacobian.shape[0]))
    for place in range(looked_at.shape[0]):
        index = looked_at[place]
        rows = output_rows(since, index, jacobian, on_outputs, params)
        half = sparse_product(rows, roots.stack[roots.places[index]])  # jets that have not fired since tell nothing
        result[place] = half @ half.T + on_outputs @ np.ascontiguousarray(since.noise[index, :6, :6]) @ on_outputs.T
    return result


class Following(NamedTuple):
    """Inputs of `follow_cycle` besides the parameters, see there."""

    since: Since
    roots: Roots
    seen: Traces
    cycle: float
    least: float


class Followed(NamedTuple):
    """Bank over a whole cycle.

    Attributes:
        link: see `Link`.
        tested: see `OnsetTests`.
        some: whether it says anything.
        complete: whether there was a rate about every axis.
        since: after the cycle.
        keep: indices of the onsets that stay.
    """

    link: Link
    tested: OnsetTests
    some: bool
    complete: bool
    since: Since
    keep: np.ndarray


@kernel
def follow_cycle(since: Since, roots: Roots, seen: Traces, cycle: float, least: float, params: JointParams) -> Followed:
    """Linearizes a cycle, advances the bank of past onsets over it, and tests them on its readings.

    Args:
        since, roots: of the bank before it.
        least: see `test_onsets`.
    """
    over = link_from_traces(seen, params)
    reached = advance_recursion(since, over, params.places)
    _, complete = averaging_matrix(over.read, params.places)
    found, some = test_onsets(reached, roots, over, least, params)
    after, keep = add_onset(reached, over.correction, cycle, params)
    return Followed(over, found, some, complete, after, keep)


def run_follow_cycle(
    bank: Bank, seen: Traces, state: JointState, cycle: int, least: float, params: JointParams
) -> tuple[Link, OnsetTests | None, bool, Bank]:
    """Advances the bank of onsets over a cycle; returns linearized cycle, tests or None, rates complete, bank.

    Args:
        bank, seen, cycle, least: see `follow_cycle`.
        state: after the cycle, the youngest onset then.
    """
    states, since, made = *bank, params.compiled
    if not states:
        over = link_from_traces(seen, params)
        return over, None, False, Bank((state,), add_onset(since, over.correction, float(cycle), params)[0])
    roots = tuple(each.root for each in states)  # without a copy
    if made is None:
        done = follow_cycle(since, Roots(roots, range(len(roots))), seen, float(cycle), float(least), params)
    else:
        stacked = Roots(np.stack(roots), np.arange(len(roots)))
        done = made.follow_cycle(Following(since, stacked, seen, float(cycle), float(least)))
    after = Bank((*(states[index] for index in done.keep.tolist()), state), done.since)
    return done.link, done.tested if done.some else None, done.complete, after


@kernel
def is_alarming(likelihood: float, total: float) -> bool:
    """Tests whether a jet's GLR or that of any fault exceeds the level at which it opens the search for faults.

    Args:
        likelihood, total: largest GLR of a jet, and of anything.
    """
    return likelihood > ALARM or total > _ALARM_ANY
