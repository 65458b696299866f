"""Modes inside the vehicle over an interval, and derivatives by the joint state; equations in `joint.modes`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filters.rate_increments import angular_block
from massprop_drake.maths.estimation.joint.layout import CENTER, INERTIA, MASS, N_PROPERTIES, RATE
from massprop_drake.maths.estimation.joint.modes import (
    DAMPING,
    ERRORS,
    FREQUENCY,
    POSITION,
    SIZE,
    ModeParams,
    Rigid,
    Swing,
    estimated_part_ratios,
    mode_motion,
)
from massprop_drake.maths.kernels import kernel, take_elements
from massprop_drake.maths.linear_algebra import Array, cross, skew
from massprop_drake.maths.mass_properties import ELEMENT

_END, _MIDDLE = 1.0 / 6.0, 4.0 / 6.0  # weights of Simpson's rule


class SwingParams(NamedTuple):
    """Modes, and the places of their states and errors.

    Attributes:
        modes: see `ModeParams`.
        swing: of eta, then eta'.
        moving, n_moving: of the errors of the parts; none where they are not estimated.
        scale: of the common scale s of thrusts; -1: there is none.
        thrust_sigma: what one unit of s is, relative.
    """

    modes: ModeParams
    swing: int
    moving: int
    n_moving: int
    scale: int
    thrust_sigma: float


class Moved(NamedTuple):
    """Changes of w and c over an interval, and their derivatives.

    Attributes:
        rate, velocity: changes, shape (3,) each.
        rate_rows, velocity_rows: derivatives by the state, shape (3, size) each.
    """

    rate: Array
    velocity: Array
    rate_rows: Array
    velocity_rows: Array


class Swung(NamedTuple):
    """Modes after an interval, and their effects on the vehicle in it.

    Attributes:
        after: eta and eta', shape (2 n,).
        rows: derivative of these by the state, shape (2 n, size).
        shaken: their change by what changes w and c besides, shape (2 n, 6).
        given_back: change of w and c by a change that they would have with modes locked, shape (6, 6).
        momenta: angular momentum of the modes at the start and the end, shape (2, 3).
    """

    after: Array
    rows: Array
    shaken: Array
    given_back: Array
    momenta: Array


@kernel
def modes_at_rest(n: int, size: int) -> Swung:
    """Returns modes at rest without excitation: zero state and derivatives, identity effect on the vehicle.

    Args:
        n: elements of eta and eta'.
        size: of the state.
    """
    return Swung(np.zeros(n), np.zeros((n, size)), np.zeros((n, 6)), np.eye(6), np.zeros((2, 3)))


@kernel
def _expected_motion(swing: Swing, start: Array, forcing: Array) -> tuple[Array, Array]:
    """Computes modal displacements and rates at start, middle, end, shape (3, 2 n), and accelerations, (3, n)."""
    n = forcing.shape[0]
    course = np.stack(
        (start, swing.half @ start + swing.half_driven @ forcing, swing.over @ start + swing.driven @ forcing)
    )
    residual = course[:, :n] * swing.stiffness + course[:, n:] * swing.drag + forcing
    return course, -residual @ swing.lightness.T


@kernel
def _force_responses(swing: Swing, modal_forces: Array, duration_s: float) -> Array:
    """Integrates changes of modal displacements and rates by modal forces, Simpson's rule, shape (2 n, k)."""
    n = swing.stiffness.shape[0]
    at_start = swing.over[:, n:].copy() @ (swing.lightness @ modal_forces[0])
    middle = swing.half[:, n:].copy() @ (swing.lightness @ modal_forces[1])
    result = (duration_s * _END) * at_start + (duration_s * _MIDDLE) * middle
    result[n:] += (duration_s * _END) * (swing.lightness @ modal_forces[2])
    return result


@kernel
def _force_derivatives(
    swing: Swing, rigid: Rigid, displacements_accelerations: tuple[Array, Array], scale: float, thrust_sigma: float
) -> Array:
    """Computes derivatives of modal forces by the ten mass parameters and thrust scale, shape (3, n, 11)."""
    _, accelerations = displacements_accelerations
    n = accelerations.shape[1]
    residuals = np.zeros((3, n, N_PROPERTIES + 1))
    given, pushed = accelerations @ swing.turn, accelerations @ swing.push
    for point in range(3):
        turned = rigid.inverse @ given[point]
        residuals[point, :, INERTIA] = scale * (swing.turn @ angular_block(given[point]))
        residuals[point, :, CENTER] = swing.turn @ (rigid.inverse @ skew(pushed[point]))
        for mode in range(n):
            residuals[point, mode, CENTER] -= cross(swing.push[mode], turned)
        residuals[point, :, MASS] = scale * (swing.push @ pushed[point])
        both = rigid.lightness * (swing.push @ pushed[point]) + swing.turn @ turned
        residuals[point, :, N_PROPERTIES] = (-thrust_sigma / scale) * both
    return residuals


@kernel
def _part_error_forces(
    swing: Swing, rigid: Rigid, displacements_accelerations: tuple[Array, Array], part_ratios: Array, modes: ModeParams
) -> Array:
    """Computes derivatives of modal forces by parts' participation, frequency, damping, position, (3, n, 6 n_parts)."""
    along, accelerations = displacements_accelerations
    n = accelerations.shape[1]
    residuals = np.zeros((3, n, part_ratios.size))
    given, pushed = accelerations @ swing.turn, accelerations @ swing.push
    for mode in range(n):
        part = modes.parts[mode]
        own, at = modes.sigmas[part, :POSITION] / part_ratios[part, :POSITION], ERRORS * part
        shifts = slice(at + POSITION, at + ERRORS)
        alike = rigid.lightness * (swing.push @ swing.push[mode]) + swing.turn @ (rigid.inverse @ swing.turn[mode])
        for point in range(3):
            displaced, moving = along[point, mode], along[point, n + mode]
            both = rigid.lightness * (swing.push[mode] @ pushed[point])
            both += swing.turn[mode] @ (rigid.inverse @ given[point])
            residuals[point, mode, at + SIZE] += own[SIZE] * both
            residuals[point, :, at + SIZE] += (own[SIZE] * accelerations[point, mode]) * alike
            by_frequency = 2.0 * swing.stiffness[mode] * displaced + swing.drag[mode] * moving
            residuals[point, mode, at + FREQUENCY] = -own[FREQUENCY] * by_frequency
            residuals[point, mode, at + DAMPING] = -own[DAMPING] * swing.drag[mode] * moving
            pushing = accelerations[point, mode] * swing.push[mode]
            by_shift = -(swing.turn @ (rigid.inverse @ skew(pushing)))
            by_shift[mode] += cross(swing.push[mode], rigid.inverse @ given[point])
            residuals[point, :, shifts] += by_shift * modes.sigmas[part, POSITION:]
    return residuals


@kernel
def _second_order_momentum(state: Array, rate: Array, modes: ModeParams) -> Array:
    """Computes the modes' angular momentum of second order in displacement, shape (3,)."""
    n, result = modes.frequencies.shape[0], np.zeros(3)
    for mode in range(n):
        result += state[mode] * (modes.swelling[mode] @ rate) + (state[mode] * state[n + mode]) * modes.bow_turn[mode]
        for other in range(n):
            result += (state[mode] * state[n + other]) * modes.crossing[other, mode]
    return result


class _Along(NamedTuple):
    """Motion of the modes along an interval.

    Attributes:
        rigid: see `Rigid`.
        swing: see `Swing`.
        factors: see `estimated_part_ratios`.
        begun: eta and eta' at the beginning, shape (2 n,).
        rates: w at the start and the end with the modes locked, shape (2, 3).
        by_rate: I_1 w at the start, shape (n, 3).
        of_others: derivative of what drives each mode by eta and eta' of others, shape (n, 2 n).
        driving: f, shape (n,).
        along: eta and eta' at the start, the middle and the end, shape (3, 2 n).
        accelerations: eta'' then, shape (3, n).
    """

    rigid: Rigid
    swing: Swing
    factors: Array
    begun: Array
    rates: Array
    by_rate: Array
    of_others: Array
    driving: Array
    along: Array
    accelerations: Array


@kernel
def _mode_course(
    mean: Array, locked: Moved, scale_change: tuple[float, Array], duration_s: float, params: SwingParams
) -> _Along:
    """Computes displacements, rates and forces of the modes along an interval, arguments as `swing_modes`."""
    modes, (scale, by_coupling) = params.modes, scale_change
    n = modes.frequencies.shape[0]
    rate, turned = mean[RATE], locked.rate + by_coupling
    rigid = Rigid(scale * take_elements(mean, ELEMENT), scale * mean[MASS], mean[CENTER])
    factors = estimated_part_ratios(mean[params.moving : params.moving + params.n_moving], modes)
    swing = mode_motion(rigid, factors, duration_s, modes)
    begun = mean[params.swing : params.swing + 2 * n]
    driving = (swing.push @ locked.velocity + swing.turn @ turned) / duration_s
    by_rate, of_others = np.zeros((n, 3)), np.zeros((n, 2 * n))
    for mode in range(n):
        by_rate[mode] = modes.swelling[mode] @ rate
        driving[mode] -= 0.5 * (rate @ by_rate[mode])
        of_others[mode, :n] = modes.crossing[mode] @ turned / duration_s
        of_others[mode, n:] = 2.0 * (modes.crossing[mode] @ (rate + 0.5 * turned))
        of_others[mode, mode] += (modes.bow[mode] @ locked.velocity + modes.bow_turn[mode] @ turned) / duration_s
    driving += of_others @ begun
    along, accelerations = _expected_motion(swing, begun, driving)
    rates = np.stack((rate, rate + turned))
    return _Along(rigid, swing, factors, begun, rates, by_rate, of_others, driving, along, accelerations)


@kernel
def _mode_derivatives(motion: _Along, locked: Moved, scale: float, duration_s: float, params: SwingParams) -> Array:
    """Computes derivatives of final modal displacements and rates by the state, shape (2 n, size)."""
    swing, modes = motion.swing, params.modes
    n = modes.frequencies.shape[0]
    own, turned = slice(params.swing, params.swing + 2 * n), motion.rates[1] - motion.rates[0]
    driving_rows = (swing.push @ locked.velocity_rows + swing.turn @ locked.rate_rows) / duration_s
    driving_rows[:, RATE] -= motion.by_rate
    driving_rows[:, own] += motion.of_others
    for mode in range(n):
        around = motion.begun[n:] @ modes.crossing[mode]
        driving_rows[mode] += (motion.begun[:n] @ modes.crossing[mode] / duration_s + around) @ locked.rate_rows
        driving_rows[mode, RATE] += 2.0 * around
        along = modes.bow[mode] @ locked.velocity_rows + modes.bow_turn[mode] @ locked.rate_rows
        driving_rows[mode] += (motion.begun[mode] / duration_s) * along
        driving_rows[mode, CENTER] -= cross(swing.push[mode], turned) / duration_s
        if params.n_moving > 0:
            size, column = _participation_error(mode, motion.factors, params)
            shifts, sigmas = _position_error_columns(mode, params)
            driving_rows[mode, column] += size * motion.driving[mode]
            driving_rows[mode, shifts] += cross(swing.push[mode], turned) / duration_s * sigmas
    rows = swing.driven @ driving_rows
    both = motion.along, motion.accelerations
    answers = _force_responses(
        swing, _force_derivatives(swing, motion.rigid, both, scale, params.thrust_sigma), duration_s
    )
    rows[:, :N_PROPERTIES] += answers[:, :N_PROPERTIES]
    if params.scale >= 0:
        rows[:, params.scale] += answers[:, N_PROPERTIES]
    if params.n_moving > 0:
        of_parts = _part_error_forces(swing, motion.rigid, both, motion.factors, modes)
        rows[:, params.moving : params.moving + params.n_moving] += _force_responses(swing, of_parts, duration_s)
    rows[:, own] += swing.over
    return rows


@kernel
def _participation_error(mode: int, part_ratios: Array, params: SwingParams) -> tuple[float, int]:
    """Returns the relative derivative of a mode's participation by its part's error, and that error's index."""
    part = params.modes.parts[mode]
    return params.modes.sigmas[part, SIZE] / part_ratios[part, SIZE], params.moving + ERRORS * part + SIZE


@kernel
def _position_error_columns(mode: int, params: SwingParams) -> tuple[slice, Array]:
    """Returns the state columns of the position errors of a mode's part, and their units, ft or m, shape (3,)."""
    part = params.modes.parts[mode]
    begin = params.moving + ERRORS * part
    return slice(begin + POSITION, begin + ERRORS), params.modes.sigmas[part, POSITION:]


@kernel
def _vehicle_derivatives(
    motion: _Along, locked: Moved, impulse: Array, rows: Array, scale_time: tuple[float, float], params: SwingParams
) -> tuple[Array, Array]:
    """Computes derivatives of changes of rate and velocity by the state, modes included, shape (3, size)."""
    swing, rigid, (scale, duration_s) = motion.swing, motion.rigid, scale_time
    n = motion.driving.shape[0]
    inverse, middle = rigid.inverse / scale, motion.along[1]
    gained, gained_rows, mean_rows = motion.along[2, n:] - motion.begun[n:], rows[n:].copy(), 0.5 * rows[n:]
    for mode in range(n):
        gained_rows[mode, params.swing + n + mode] -= 1.0
        mean_rows[mode, params.swing + n + mode] += 0.5
    by_turn, by_push = rigid.inverse @ swing.turn.T, rigid.lightness * swing.push.T
    of_momentum = duration_s * (rigid.inverse @ skew(0.5 * (motion.rates[0] + motion.rates[1])) @ swing.turn.T)
    rate_rows = locked.rate_rows - by_turn @ gained_rows - of_momentum @ mean_rows
    velocity_rows = locked.velocity_rows - by_push @ gained_rows
    turn, push = gained @ swing.turn, gained @ swing.push
    rate_rows[:, INERTIA] += angular_block(_off_center_impulse(motion, impulse) - scale * turn)
    rate_rows[:, CENTER] -= rigid.inverse @ skew(push)
    velocity_rows[:, MASS] -= scale * push
    for mode in range(n):
        by_own = inverse @ cross(impulse, rigid.lightness * swing.push[mode])
        rate_rows -= np.outer(rigid.inverse @ (params.modes.swelling[mode] @ motion.rates[1]), rows[mode])
        rate_rows[:, params.swing + mode] += by_own + rigid.inverse @ motion.by_rate[mode]
        rising = motion.along[2, mode] * rows[n + mode] + motion.along[2, n + mode] * rows[mode]
        rising[params.swing + mode] -= motion.begun[n + mode]
        rising[params.swing + n + mode] -= motion.begun[mode]
        rate_rows -= np.outer(rigid.inverse @ params.modes.bow_turn[mode], rising)
        velocity_rows -= np.outer(rigid.lightness * params.modes.bow[mode], rising)
        if params.n_moving > 0:
            size, column = _participation_error(mode, motion.factors, params)
            rate_rows[:, column] += size * (middle[mode] * by_own - gained[mode] * by_turn[:, mode])
            velocity_rows[:, column] -= (size * gained[mode]) * by_push[:, mode]
            shifts, sigmas = _position_error_columns(mode, params)
            rate_rows[:, shifts] += (rigid.inverse @ skew(gained[mode] * swing.push[mode])) * sigmas
    if params.scale >= 0:
        rate_rows[:, params.scale] += params.thrust_sigma * (inverse @ turn)
        velocity_rows[:, params.scale] += (params.thrust_sigma * rigid.lightness / scale) * push
    return rate_rows, velocity_rows


@kernel
def _off_center_impulse(motion: _Along, impulse: Array) -> Array:
    """Computes the angular impulse of thrust by center-of-mass displacement of the modes, shape (3,)."""
    n = motion.driving.shape[0]
    return cross(impulse, motion.rigid.lightness * (motion.along[1, :n] @ motion.swing.push))


@kernel
def swing_modes(
    mean: Array,
    locked: Moved,
    impulse: Array,
    scale_change: tuple[float, Array],
    duration_s: float,
    params: SwingParams,
) -> tuple[Moved, Swung]:
    """Advances modes (sloshing, panels) over an interval; returns vehicle's changes of rate, velocity, and modes.

    Args:
        mean: before it, shape (size,).
        locked: changes with the modes locked.
        impulse: linear, shape (3,).
        scale_change: 1 - sigma_T s, and change of the rate by dynamic coupling alone, shape (3,).
    """
    motion, scale, modes = _mode_course(mean, locked, scale_change, duration_s, params), scale_change[0], params.modes
    swing, rigid, begun, after = motion.swing, motion.rigid, motion.begun, motion.along[2].copy()
    n = modes.frequencies.shape[0]
    rows = _mode_derivatives(motion, locked, scale, duration_s, params)
    rate_rows, velocity_rows = _vehicle_derivatives(motion, locked, impulse, rows, (scale, duration_s), params)
    by_turn, by_push, gained = rigid.inverse @ swing.turn.T, rigid.lightness * swing.push.T, after[n:] - begun[n:]
    start, end = motion.rates[0], motion.rates[1]
    middle = 0.5 * (start + end)
    own = np.stack((_second_order_momentum(begun, start, modes), _second_order_momentum(after, end, modes)))
    change = locked.rate - by_turn @ gained - rigid.inverse @ (own[1] - own[0])
    change += rigid.inverse @ _off_center_impulse(motion, impulse) / scale
    momenta = (np.stack((begun[n:] @ swing.turn, after[n:] @ swing.turn)) + own) * scale
    before, later = begun[:n] @ by_push.T, after[:n] @ by_push.T
    rising = (after[:n] * after[n:] - begun[:n] * begun[n:]) @ modes.bow
    carried = rigid.lightness * rising + cross(end, later) - cross(start, before) + cross(middle, later - before)
    answers = swing.driven @ np.hstack((swing.turn, swing.push)) / duration_s
    given_back = np.eye(6)
    given_back[:3] -= by_turn @ answers[n:].copy()
    given_back[3:] -= by_push @ answers[n:].copy()
    shaken = answers @ np.linalg.inv(given_back)
    felt = Moved(change, locked.velocity - by_push @ gained - carried, rate_rows, velocity_rows)
    return felt, Swung(after, rows, shaken, given_back, momenta)
