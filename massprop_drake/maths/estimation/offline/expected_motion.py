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
    bows_of,
    cumulative_sums,
    gained_rate,
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
    row_places,
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
        """Rate since the beginning, shape (3, m)."""
        return self.gained.rate


def stretch_motion(stretch: Stretch, at: Array, model: FlightModel) -> tuple[ExpectedMotion, Array]:
    """Computes rate and velocity expected over a stretch, and the unknowns at its middle, shape (n,).

    Args:
        stretch: of at least two rows.
        at: all unknowns, shape (n,); the inverse inertia positive definite.
        model: see `FlightModel`.
    """
    course, at = expand_about_middle(thrust_course(prepare_stretch(stretch, model), at, model), at, model)
    return expected_motion(at, course, model), at


def expected_motion(at: Array, course: ThrustCourse, model: FlightModel) -> ExpectedMotion:
    """Computes rate and velocity expected over a stretch; measured rates serve in its coupling terms."""
    places, read = columns(model), course.read
    wrenches, rate, stretch = acting_wrenches(at, course, model), read.rate, read.stretch
    impulse = wrenches @ course.amount.T + stretch.outside[:-1].T * read.lengths_s
    impulse += engine_impulses(read, at, model)[0].T
    middle = 0.5 * (rate[:, :-1] + rate[:, 1:])
    turned = np.tensordot(at[places.momentum], CROSS, 1).T @ middle  # momentum of wheels crossed with the rate
    unknown = at[places.torque, None] - at[places.drag, None] * middle + turned
    impulse[:3] += (read.period_s if model.own_times else model.period_s) * unknown  # pure torques act about any point
    impulse[:3] -= np.diff(wheel_momentum(read, at, model))
    acting = wrenches @ course.level.T if read.late_s.any() else None
    late = None if acting is None else read.late_s * acting
    if model.own_times:
        bow = wrenches @ (course.shape * course.lacking).swapaxes(1, 2)
    else:
        bow = (wrenches * course.shape[:, None]).reshape(18, read.on.size) @ course.lacking.T
        bow = bow.reshape(3, 6, impulse.shape[1])
    if course.bent is not None:
        bow = bow + np.einsum("ij,kmj->kim", wrenches, course.bent)
    sums = ImpulseSums(impulse, bow, late, acting)
    mass = 1.0 / at[MASS] + stretch.used_after
    lightness = 2.0 / (mass[:-1] + mass[1:])
    velocity = cumulative_sums(sums.impulse[3:] * lightness)
    if late is not None:
        velocity += late[3:] / mass
    gained = _gained_rate_as_read(rate, sums, read, at, model)
    if not read.there.all():  # jets fire in between: what they give is no straight line, what is left over is
        left = interpolate_missing(rate - gained.rate, read.there, row_places(stretch, model))
        gained = _gained_rate_as_read(gained.rate + left, sums, read, at, model)
    by_shift = None
    if model.sigma[places.shift].any():
        later = cumulative_sums(np.diff(gained.sums) * read.to_use)
        by_shift, _ = rate_derivatives(gained._replace(sums=later), read.period_s, at)
        gained = gained._replace(rate=gained.rate + np.tensordot(at[places.shift], by_shift, 1))
    if read.through is not None:
        moved, _ = rate_derivatives(gained, read.period_s, at)
        shift, turn = read.shifts[CENTER].T, read.shifts[:6][ELEMENT]
        each = np.einsum("eim,em->im", np.diff(moved), read.shifts)
        each += np.einsum("ijm,jm->im", turn, cross_products(sums.impulse[3:].T, shift).T)  # of both at once
        gained = gained._replace(rate=gained.rate + cumulative_sums(each))
    expected = ExpectedMotion(course, sums, lightness, gained, velocity, by_shift, (gained.rate, velocity))
    if model.modes.frequencies.size == 0:
        return expected
    nothing = np.zeros((0, *velocity.shape))
    swings = with_swings(expected, (nothing, nothing), at, model)
    return expected._replace(gained=gained._replace(rate=swings.rate), velocity=swings.velocity)


def with_swings(expected: ExpectedMotion, derivatives: tuple[Array, Array], at: Array, model: FlightModel) -> Swings:
    """Computes rate and velocity over a stretch with its modes free, and derivatives by k unknowns, (k, 3, m)."""
    read, places = expected.course.read, columns(model)
    rate = read.rate - at[places.gyro_bias, None]
    locked = Locked(*expected.locked, rate, expected.sums.impulse[3:], read.lengths_s, *derivatives)
    return add_modes(locked, at[:N_PROPERTIES], at[places.moving], model.modes, model.compute.swing)


def _gained_rate_as_read(
    rate: Array, sums: ImpulseSums, read: RecordedStretch, at: Array, model: FlightModel
) -> GainedRate:
    """Computes the change of rate over a stretch, measured rates less gyro biases in its coupling terms."""
    rate, held = rate - at[columns(model).gyro_bias, None], wheel_momentum(read, at, model)
    bows = bows_of(sums, rate, held, read.period_s, at)
    if read.momenta.size:  # what turning the wheels' momentum takes, with the bow of the rate
        bent = cross_products((at[:6][ELEMENT] @ bows[0]).T, 0.5 * (held[:, :-1] + held[:, 1:]).T).T
        impulse = sums.impulse.copy()
        impulse[:3] -= read.period_s * (mean_cross_products(rate, held) + bent)
        sums = sums._replace(impulse=impulse)
    return gained_rate(sums, mean_rates(rate), bows, read.period_s, at)


def wheel_momentum(read: RecordedStretch, at: Array, model: FlightModel) -> Array:
    """Computes the wheels' total angular momentum at the rows, body axes, shape (3, m)."""
    return np.tensordot(1.0 + at[columns(model).wheel], read.momenta, 1)


def mean_cross_products(rate: Array, momentum: Array) -> Array:
    """Computes interval means of w x h, rate and momentum linear within intervals, shape (3, m - 1)."""
    (w0, w1), (h0, h1) = ((each[:, :-1].T, each[:, 1:].T) for each in (rate, momentum))
    return (
        (2.0 * cross_products(w0, h0) + cross_products(w0, h1) + cross_products(w1, h0) + 2.0 * cross_products(w1, h1))
        / 6.0
    ).T


def acting_wrenches(at: Array, course: ThrustCourse, model: FlightModel) -> Array:
    """Computes full-thrust wrenches about the vehicle origin of jets that fire in a stretch, shape (6, j)."""
    gains = 1.0 + at[columns(model).thrust][course.read.on]
    return (gains[:, None] * mounted_wrenches(at, model)[course.read.on]).T


def mounted_wrenches(at: Array, model: FlightModel) -> Array:
    """Computes full-thrust wrenches of all jets with the mounting errors of a point, shape (n_jets, 6)."""
    return displace_wrenches(model.wrenches, at[columns(model).mount], model.mounting)


def engine_impulses(read: RecordedStretch, at: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes angular and linear impulses of engines, (m - 1, 6), and derivatives by errors, (e, m - 1, 6)."""
    errors, rows, lengths = at[columns(model).engine], read.stretch.time_s.size - 1, read.lengths_s[:, None]
    impulse, by_errors = np.zeros((rows, 6)), np.zeros((errors.size, rows, 6))
    burns = np.zeros((rows + 1, 0, 3, N_CHANNELS)) if read.stretch.burns is None else read.stretch.burns
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


def turning_effects(expected: ExpectedMotion, at: Array, model: FlightModel) -> TurningEffects:
    """Computes the terms by which rotation acts on accelerometer velocities over a stretch."""
    read, rate = expected.course.read, expected.rate
    off = np.where(read.there, read.rate - rate, 0.0).sum(axis=1, keepdims=True) / read.there.sum(axis=1, keepdims=True)
    whole = rate + off - at[columns(model).gyro_bias, None]
    held = wheel_momentum(read, at, model)
    bowed = at[:6][ELEMENT] @ bows_of(expected.sums, whole, held, read.period_s, at)
    since_s = read.stretch.time_s - read.stretch.time_s[0]
    turn = turning_products(whole, mean_rates(whole), bowed, read.period_s)
    later = None if expected.by_shift is None else cumulative_sums(np.diff(turn) * read.to_use)
    shifts = read.shifts[CENTER]
    drawn = None if read.through is None else cumulative_sums(np.einsum("icm,cm->im", np.diff(turn), shifts))
    return TurningEffects(turn, whole, held, read.period_s, since_s, later, drawn)


def with_own_coupling(expected: ExpectedMotion, at: Array, model: FlightModel) -> ExpectedMotion:
    """Solves for the expected motion whose coupling uses its own rates, their mean that of the readings.

    With properties so wrong that these rates run away from the readings it is that of the readings, as given.
    """
    first, by_readings = expected.course.read, expected
    farthest = _STRAYED * np.abs(first.rate).max()
    bias, course, ones = at[columns(model).gyro_bias, None], first.rate, np.eye(3)[:, :, None]
    counts, lengths_s = first.there.sum(axis=1), np.broadcast_to(first.period_s, course.shape[1] - 1)
    held = wheel_momentum(first, at, model)
    for _ in range(_ROUNDS):  # Newton's
        gained = expected.rate
        straight = (gained - gained[:, :1]) - (course - course[:, :1])
        start = np.repeat(ones, course.shape[1], axis=2)
        both = add_rate_coupling(np.concatenate((straight[:, None], start), axis=1), course - bias, held, lengths_s, at)
        alone, by_start = both[:, 0], both[:, 1:]
        mean = np.where(first.there, first.rate - course - alone, 0.0).sum(axis=1) / counts
        by_mean = np.where(first.there[:, None], by_start, 0.0).sum(axis=2) / counts[:, None]
        if not np.abs(by_start).max() * _DIGITS < 1.0 / np.finfo(float).eps:
            return by_readings
        step = alone + np.einsum("ijm,j->im", by_start, np.linalg.solve(by_mean, mean))
        course = course + step
        if not np.abs(course).max() <= farthest:
            return by_readings
        read = first._replace(rate=course, there=np.ones_like(first.there))
        expected = expected_motion(at, expected.course._replace(read=read), model)
        if np.abs(step).max() <= _SMALL * np.abs(course).max():
            break
    return expected
