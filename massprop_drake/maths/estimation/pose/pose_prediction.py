r"""Prediction over one interval, and its linearization.

With J_j and JJ_j of `openings`, a_j the acceleration that jet j gives the nominal vehicle, R the attitude in the
middle of the interval, b = sum g_j J_j a_j and tau = sum g_j J_j (x_j - r) x a_j, b2 and tau2 the same with JJ,

    v   <- v e^(-k_v T) + R b + T s_v
    p   <- p + v T (1 - k_v T/2) + R b2 + T^2 s_v / 2
    w   <- w e^(-k_w T) + K tau + T (s_w + t) - T K (w x K^-1 w)
    phi <- w T (1 - k_w T/2) + K tau2 + T^2 (s_w + t) / 2, and R <- R exp(phi)

with t = t_c cos + t_s sin of the heading about z. K^-1 is m times smaller than the inertia, which the dynamic coupling
does not feel.

A known outside force f and torque n, about the vehicle's origin, do as a jet of one unit of thrust would, with mu in
place of g: mu f/m_0 and K mu (n - r x f)/m_0.

*Second order.* K tau is a product of two things that are not known yet. With P their covariances, it has the mean
sum_j P(K_ij, tau_j) besides, and the covariance sum_jl [P(K_ij, K_kl) P(tau_j, tau_l) + P(K_ij, tau_l) P(tau_j, K_kl)]:
without these the first seconds, in which both are unknown, are believed as if they were not.

*Noise*: white accelerations; what each opening scatters, in proportion to J_j; walks of s and of c, which takes all
g_j with it. Forces that the model does not have, white or as kicks, are felt by accelerometers, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.openings import Openings, OpeningTimes, average_openings
from massprop_drake.maths.estimation.pose.pose_layout import PUSHED, Commands, PoseBank, PoseParams
from massprop_drake.maths.estimation.pose.turning import (
    derivative_by_elements,
    matrix_vector_products,
    rotations,
    skew_matrices,
)
from massprop_drake.maths.linear_algebra import Array, cross_products, symmetrized_stack
from massprop_drake.maths.mass_properties import ELEMENT

_EYE = np.eye(3)


class Predicted(NamedTuple):
    """Bank at the end of an interval, before its readings.

    Attributes:
        bank: see `PoseBank`.
        kick: what 1 sigma of each component of a kick does to what is free, shape (n_filters, n, 12).
        through: how what is free goes with what was free before, shape (n_filters, n, n).
    """

    bank: PoseBank
    kick: Array
    through: Array


class _IntervalThrust(NamedTuple):
    """Thrust of the jets over an interval, filter by filter.

    Attributes:
        openings: see `Openings`.
        once, twice: J and JJ with what stands open, shape (n_filters, n_jets).
        shut: share of each jet that follows its commands, and does not stand open, shape (n_filters, n_jets).
        factor: g (1 + e), shape (n_filters, n_jets).
        strength: 1 + e, likewise.
        middle_turn: from the beginning to the middle of the interval, shape (n_filters, 3, 3).
        middle: R, shape (n_filters, 3, 3).
        forces: accelerations in the fixed frame, shape (n_filters, n_jets, 3).
        moments: (x - r) x a, body axes, shape (n_filters, n_jets, 3).
        turns: K times these.
        duration: T, s.
    """

    openings: Openings
    once: Array
    twice: Array
    shut: Array
    factor: Array
    strength: Array
    middle_turn: Array
    middle: Array
    forces: Array
    moments: Array
    turns: Array
    duration: float

    @property
    def since(self) -> Array:
        """Mean time from the jets' thrust to the interval's end, shape (n_filters, n_jets)."""
        fired = self.once > 0.0
        return np.where(fired, self.twice / np.where(fired, self.once, 1.0), 0.5 * self.duration)

    def sum_over_jets(self, integrals: Array, effects: Array) -> Array:
        """Sums over jets: thrust factor times impulse integral times effect (acceleration, moment), (n_filters, 3)."""
        return np.einsum("hn,hni->hi", self.factor * integrals, effects)


def _columns(integrals: Array, effects: Array) -> Array:
    """Multiplies each jet's effect (acceleration, moment) by its impulse integral, shape (n_filters, 3, n_jets)."""
    return np.swapaxes(integrals[..., None] * effects, 1, 2)


def _interval_openings(bank: PoseBank, commands: Commands, span_s: tuple[float, float], params: PoseParams) -> Openings:
    """Computes time integrals of jets' relative thrust over an interval, by each filter's valve-timing estimate."""
    parts, kinds, mean = params.parts, params.kinds, bank.mean
    timing = OpeningTimes(
        mean[:, parts.delay][:, kinds], np.exp(mean[:, parts.lag][:, kinds]), mean[:, parts.opening][:, kinds]
    )
    deviation = np.zeros_like(mean)
    deviation[:, params.free] = np.sqrt(np.maximum(np.diagonal(bank.covariance, axis1=1, axis2=2), 0.0))
    return average_openings(commands, span_s, timing, deviation[:, parts.delay][:, kinds])


def predict_bank(bank: PoseBank, commands: Commands, begin_s: float, end_s: float, params: PoseParams) -> Predicted:
    """Predicts state and covariance of a bank of filters over an interval, without its readings.

    Args:
        bank: at its beginning.
        begin_s, end_s: of the interval.
    """
    openings = _interval_openings(bank, commands, (begin_s, end_s), params)
    bank, kept = _renew_pulses(bank, openings, params)
    thrust = _acting_thrust(bank, openings, end_s - begin_s, params)
    size, count = params.parts.size, bank.mean.shape[0]
    state = bank.mean.copy()
    jacobian = np.broadcast_to(np.eye(size), (count, size, size)).copy()
    _predict_translation(state, jacobian, thrust, bank, params)
    angle = _predict_rotation(state, jacobian, thrust, bank, params)
    if commands.outside is not None:
        angle += _add_outside_forces(state, jacobian, thrust, (bank, commands.outside), params)
    _fill_timing_derivatives(jacobian, thrust, params)
    _fill_opening_derivatives(jacobian, thrust, bank, params)
    if params.free[-1] >= params.parts.pulse.start:
        _fill_pulse_derivatives(jacobian, thrust, bank, params)
    spun = _predict_accelerometers(state, jacobian, thrust, bank, params)
    if commands.outside is not None:
        _add_felt_forces(state, jacobian, thrust, (bank, commands.outside), params)
    free = params.free
    through = jacobian[:, free[:, None], free]
    bias, rate_covariance = _second_order_moments(thrust, bank, params)
    state[:, params.parts.rate] += bias
    angle += 0.5 * thrust.duration * bias
    gained, impulse_covariance = _timing_products(thrust, bank, params)
    for effect, rows, twice in _effects(thrust, params):
        more = np.einsum("hn,hni->hi", gained * thrust.since if twice else gained, effect)
        if rows == params.parts.attitude:
            angle += more
        else:
            state[:, rows] += more
    covariance = through @ bank.covariance @ np.swapaxes(through, 1, 2) + _noise(
        thrust, rate_covariance, impulse_covariance, params
    )
    covariance = symmetrized_stack(covariance)
    turned = {"rotation": bank.rotation @ rotations(angle), "turned": bank.turned + spun}
    moved = bank._replace(mean=state, covariance=covariance, **turned)
    return Predicted(moved, _kick_effects(thrust, params), through if kept is None else through * kept[:, None, :])


def _renew_pulses(bank: PoseBank, openings: Openings, params: PoseParams) -> tuple[PoseBank, Array | None]:
    """Resets estimates of pulses' scatter where pulses begin; returns the bank, and factors (0: reset, else 1) or None.

    They are drawn anew, independent; the share is zero for those, else one, shape (n_filters, n); None: all is kept.
    """
    scattered = np.flatnonzero(params.pulse_scatter > 0.0)
    begins = openings.begins[:, scattered]
    if not begins.any():
        return bank, None
    places = params.parts.pulse.start + scattered
    rows = np.searchsorted(params.free, places)
    mean, kept = bank.mean.copy(), np.ones((bank.mean.shape[0], params.free.size))
    mean[:, places] *= ~begins
    kept[:, rows] = ~begins
    covariance = bank.covariance * kept[:, :, None] * kept[:, None, :]
    covariance[:, rows, rows] += begins * params.pulse_scatter[scattered] ** 2
    return bank._replace(mean=mean, covariance=covariance), kept


def _acting_thrust(bank: PoseBank, openings: Openings, duration: float, params: PoseParams) -> _IntervalThrust:
    """Computes thrust impulses, forces and moments of the jets over an interval, an open jet's included."""
    parts, mean = params.parts, bank.mean
    once, twice, shut = openings.once.copy(), openings.twice.copy(), np.ones_like(openings.once)
    strength = 1.0 + mean[:, parts.pulse]
    filters = np.flatnonzero(bank.opens >= 0)
    jets, share = bank.opens[filters], mean[filters, parts.open.start]
    once[filters, jets] += share * (duration - openings.once[filters, jets])
    twice[filters, jets] += share * (0.5 * duration**2 - openings.twice[filters, jets])
    shut[filters, jets] -= share
    middle_turn = rotations(0.5 * duration * mean[:, parts.rate])
    middle = bank.rotation @ middle_turn
    moments = cross_products(params.positions - mean[:, None, parts.center], params.pushes)
    return _IntervalThrust(
        openings=openings,
        once=once,
        twice=twice,
        shut=shut,
        factor=mean[:, parts.thrust] * strength,
        strength=strength,
        middle_turn=middle_turn,
        middle=middle,
        forces=np.einsum("hij,nj->hni", middle, params.pushes),
        moments=moments,
        turns=moments @ mean[:, parts.spin][..., ELEMENT],  # K is symmetric
        duration=duration,
    )


# -------------------------------------------------------------------------------- place and velocity


def _predict_translation(
    state: Array, jacobian: Array, thrust: _IntervalThrust, bank: PoseBank, params: PoseParams
) -> None:
    """Fills in position and velocity after an interval of jets and drag, with derivatives but for valve timing."""
    parts, mean, duration = params.parts, bank.mean, thrust.duration
    velocity, drag = mean[:, parts.velocity], mean[:, parts.drag.start, None]
    pushed, left, half = mean[:, parts.push][:, :3], np.exp(-drag * duration), 0.5 * duration**2
    passed = duration * (1.0 - 0.5 * drag * duration)
    state[:, parts.velocity] = velocity * left + thrust.sum_over_jets(thrust.once, thrust.forces) + duration * pushed
    state[:, parts.position] += velocity * passed + thrust.sum_over_jets(thrust.twice, thrust.forces) + half * pushed
    back = np.swapaxes(thrust.middle_turn, 1, 2)
    for rows, integrals, factor in ((parts.velocity, thrust.once, duration), (parts.position, thrust.twice, half)):
        by_turn = -thrust.middle @ skew_matrices((thrust.factor * integrals) @ params.pushes)
        jacobian[:, rows, parts.attitude] = by_turn @ back
        jacobian[:, rows, parts.rate] = 0.5 * duration * by_turn
        jacobian[:, rows, parts.thrust] = _columns(thrust.strength * integrals, thrust.forces)
        jacobian[:, rows, parts.push][:, :, :3] = factor * _EYE
    jacobian[:, parts.velocity, parts.velocity] = left[..., None] * _EYE
    jacobian[:, parts.velocity, parts.drag.start] = -duration * velocity * left
    jacobian[:, parts.position, parts.velocity] = passed[..., None] * _EYE
    jacobian[:, parts.position, parts.drag.start] = -half * velocity


# -------------------------------------------------------------------------------- attitude and rate


def _predict_rotation(
    state: Array, jacobian: Array, thrust: _IntervalThrust, bank: PoseBank, params: PoseParams
) -> Array:
    """Fills in the rate after an interval, and derivatives; returns the rotation vector, rad, (n_filters, 3)."""
    parts, mean, duration = params.parts, bank.mean, thrust.duration
    rate, drag = mean[:, parts.rate], mean[:, parts.drag.start + 1, None]
    spin, half = mean[:, parts.spin][..., ELEMENT], 0.5 * duration**2
    left = np.exp(-drag * duration)
    heading = np.arctan2(thrust.middle[:, 1, 0], thrust.middle[:, 0, 0])
    tilt, cosine, sine = mean[:, parts.tilt], np.cos(heading), np.sin(heading)
    turned = mean[:, parts.push][:, 3:].copy()
    turned[:, 2] += tilt[:, 0] * cosine + tilt[:, 1] * sine
    change = thrust.sum_over_jets(thrust.once, thrust.turns)
    coupled, coupled_by_rate, coupled_by_spin = _coupling(rate + 0.5 * change, spin, params)
    passed = duration * (1.0 - 0.5 * drag * duration)
    state[:, parts.rate] = rate * left + change + duration * (turned + coupled)
    for rows, integrals, factor in ((parts.rate, thrust.once, duration), (parts.attitude, thrust.twice, half)):
        moment = thrust.sum_over_jets(integrals, thrust.moments)
        jacobian[:, rows, parts.spin] = derivative_by_elements(moment) + factor * coupled_by_spin
        jacobian[:, rows, parts.center] = spin @ skew_matrices((thrust.factor * integrals) @ params.pushes)
        jacobian[:, rows, parts.thrust] = _columns(thrust.strength * integrals, thrust.turns)
        jacobian[:, rows, parts.push][:, :, 3:] = factor * _EYE
        jacobian[:, rows, parts.rate] = factor * coupled_by_rate
        jacobian[:, rows.start + 2, parts.tilt.start] = factor * cosine
        jacobian[:, rows.start + 2, parts.tilt.start + 1] = factor * sine
    about_z = duration * (tilt[:, 1] * cosine - tilt[:, 0] * sine)
    jacobian[:, parts.rate.start + 2, parts.attitude.start + 2] += about_z
    jacobian[:, parts.rate, parts.rate] += left[..., None] * _EYE
    jacobian[:, parts.rate, parts.drag.start + 1] = -duration * rate * left
    angle = rate * passed + thrust.sum_over_jets(thrust.twice, thrust.turns) + half * (turned + coupled)
    jacobian[:, parts.attitude, parts.attitude] = np.swapaxes(rotations(angle), 1, 2)
    jacobian[:, parts.attitude, parts.rate] += passed[..., None] * _EYE
    jacobian[:, parts.attitude, parts.drag.start + 1] = -half * rate
    return angle


def _add_outside_forces(
    state: Array, jacobian: Array, thrust: _IntervalThrust, bank_and_wrench: tuple[PoseBank, Array], params: PoseParams
) -> Array:
    """Adds effects of known outside forces to state and derivatives; returns the rotation they add, (n_filters, 3)."""
    parts, duration, (bank, outside) = params.parts, thrust.duration, bank_and_wrench
    torque, force = np.split(outside / params.nominal_mass, 2)
    inverse = _inverse_mass(bank, params)
    spin, half = bank.mean[:, parts.spin][..., ELEMENT], 0.5 * duration**2
    moment = torque - cross_products(bank.mean[:, parts.center], force)
    moves, turns = thrust.middle @ force, matrix_vector_products(spin, moment)
    back = np.swapaxes(thrust.middle_turn, 1, 2)
    by_turn = inverse[..., None] * (-thrust.middle @ skew_matrices(force))
    for rows, factor in ((parts.velocity, duration), (parts.position, half)):
        state[:, rows] += factor * inverse * moves
        jacobian[:, rows] += factor * moves[..., None] * params.of_mass
        jacobian[:, rows, parts.attitude] += factor * by_turn @ back
        jacobian[:, rows, parts.rate] += 0.5 * duration * factor * by_turn
    for rows, factor in ((parts.rate, duration), (parts.attitude, half)):
        jacobian[:, rows] += factor * turns[..., None] * params.of_mass
        jacobian[:, rows, parts.spin] += factor * inverse[..., None] * derivative_by_elements(moment)
        jacobian[:, rows, parts.center] += factor * inverse[..., None] * (spin @ skew_matrices(force))
    state[:, parts.rate] += duration * inverse * turns
    return half * inverse * turns


def _inverse_mass(bank: PoseBank, params: PoseParams) -> Array:
    """Computes nominal over estimated mass, m_0/m, of each filter, shape (n_filters, 1)."""
    return 1.0 + ((bank.mean - params.start) @ params.of_mass)[:, None]


def _add_felt_forces(
    state: Array, jacobian: Array, thrust: _IntervalThrust, bank_and_wrench: tuple[PoseBank, Array], params: PoseParams
) -> None:
    """Adds known outside forces to accelerometer velocities and derivatives; see `_add_outside_forces`."""
    bank, outside = bank_and_wrench
    force = thrust.duration * outside[3:] / params.nominal_mass
    inverse = _inverse_mass(bank, params)
    for rows in _triples(params.parts.gathered):
        state[:, rows] += inverse * force
        jacobian[:, rows] += force[:, None] * params.of_mass


def _coupling(rate: Array, spin: Array, params: PoseParams) -> tuple[Array, Array, Array]:
    """Computes the gyroscopic acceleration -K (w x K^-1 w), and derivatives by w and by the elements of K."""
    if params.planar:
        count = rate.shape[0]
        return np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3, 6))
    inertia: Array = np.asarray(np.linalg.inv(spin), dtype=np.float64)
    momentum = matrix_vector_products(inertia, rate)
    turn = cross_products(rate, momentum)
    over = skew_matrices(rate) @ inertia
    by_rate = -spin @ (over - skew_matrices(momentum))
    by_spin = -derivative_by_elements(turn) + spin @ over @ derivative_by_elements(momentum)
    return -matrix_vector_products(spin, turn), by_rate, by_spin


# ---------------------------------------------------------------------------------- valves and sensors


def _effects(thrust: _IntervalThrust, params: PoseParams) -> Iterator[tuple[Array, slice, bool]]:
    """Yields jets' accelerations, (n_filters, n_jets, 3), the elements that integrate them, and whether twice."""
    parts = params.parts
    yield from ((thrust.forces, parts.velocity, False), (thrust.forces, parts.position, True))
    yield from ((thrust.turns, parts.rate, False), (thrust.turns, parts.attitude, True))
    for rows in _triples(parts.gathered):
        yield np.broadcast_to(params.pushes, thrust.forces.shape), rows, False


def _triples(part: slice) -> Iterator[slice]:
    """Yields the slices of three elements, one per sensor, of a slice of the state."""
    return (slice(begin, begin + 3) for begin in range(part.start, part.stop, 3))


def _fill_timing_derivatives(jacobian: Array, thrust: _IntervalThrust, params: PoseParams) -> None:
    """Fills in the derivatives of the motion by delay, lag and opening time of each kind of jet."""
    parts, openings = params.parts, thrust.openings
    for place, part in enumerate((parts.delay, parts.lag, parts.opening)):
        for kind in range(part.stop - part.start):
            own = thrust.shut * (params.kinds == kind)
            for effect, rows, twice in _effects(thrust, params):
                amount = (openings.twice_by if twice else openings.once_by)[place]
                jacobian[:, rows, part.start + kind] = thrust.sum_over_jets(own * amount, effect)


def _fill_opening_derivatives(jacobian: Array, thrust: _IntervalThrust, bank: PoseBank, params: PoseParams) -> None:
    """Fills in the derivatives of the motion by the open share of the jet that a filter takes for open."""
    column, which = params.parts.open.start, np.flatnonzero(bank.opens >= 0)
    jets, duration = bank.opens[which], thrust.duration
    factor = thrust.factor[which, jets]
    once = factor * (duration - thrust.openings.once[which, jets])
    twice = factor * (0.5 * duration**2 - thrust.openings.twice[which, jets])
    for effect, rows, is_twice in _effects(thrust, params):
        amount = twice if is_twice else once
        jacobian[which, rows, column] = amount[:, None] * effect[which, jets]


def _fill_pulse_derivatives(jacobian: Array, thrust: _IntervalThrust, bank: PoseBank, params: PoseParams) -> None:
    """Fills in the derivatives of the motion by the scatter e of each jet's present pulse."""
    factor = bank.mean[:, params.parts.thrust]
    for effect, rows, twice in _effects(thrust, params):
        amount = factor * (thrust.twice if twice else thrust.once)
        jacobian[:, rows, params.parts.pulse] = _columns(amount, effect)


def _predict_accelerometers(
    state: Array, jacobian: Array, thrust: _IntervalThrust, bank: PoseBank, params: PoseParams
) -> Array:
    """Fills in accelerometer velocities and derivatives; returns the integral of w w^T, (n_filters, 3, 3)."""
    parts, mean, duration = params.parts, bank.mean, thrust.duration
    middle = 0.5 * (mean[:, parts.rate] + state[:, parts.rate])
    spun: Array = duration * (middle[:, :, None] * middle[:, None, :])
    if parts.gathered.stop == parts.gathered.start:
        return spun
    drag = mean[:, parts.drag.start, None]
    own = np.einsum("hji,hj->hi", bank.rotation, mean[:, parts.velocity])  # velocity in body axes
    gained = (thrust.factor * thrust.once) @ params.pushes - duration * drag * own
    for rows, bias in zip(_triples(parts.gathered), _triples(parts.acceleration_bias), strict=True):
        state[:, rows] += gained + duration * mean[:, bias]
        jacobian[:, rows, bias] = duration * _EYE
        jacobian[:, rows, parts.thrust] = _columns(thrust.strength * thrust.once, params.pushes)
        jacobian[:, rows, parts.drag.start] = -duration * own
        jacobian[:, rows, parts.velocity] = -duration * drag[..., None] * np.swapaxes(bank.rotation, 1, 2)
        jacobian[:, rows, parts.attitude] = -duration * drag[..., None] * skew_matrices(own)
    _add_felt_push(state, jacobian, thrust, bank, params)
    return spun


def _add_felt_push(state: Array, jacobian: Array, thrust: _IntervalThrust, bank: PoseBank, params: PoseParams) -> None:
    """Adds an unexplained push to accelerometer velocities and derivatives, in filters that suppose one."""
    parts, filters, duration = params.parts, np.flatnonzero(bank.opens == PUSHED), thrust.duration
    back = np.swapaxes(thrust.middle[filters], 1, 2)
    felt = matrix_vector_products(back, bank.mean[filters, parts.push][:, :3])
    turned = skew_matrices(felt) @ np.swapaxes(thrust.middle_turn[filters], 1, 2)
    for rows in _triples(parts.gathered):
        state[filters, rows] += duration * felt
        jacobian[filters, rows, parts.push.start : parts.push.start + 3] += duration * back
        jacobian[filters, rows, parts.attitude] += duration * turned
        jacobian[filters, rows, parts.rate] += 0.5 * duration**2 * skew_matrices(felt)


# --------------------------------------------------------------------------------------------- noise


def _second_order_moments(thrust: _IntervalThrust, bank: PoseBank, params: PoseParams) -> tuple[Array, Array]:
    """Computes mean and covariance of rate errors by products of errors of inverse inertia and angular impulse."""
    parts, free = params.parts, params.free
    rows = np.zeros((bank.mean.shape[0], 3, parts.size))  # of the angular impulse over the mass
    rows[:, :, parts.thrust] = _columns(thrust.strength * thrust.once, thrust.moments)
    factor = bank.mean[:, parts.thrust]
    rows[:, :, parts.pulse] = _columns(factor * thrust.once, thrust.moments)
    rows[:, :, parts.center] = skew_matrices((thrust.factor * thrust.once) @ params.pushes)
    for part, by in zip((parts.delay, parts.lag, parts.opening), thrust.openings.once_by, strict=True):
        for kind in range(part.stop - part.start):
            rows[:, :, part.start + kind] = thrust.sum_over_jets(
                thrust.shut * (params.kinds == kind) * by, thrust.moments
            )
    rows = rows[:, :, free]
    place = np.full(parts.size, -1)
    place[free] = np.arange(free.size)
    elements = place[parts.spin][ELEMENT]  # of K in what is free, -1: it is known
    there = elements >= 0
    of_impulse = rows @ bank.covariance  # with everything
    impulse = of_impulse @ np.swapaxes(rows, 1, 2)
    crossed = np.where(there[:, :, None], np.moveaxis(of_impulse[:, :, elements], 1, -1), 0.0)  # K_ij with tau_l
    spread = bank.covariance[:, elements[:, :, None, None], elements]
    spread = np.where(there[:, :, None, None] & there, spread, 0.0)  # K_ij with K_kl
    bias = np.einsum("hijj->hi", crossed)
    product = np.einsum("hijkl,hjl->hik", spread, impulse) + np.einsum("hijl,hklj->hik", crossed, crossed)
    return bias, product


def _timing_products(thrust: _IntervalThrust, bank: PoseBank, params: PoseParams) -> tuple[Array, Array]:
    """Computes mean and covariance of jets' impulse errors by products of errors of thrust and valve timing.

    These are products of errors of g and of J, and of J what is not linear itself.
    """
    parts, free, openings = params.parts, params.free, thrust.openings
    count, jets = thrust.once.shape
    by_timing = np.zeros((count, jets, parts.size))
    for place, part in enumerate((parts.delay, parts.lag, parts.opening)):
        by_timing[:, np.arange(jets), part.start + params.kinds] = thrust.shut * openings.once_by[place]
    by_timing = by_timing[:, :, free]
    by_factor = np.zeros((jets, parts.size))
    by_factor[:, parts.thrust] = np.eye(jets)
    with_timing = by_timing @ bank.covariance
    times_ = with_timing @ np.swapaxes(by_timing, 1, 2)
    factors = by_factor[:, free] @ bank.covariance @ by_factor[:, free].T
    crossed = with_timing @ by_factor[:, free].T  # J_j with g_l
    mean = np.diagonal(crossed, axis1=1, axis2=2)
    left = thrust.shut * thrust.factor * openings.unsure  # of what is not linear in the delay
    curved = np.einsum("khi,khj->hij", left, left) * (params.kinds[:, None] == params.kinds)
    return mean, factors * times_ + crossed * np.swapaxes(crossed, 1, 2) + curved


def _noise(thrust: _IntervalThrust, rate_covariance: Array, impulse_covariance: Array, params: PoseParams) -> Array:
    """Computes the process noise covariance of an interval, shape (n_filters, n, n)."""
    parts, free, duration = params.parts, params.free, thrust.duration
    count, n_jets = thrust.once.shape
    columns = np.zeros((count, parts.size, n_jets + 1))
    for effect, rows, twice in _effects(thrust, params):
        each = thrust.since[..., None] * effect if twice else effect
        columns[:, rows, :n_jets] = np.swapaxes(each, 1, 2)
    shared = params.common_walk * np.sqrt(duration)
    columns[:, parts.thrust, n_jets] = shared * thrust.factor / thrust.strength
    columns[:, parts.common, n_jets] = shared
    columns = columns[:, free]
    drawn = np.zeros((count, n_jets + 1, n_jets + 1))
    drawn[:, :n_jets, :n_jets] = impulse_covariance
    scatter = thrust.factor**2 * ((params.scatter * thrust.once) ** 2 + thrust.openings.variance)
    drawn[:, np.arange(n_jets), np.arange(n_jets)] += scatter
    drawn[:, n_jets, n_jets] = 1.0
    walks = np.zeros((parts.size, parts.size))
    for once_row, twice_row, density in (
        (parts.velocity, parts.position, params.velocity_noise**2),
        (parts.rate, parts.attitude, params.rate_noise**2),
    ):
        walks[once_row, once_row] = density * duration * _EYE
        walks[twice_row, twice_row] = density * duration**3 / 3.0 * _EYE
        walks[once_row, twice_row] = walks[twice_row, once_row] = density * duration**2 / 2.0 * _EYE
    for begin, walk in ((parts.push.start, params.push_walk), (parts.push.start + 3, params.turn_walk)):
        walks[begin : begin + 3, begin : begin + 3] = walk**2 * duration * _EYE
    noise: Array = columns @ drawn @ np.swapaxes(columns, 1, 2)
    if parts.gathered.stop == parts.gathered.start:
        noise += walks[np.ix_(free, free)]
    else:
        whole = np.broadcast_to(walks, (count, parts.size, parts.size)).copy()
        felt = np.swapaxes(thrust.middle, 1, 2)  # a force in the fixed frame, by accelerometers
        for rows in _triples(parts.gathered):
            for with_part, moment in ((parts.velocity, duration), (parts.position, 0.5 * duration**2)):
                whole[:, rows, with_part] = params.velocity_noise**2 * moment * felt
                whole[:, with_part, rows] = np.swapaxes(whole[:, rows, with_part], 1, 2)
            for others in _triples(parts.gathered):
                whole[:, rows, others] = params.velocity_noise**2 * duration * _EYE
        noise += whole[:, free[:, None], free]
    turning = np.concatenate((np.full(3, 1.0), np.full(3, 0.5 * duration)))  # of rate and of attitude
    axes = np.r_[parts.rate, parts.attitude]
    there = np.isin(axes, free)
    places, axis = np.searchsorted(free, axes[there]), np.tile(np.arange(3), 2)[there]
    both = np.outer(turning, turning)[np.ix_(there, there)]
    noise[:, places[:, None], places] += both * rate_covariance[:, axis[:, None], axis]
    return noise


def _kick_effects(thrust: _IntervalThrust, params: PoseParams) -> Array:
    """Computes effects on free elements of 1-sigma kicks (sudden changes of velocity or rate), (n_filters, n, 12)."""
    parts, duration = params.parts, thrust.duration
    effect = np.zeros((thrust.once.shape[0], parts.size, 12))
    for once_row, twice_row, size, column in (
        (parts.velocity, parts.position, params.kick_velocity, 0),
        (parts.rate, parts.attitude, params.kick_rate, 3),
    ):
        effect[:, once_row, column : column + 3] = size * _EYE
        effect[:, twice_row, column : column + 3] = 0.5 * duration * size * _EYE
        # a uniform time has this spread
        effect[:, twice_row, column + 6 : column + 9] = duration / np.sqrt(12.0) * size * _EYE
    for rows in _triples(parts.gathered):
        effect[:, rows, :3] = params.kick_velocity * np.swapaxes(thrust.middle, 1, 2)
    return effect[:, params.free]
