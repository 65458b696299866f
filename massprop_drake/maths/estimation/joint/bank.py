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
from massprop_drake.maths.estimation.joint.sensitivity import Link, Traces, linearize_terms, propagate_to_update
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
    """Returns an empty bank of past fault onsets: no states, and a recursion of zero length."""
    n, jets, disturbed = places.size, places.jets, 6 + places.n_slow
    recursion = Since(
        cycles=np.zeros(0),
        learned=np.zeros((0, n)),
        rows=np.zeros((0, 6 + places.n_swing, n)),
        noise=np.zeros((0, disturbed, disturbed)),
        kept=np.zeros((0, places.n_slow)),
        elapsed_s=np.zeros(0),
        missing=np.zeros((0, jets)),
        given=np.zeros((0, jets)),
    )
    return Bank((), recursion)


@kernel
def advance_recursion(recursion: Since, interval: Link, places: Places) -> Since:
    """Propagates corrections, derivatives and process noise since each past onset to an interval's end, not updated."""
    learned = recursion.learned + interval.crossing_correction
    if interval.stamp_row.any():
        learned[:, places.ticks : places.ticks + places.n_ticks] *= interval.ticks_kept
        learned += interval.stamp_correction
    learned = propagate_to_update(learned.T, np.zeros((6, 1)), interval, places).T
    rate, velocity = recursion.rows[:, :3], recursion.rows[:, 3:6]
    by_parameters, by_velocity = interval.rate_rows.copy(), interval.velocity_rows.copy()
    swing = slice(places.swing, places.swing + places.n_swing)
    by_parameters[:, RATE], by_parameters[:, swing] = 0.0, 0.0
    by_velocity[:, RATE], by_velocity[:, swing] = 0.0, 0.0
    slow = slice(places.slow, places.slow + places.n_slow)
    rows = np.empty_like(recursion.rows)
    rows[:, :3] = rate + by_parameters + times_stack(interval.rate_rows[:, RATE], rate)
    rows[:, 3:6] = velocity + by_velocity + times_stack(interval.velocity_rows[:, RATE], rate)
    if places.n_swing > 0:
        modes, by_state = recursion.rows[:, 6:], interval.swing_rows.copy()
        by_state[:, RATE], by_state[:, swing] = 0.0, 0.0
        rows[:, :3] += times_stack(interval.rate_rows[:, swing].copy(), modes)
        rows[:, 3:6] += times_stack(interval.velocity_rows[:, swing].copy(), modes)
        rows[:, 6:] = by_state + times_stack(interval.swing_rows[:, RATE].copy(), rate)
        rows[:, 6:] += times_stack(interval.swing_rows[:, swing].copy(), modes)
    for index in range(rows.shape[0] if places.n_slow > 0 else 0):  # of z at the onset less and less is left
        rows[index, :3, slow] += (recursion.kept[index] - 1.0) * interval.rate_rows[:, slow]
        rows[index, 3:6, slow] += (recursion.kept[index] - 1.0) * interval.velocity_rows[:, slow]
        if places.n_swing > 0:
            rows[index, 6:, slow] += (recursion.kept[index] - 1.0) * interval.swing_rows[:, slow]
    duration = interval.duration_s
    return Since(
        recursion.cycles,
        learned,
        rows,
        _noise_since(recursion.noise, interval, places),
        recursion.kept * interval.kept,
        recursion.elapsed_s + duration,
        recursion.missing + (duration - interval.amount),
        recursion.given + interval.amount,
    )


@kernel
def _noise_since(noise: Array, interval: Link, places: Places) -> Array:
    """Advances covariances of process noise since the onsets by one interval, shape (k, d, d)."""
    n, slow = places.n_slow, slice(places.slow, places.slow + places.n_slow)
    if n == 0:
        return noise + interval.noise
    transition = np.eye(6 + n)
    transition[:3, 6:] = interval.rate_rows[:, slow]
    transition[3:6, 6:] = interval.velocity_rows[:, slow]
    transition[6:, 6:] *= interval.kept
    after = np.empty_like(noise)
    for index in range(noise.shape[0]):
        after[index] = transition @ noise[index] @ transition.T + interval.noise
    return after


@kernel
def add_onset(recursion: Since, correction: Array, cycle: float, params: JointParams) -> tuple[Since, np.ndarray]:
    """Adds a cycle as youngest onset, drops those too old, and one if full; returns recursion and indices kept.

    Args:
        correction: of the mean by the update of the cycle, shape (size,).
    """
    size, jets, places = recursion.learned.shape[1], recursion.given.shape[1], params.places
    ages = (cycle - recursion.cycles) / params.rates.steps
    keep = np.flatnonzero(ages <= OLDEST)
    if keep.shape[0] >= ONSETS:
        keep = np.delete(keep, _onset_to_drop(ages[keep]))
    start = np.zeros((1, 6 + places.n_swing, size))
    start[0, :3, RATE] = _IDENTITY
    for element in range(places.n_swing):
        start[0, 6 + element, places.swing + element] = 1.0
    after = Since(
        np.append(recursion.cycles[keep], cycle),
        np.vstack((recursion.learned[keep] + correction, np.zeros((1, size)))),
        np.concatenate((recursion.rows[keep], start)),
        np.concatenate((recursion.noise[keep], np.zeros((1, *recursion.noise.shape[1:])))),
        np.vstack((recursion.kept[keep], np.ones((1, recursion.kept.shape[1])))),
        np.append(recursion.elapsed_s[keep], 0.0),
        np.vstack((recursion.missing[keep], np.zeros((1, jets)))),
        np.vstack((recursion.given[keep], np.zeros((1, jets)))),
    )
    return after, keep


@kernel
def _onset_to_drop(ages: Array) -> int:
    """Returns index of the onset to drop: youngest with neighbors close for its age (two newest stay), else oldest."""
    for index in range(ages.shape[0] - 1 - _KEPT_YOUNG, 0, -1):
        if ages[index - 1] - ages[index + 1] <= max(_LEAST_GAP, _GAP * ages[index]):
            return index
    return 0


@kernel
def averaging_matrix(reading: Array, places: Places) -> tuple[Array, bool]:
    """Returns the matrix that averages the readings present over packages, and whether rates about all axes are read.

    Its shape is (6, m), or (3, m) where an axis has no velocity.
    """
    weights, all_rates, all_velocities = np.zeros((6, reading.shape[0])), True, True
    for row, begin, packages in ((0, 0, places.gyros), (3, 3 * places.gyros, places.accelerometers)):
        for axis in range(3):
            present = 0
            for package in range(packages):
                if not np.isnan(reading[begin + 3 * package + axis]):
                    present += 1
            if row == 0:
                all_rates = all_rates and present > 0
            else:
                all_velocities = all_velocities and present > 0
            for package in range(packages):
                if not np.isnan(reading[begin + 3 * package + axis]):
                    weights[row + axis, begin + 3 * package + axis] = 1.0 / present
    return weights if all_velocities else weights[:3].copy(), all_rates


@kernel
def test_onsets(
    recursion: Since, roots: Roots, interval: Link, threshold: float, params: JointParams
) -> tuple[OnsetTests, bool]:
    """Computes at each past onset the GLR of any fault and of each jet failure, and whether any was testable.

    None can where a rate is missing, or nothing can reach a level.

    Args:
        threshold: e^T R^-1 e below which an onset is not tested; T and l are smaller still.
    """
    k, jets = recursion.missing.shape
    total, likelihood, force = np.zeros(k), np.zeros((k, jets)), np.zeros((k, jets))
    nothing = OnsetTests(total, likelihood, force)
    mean, complete = averaging_matrix(interval.read, params.places)
    if not complete:
        return nothing, False
    present = np.flatnonzero(~np.isnan(interval.read))
    mean = mean[:, present]
    jacobian = mean @ interval.jacobian[present]
    variances = mean**2 @ params.variances[present]
    residual = mean @ interval.innovation[present] + recursion.learned @ jacobian.T
    bounds = np.sum(residual**2 / variances, axis=1)
    indices = np.flatnonzero((bounds >= threshold) & (recursion.elapsed_s > 0.0))
    if indices.shape[0] == 0:
        return nothing, False
    on_outputs = rate_output_derivative(jacobian, params.places)
    covariance = _output_covariances(recursion, roots, indices, (jacobian, on_outputs), params) + np.diag(variances)
    indices, covariance = _drop_rounded_onsets(indices, covariance, variances)
    if indices.shape[0] == 0:
        return nothing, False
    half = inverses(triangular_roots(covariance))
    whitened = stack_times_vectors(half, residual[indices])
    signature = stack_times(half, on_outputs @ interval.effects.T)
    projection = stack_times_vectors(signature.transpose(0, 2, 1), whitened)
    energy = np.maximum(np.sum(signature**2, axis=1), _TINY)
    seconds = np.where(projection > 0.0, recursion.missing[indices], recursion.given[indices])
    enough = seconds > _ALLOWED * interval.duration_s
    total[indices] = np.sum(whitened**2, axis=1)
    likelihood[indices] = np.where(enough, projection**2 / energy, 0.0)
    force[indices] = np.where(enough, projection / energy / np.maximum(seconds, _LEAST_SECONDS), 0.0)
    return OnsetTests(total, likelihood, np.minimum(np.maximum(force, -params.thrusts), params.thrusts)), True


@kernel
def _drop_rounded_onsets(indices: np.ndarray, covariance: Array, variances: Array) -> tuple[np.ndarray, Array]:
    """Returns indices and covariances of onsets whose predictions are accurate enough despite rounding.

    Of others the covariance may have no root. A filter that is lost may know as little from one sample to the next.
    """
    resolved = np.ones(indices.shape[0], dtype=np.bool_)
    for place in range(indices.shape[0]):
        resolved[place] = (variances > _ROUNDING * np.diag(covariance[place])).all()
    return indices[resolved], covariance[resolved]


@kernel
def rate_output_derivative(jacobian: Array, places: Places) -> Array:
    """Computes the derivative of averaged outputs by rate and by a common velocity change, shape (r, 6)."""
    result = np.zeros((jacobian.shape[0], 6))
    result[:, :3] = jacobian[:, RATE]
    for package in range(places.accelerometers):
        result[:, 3:] += jacobian[:, VELOCITY + 3 * package : VELOCITY + 3 * package + 3]
    return result


@kernel
def output_rows(recursion: Since, index: int, jacobian: Array, output_derivative: Array, params: JointParams) -> Array:
    """Computes the derivative of the newest averaged readings by the state at the onset `index`, shape (r, size).

    Args:
        jacobian: derivative of the averaged outputs by the state now, shape (r, size).
        output_derivative: see `rate_output_derivative`.
    """
    places = params.places
    rows = jacobian.copy()
    rows[:, RATE] = 0.0
    rows += output_derivative @ np.ascontiguousarray(recursion.rows[index, :6])
    if places.n_acceleration_bias > 0:
        for package in range(places.accelerometers):
            part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
            begin = places.acceleration_bias + 3 * package
            rows[:, begin : begin + 3] += (
                recursion.elapsed_s[index] * params.acceleration_bias_sigma * jacobian[:, part]
            )
    return rows


@kernel
def _output_covariances(
    recursion: Since,
    roots: Roots,
    indices: np.ndarray,
    derivatives: tuple[Array, Array],
    params: JointParams,
) -> Array:
    """Computes covariances, (k, r, r), of averaged readings as predicted from k onsets, reading noise left out."""
    jacobian, on_outputs = derivatives
    result = np.empty((indices.shape[0], jacobian.shape[0], jacobian.shape[0]))
    for place in range(indices.shape[0]):
        index = indices[place]
        rows = output_rows(recursion, index, jacobian, on_outputs, params)
        half = sparse_product(rows, roots.stack[roots.places[index]])  # jets that have not fired since tell nothing
        result[place] = half @ half.T + on_outputs @ np.ascontiguousarray(recursion.noise[index, :6, :6]) @ on_outputs.T
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
def follow_cycle(
    recursion: Since, roots: Roots, terms: Traces, cycle: float, threshold: float, params: JointParams
) -> Followed:
    """Linearizes a cycle, advances the bank of past onsets over it, and tests them (see `test_onsets`)."""
    interval = linearize_terms(terms, params)
    advanced = advance_recursion(recursion, interval, params.places)
    _, complete = averaging_matrix(interval.read, params.places)
    tests, tested = test_onsets(advanced, roots, interval, threshold, params)
    after, keep = add_onset(advanced, interval.correction, cycle, params)
    return Followed(interval, tests, tested, complete, after, keep)


def advance_bank(
    bank: Bank, terms: Traces, state: JointState, cycle: int, threshold: float, params: JointParams
) -> tuple[Link, OnsetTests | None, bool, Bank]:
    """Advances the bank of onsets over a cycle; returns linearized cycle, tests or None, if all rates are read, bank.

    Args:
        bank, terms, cycle, threshold: see `follow_cycle`.
        state: after the cycle, the youngest onset then.
    """
    states, recursion, compiled = *bank, params.compiled
    if not states:
        interval = linearize_terms(terms, params)
        return interval, None, False, Bank((state,), add_onset(recursion, interval.correction, float(cycle), params)[0])
    roots = tuple(onset_state.root for onset_state in states)  # without a copy
    if compiled is None:
        followed = follow_cycle(
            recursion, Roots(roots, range(len(roots))), terms, float(cycle), float(threshold), params
        )
    else:
        stacked = Roots(np.stack(roots), np.arange(len(roots)))
        followed = compiled.follow_cycle(Following(recursion, stacked, terms, float(cycle), float(threshold)))
    after = Bank((*(states[index] for index in followed.keep.tolist()), state), followed.since)
    return followed.link, followed.tested if followed.some else None, followed.complete, after


@kernel
def is_alarming(jet_glr: float, total_glr: float) -> bool:
    """Tests whether the GLR of a single jet, or that of any fault, exceeds its level for starting a fault search."""
    return jet_glr > ALARM or total_glr > _ALARM_ANY
