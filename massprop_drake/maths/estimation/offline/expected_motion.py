"""Rate and velocity expected over a stretch, by jets, engines, wheels, modes and coupling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.burns import single_engine_impulses
from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES
from massprop_drake.maths.estimation.offline.coupled_rates import (
    CROSS,
    GainedRate,
    ImpulseSums,
    add_rate_coupling,
    cumulative_sums,
    gained_rate,
    impulse_moments,
    mean_rates,
    rate_derivatives,
    turning_products,
)
from massprop_drake.maths.estimation.offline.depletion_course import expand_about_middle
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch, columns
from massprop_drake.maths.estimation.offline.swings import Locked, Swings, add_modes
from massprop_drake.maths.estimation.offline.thrust_course import (
    Lengths,
    RecordedStretch,
    ThrustCourse,
    interpolate_missing,
    prepare_stretch,
    row_positions,
    thrust_course,
)
from massprop_drake.maths.linear_algebra import Array, cross_products
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS
from massprop_drake.maths.vehicle.mounting import displace_wrenches

_ROUNDS = 12  # of Newton's, for coupling with the rates that come of it
_SMALL = 1e-12  # of a rate: these have settled
_STRAYED = 10.0  # arithmetic: times the fastest reading, from which on rates that follow from a model are none
_DIGITS = 1e3  # arithmetic: of a mean that is solved for, three digits at the least


class ExpectedMotion(NamedTuple):
    """Expected readings of a stretch at a point."""

    course: ThrustCourse
    sums: ImpulseSums
    lightness: Array  # of each interval, (m - 1,)
    gained: GainedRate
    velocity: Array  # since the beginning, (3, m)
    by_shift: Array | None  # derivatives of the rate by `Columns.shift`, (9, 3, m), where that is reckoned with
    locked: tuple[Array, Array]  # rate and velocity with the modes locked, (3, m) each

    @property
    def rate(self) -> Array:
        """Change of the rate since the stretch began, shape (3, m)."""
        return self.gained.rate


def stretch_motion(stretch: Stretch, unknowns: Array, model: FlightModel) -> tuple[ExpectedMotion, Array]:
    """Computes rate and velocity expected over a stretch, and the unknowns at its middle, shape (n,).

    Args:
        stretch: of at least two rows.
        unknowns: all unknowns, shape (n,); the inverse inertia positive definite.
    """
    thrust, unknowns = expand_about_middle(
        thrust_course(prepare_stretch(stretch, model), unknowns, model), unknowns, model
    )
    return expected_motion(unknowns, thrust, model), unknowns


def expected_motion(unknowns: Array, thrust: ThrustCourse, model: FlightModel) -> ExpectedMotion:
    """Computes rate and velocity expected over a stretch; measured rates serve in its coupling terms."""
    places, record = columns(model), thrust.read
    wrenches, rate, stretch = acting_wrenches(unknowns, thrust, model), record.rate, record.stretch
    impulse = wrenches @ thrust.amount.T + stretch.outside[:-1].T * record.lengths_s
    impulse += engine_impulses(record, unknowns, model)[0].T
    middle = 0.5 * (rate[:, :-1] + rate[:, 1:])
    turned = np.tensordot(unknowns[places.momentum], CROSS, 1).T @ middle  # momentum of wheels crossed with the rate
    unknown = unknowns[places.torque, None] - unknowns[places.drag, None] * middle + turned
    impulse[:3] += (record.period_s if model.own_times else model.period_s) * unknown  # pure torques
    impulse[:3] -= np.diff(wheel_momentum(record, unknowns, model))
    acting = wrenches @ thrust.level.T if record.late_s.any() else None
    late = None if acting is None else record.late_s * acting
    if model.own_times:
        bow = wrenches @ (thrust.shape * thrust.lacking).swapaxes(1, 2)
    else:
        bow = (wrenches * thrust.shape[:, None]).reshape(18, record.on.size) @ thrust.lacking.T
        bow = bow.reshape(3, 6, impulse.shape[1])
    if thrust.bent is not None:
        bow = bow + np.einsum("ij,kmj->kim", wrenches, thrust.bent)
    impulses = ImpulseSums(impulse, bow, late, acting)
    mass = 1.0 / unknowns[MASS] + stretch.used_after
    lightness = 2.0 / (mass[:-1] + mass[1:])
    velocity = cumulative_sums(impulses.impulse[3:] * lightness)
    if late is not None:
        velocity += late[3:] / mass
    gained = _gained_rate_as_read(rate, impulses, record, unknowns, model)
    if not record.there.all():  # jets fire in between: what they give is no straight line, what is left over is
        left = interpolate_missing(rate - gained.rate, record.there, row_positions(stretch, model))
        gained = _gained_rate_as_read(gained.rate + left, impulses, record, unknowns, model)
    by_shift = None
    if model.sigma[places.shift].any():
        later = cumulative_sums(np.diff(gained.sums) * record.to_use)
        by_shift, _ = rate_derivatives(gained._replace(sums=later), record.period_s, unknowns)
        gained = gained._replace(rate=gained.rate + np.tensordot(unknowns[places.shift], by_shift, 1))
    if record.through is not None:
        moved, _ = rate_derivatives(gained, record.period_s, unknowns)
        shift, turn = record.shifts[CENTER].T, record.shifts[:6][ELEMENT]
        each = np.einsum("eim,em->im", np.diff(moved), record.shifts)
        each += np.einsum("ijm,jm->im", turn, cross_products(impulses.impulse[3:].T, shift).T)  # of both at once
        gained = gained._replace(rate=gained.rate + cumulative_sums(each))
    motion = ExpectedMotion(thrust, impulses, lightness, gained, velocity, by_shift, (gained.rate, velocity))
    if model.modes.frequencies.size == 0:
        return motion
    nothing = np.zeros((0, *velocity.shape))
    swings = with_swings(motion, (nothing, nothing), unknowns, model)
    return motion._replace(gained=gained._replace(rate=swings.rate), velocity=swings.velocity)


def with_swings(
    motion: ExpectedMotion, derivatives: tuple[Array, Array], unknowns: Array, model: FlightModel
) -> Swings:
    """Adds oscillation modes to rate and velocity of a stretch, and to derivatives with locked modes, (k, 3, m)."""
    record, places = motion.course.read, columns(model)
    rate = record.rate - unknowns[places.gyro_bias, None]
    locked = Locked(*motion.locked, rate, motion.sums.impulse[3:], record.lengths_s, *derivatives)
    return add_modes(locked, unknowns[:N_PROPERTIES], unknowns[places.moving], model.modes, model.compute.swing)


def _gained_rate_as_read(
    rate: Array, impulses: ImpulseSums, record: RecordedStretch, unknowns: Array, model: FlightModel
) -> GainedRate:
    """Computes the change of rate over a stretch, measured rates less gyro biases in its coupling terms."""
    rate, held = rate - unknowns[columns(model).gyro_bias, None], wheel_momentum(record, unknowns, model)
    bows = impulse_moments(impulses, rate, held, record.period_s, unknowns)
    if record.momenta.size:  # what turning the wheels' momentum takes, with the bow of the rate
        bent = cross_products((unknowns[:6][ELEMENT] @ bows[0]).T, 0.5 * (held[:, :-1] + held[:, 1:]).T).T
        impulse = impulses.impulse.copy()
        impulse[:3] -= record.period_s * (mean_cross_products(rate, held) + bent)
        impulses = impulses._replace(impulse=impulse)
    return gained_rate(impulses, mean_rates(rate), bows, record.period_s, unknowns)


def wheel_momentum(record: RecordedStretch, unknowns: Array, model: FlightModel) -> Array:
    """Computes the wheels' total angular momentum at the rows, body axes, shape (3, m)."""
    return np.tensordot(1.0 + unknowns[columns(model).wheel], record.momenta, 1)


def mean_cross_products(rate: Array, momentum: Array) -> Array:
    """Computes interval means of w x h, rate and momentum linear within intervals, shape (3, m - 1)."""
    (w0, w1), (h0, h1) = ((each[:, :-1].T, each[:, 1:].T) for each in (rate, momentum))
    return (
        (2.0 * cross_products(w0, h0) + cross_products(w0, h1) + cross_products(w1, h0) + 2.0 * cross_products(w1, h1))
        / 6.0
    ).T


def acting_wrenches(unknowns: Array, thrust: ThrustCourse, model: FlightModel) -> Array:
    """Computes full-thrust wrenches about the vehicle origin of jets that fire in a stretch, shape (6, j)."""
    gains = 1.0 + unknowns[columns(model).thrust][thrust.read.on]
    return (gains[:, None] * mounted_wrenches(unknowns, model)[thrust.read.on]).T


def mounted_wrenches(unknowns: Array, model: FlightModel) -> Array:
    """Computes all jets' full-thrust wrenches about the vehicle origin, mounting errors included, (n_jets, 6)."""
    return displace_wrenches(model.wrenches, unknowns[columns(model).mount], model.mounting)


def engine_impulses(record: RecordedStretch, unknowns: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes angular and linear impulses of engines, (m - 1, 6), and derivatives by errors, (e, m - 1, 6)."""
    errors, rows, lengths = unknowns[columns(model).engine], record.stretch.time_s.size - 1, record.lengths_s[:, None]
    impulse, by_errors = np.zeros((rows, 6)), np.zeros((errors.size, rows, 6))
    burns = np.zeros((rows + 1, 0, 3, N_CHANNELS)) if record.stretch.burns is None else record.stretch.burns
    for which in range(burns.shape[1]):
        own, points = slice(N_ERRORS * which, N_ERRORS * (which + 1)), burns[:-1, which].reshape(-1, N_CHANNELS)
        given, by, _, _ = single_engine_impulses(which, points, errors[own], 1.0, model.engines)
        impulse += lengths * given
        by_errors[own] = lengths * by
    return impulse, by_errors


class TurningEffects(NamedTuple):
    """Effects of rotation on accelerometers, and times since the beginning."""

    turn: Array  # see `turning_products`, (3, 3, m)
    rate: Array  # with its initial value, (3, m)
    held: Array  # angular momentum of the wheels, (3, m)
    period_s: Lengths  # of the intervals
    since_s: Array  # (m,)
    later: Array | None  # turn, each interval's part times the propellant that is still to be used
    drawn: Array | None  # what accelerometers show by the center of mass that moves as tanks are emptied, (3, m)


def turning_effects(motion: ExpectedMotion, unknowns: Array, model: FlightModel) -> TurningEffects:
    """Computes the terms by which rotation acts on accelerometer velocities over a stretch."""
    record, rate = motion.course.read, motion.rate
    off = np.where(record.there, record.rate - rate, 0.0).sum(axis=1, keepdims=True) / record.there.sum(
        axis=1, keepdims=True
    )
    whole = rate + off - unknowns[columns(model).gyro_bias, None]
    held = wheel_momentum(record, unknowns, model)
    bowed = unknowns[:6][ELEMENT] @ impulse_moments(motion.sums, whole, held, record.period_s, unknowns)
    since_s = record.stretch.time_s - record.stretch.time_s[0]
    turn = turning_products(whole, mean_rates(whole), bowed, record.period_s)
    later = None if motion.by_shift is None else cumulative_sums(np.diff(turn) * record.to_use)
    shifts = record.shifts[CENTER]
    drawn = None if record.through is None else cumulative_sums(np.einsum("icm,cm->im", np.diff(turn), shifts))
    return TurningEffects(turn, whole, held, record.period_s, since_s, later, drawn)


def solve_own_coupling(motion: ExpectedMotion, unknowns: Array, model: FlightModel) -> ExpectedMotion:
    """Recomputes expected motion with its own rates, not measured ones, in coupling; unchanged if these diverge.

    With properties so wrong that these rates run away from the readings it is that of the readings, as given.
    """
    first, by_readings = motion.course.read, motion
    farthest = _STRAYED * np.abs(first.rate).max()
    bias, rates, ones = unknowns[columns(model).gyro_bias, None], first.rate, np.eye(3)[:, :, None]
    counts, lengths_s = first.there.sum(axis=1), np.broadcast_to(first.period_s, rates.shape[1] - 1)
    held = wheel_momentum(first, unknowns, model)
    for _ in range(_ROUNDS):  # Newton's
        gained = motion.rate
        straight = (gained - gained[:, :1]) - (rates - rates[:, :1])
        start = np.repeat(ones, rates.shape[1], axis=2)
        both = add_rate_coupling(
            np.concatenate((straight[:, None], start), axis=1), rates - bias, held, lengths_s, unknowns
        )
        alone, by_start = both[:, 0], both[:, 1:]
        mean = np.where(first.there, first.rate - rates - alone, 0.0).sum(axis=1) / counts
        by_mean = np.where(first.there[:, None], by_start, 0.0).sum(axis=2) / counts[:, None]
        if not np.abs(by_start).max() * _DIGITS < 1.0 / np.finfo(float).eps:
            return by_readings
        step = alone + np.einsum("ijm,j->im", by_start, np.linalg.solve(by_mean, mean))
        rates = rates + step
        if not np.abs(rates).max() <= farthest:
            return by_readings
        record = first._replace(rate=rates, there=np.ones_like(first.there))
        motion = expected_motion(unknowns, motion.course._replace(read=record), model)
        if np.abs(step).max() <= _SMALL * np.abs(rates).max():
            break
    return motion
