r"""Phase-space control: rate-change requests from hand controllers, attitude error and rates.

Manual modes of the thesis (section 5.1): in the discrete-rate submode an axis whose rotational hand
controller is out of detent is to turn at a fixed rate, any other holds inertial attitude; in the
acceleration submode a translational hand controller out of detent commands a fixed acceleration, and
the velocity is kept on release. A request is six-dimensional, [dw; dv] (1-2), for one jet selection.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.attitude import (
    conjugate,
    from_rotation_vector,
    multiply,
    propagate_attitude,
    to_rotation_vector,
)
from massprop_drake.maths.kernels import kernel, numbers
from massprop_drake.maths.linear_algebra import Array, has_nonzero


class Urgency(IntEnum):
    """Urgency of a request."""

    NONE = 0
    WHEN_IDLE = 1  # once the running burst has ended
    AT_ONCE = 2  # in place of it


class Window(NamedTuple):
    """A hand controller held out of detent.

    Attributes:
        channel: 0 to 2 rotation about x, y, z; 3 to 5 translation along x, y, z.
        sign: +1 or -1.
        start_s: leaves detent, s.
        end_s: back in detent, s.
    """

    channel: int
    sign: float
    start_s: float
    end_s: float


def hand_controller_rows(windows: tuple[Window, ...], times_s: Array) -> Array:
    """Returns both hand controllers' -1, 0 or 1 per axis at times, rotation first, shape (n, 6)."""
    rows = np.zeros((times_s.size, 6))
    for window in windows:
        rows[(window.start_s <= times_s) & (times_s < window.end_s), window.channel] = window.sign
    return rows


class PhaseSpaceParams(NamedTuple):
    """Gains and limits of the controller; angles in radians.

    Attributes:
        period_s: control period, s.
        discrete_rate: rate commanded by the rotational hand controller, rad/s.
        hold_gain: rate commanded per attitude error in hold, 1/s.
        hold_rate_limit: largest rate commanded in hold, rad/s.
        capture_rate: an axis back in detent holds attitude once its rate is below this, rad/s; until
            then it is only stopped.
        rate_deadband: rate error of any axis that asks for a correction, rad/s.
        acceleration: commanded by the translational hand controller, ft/s^2 or m/s^2.
        horizon_s: a translation is requested for this long at a time, s.
        resolve_rate: in a translation, rate error that asks for a new selection, rad/s.
        resolve_after_s: least time between two selections in a translation, s.
    """

    period_s: float
    discrete_rate: float
    hold_gain: float
    hold_rate_limit: float
    capture_rate: float
    rate_deadband: float
    acceleration: float
    horizon_s: float
    resolve_rate: float
    resolve_after_s: float


class AttitudeStep(NamedTuple):
    """Attitude by the gyro, and the attitude to hold, after one sample.

    Attributes:
        attitude: q_NB by strapdown integration of the measured rate, shape (4,).
        reference: attitude to hold, q_NR, shape (4,).
        error: rotation vector from the reference to the body, rad, body axes, shape (3,).
        holding: 1 for each axis that holds attitude, 0 for one that is free, shape (3,).
    """

    attitude: Array
    reference: Array
    error: Array
    holding: Array


class AttitudeMemory(NamedTuple):
    """Memory of the attitude at the sample before.

    Attributes:
        attitude, reference: quaternions, shape (4,) each.
        holding: axes that held attitude, 0 or 1, shape (3,).
        rate: reading of the gyro, rad/s, NaN before the first, shape (3,).
    """

    attitude: Array
    reference: Array
    holding: Array
    rate: Array


@kernel
def attitude_step(
    memory: AttitudeMemory, rate: Array, rotation_command: Array, period_s: float, capture_rate: float
) -> AttitudeStep:
    """Integrates measured rate to attitude; returns it, its reference and error, and axes that hold attitude.

    Args:
        memory: of the sample before.
        rate: reading that ends the sample, rad/s, shape (3,).
        rotation_command: rotational hand controller, -1, 0 or 1 per axis, shape (3,).
        capture_rate: rate below which an axis in detent starts to hold, rad/s.
    """
    attitude, reference, holding, previous_rate = memory.attitude, memory.reference, memory.holding, memory.rate
    if math.isnan(previous_rate[0]):  # before the first reading no time has passed
        previous_rate, period_s = rate, 0.0
    attitude = propagate_attitude(attitude, 0.5 * (previous_rate + rate), period_s)
    error = to_rotation_vector(multiply(conjugate(reference), attitude))
    x, y, z = numbers(rotation_command, 3)
    held_x, held_y, held_z = numbers(holding, 3)
    rate_x, rate_y, rate_z = numbers(rate, 3)
    keeps_x = _holds_attitude(x, held_x, rate_x, capture_rate)
    keeps_y = _holds_attitude(y, held_y, rate_y, capture_rate)
    keeps_z = _holds_attitude(z, held_z, rate_z, capture_rate)
    now = np.array([keeps_x, keeps_y, keeps_z])
    if keeps_x * keeps_y * keeps_z == 0.0:
        error = error * now
        reference = multiply(attitude, from_rotation_vector(-error))
    return AttitudeStep(attitude, reference, error, now)


@kernel
def _holds_attitude(command: float, was_holding: float, rate: float, capture_rate: float) -> float:
    """Returns 1 where an axis holds attitude (in detent, and holding already or slow enough), else 0."""
    return 1.0 if command == 0.0 and (was_holding != 0.0 or abs(rate) < capture_rate) else 0.0


@kernel
def commanded_rate(rotation_command: Array, attitude_error: Array, params: PhaseSpaceParams) -> Array:
    """Computes commanded rates, rad/s, (3,): the stick's discrete rate, or the return to the held attitude."""
    x, y, z = numbers(rotation_command, 3)
    error_x, error_y, error_z = numbers(attitude_error, 3)
    return np.array(
        [
            _commanded_axis_rate(x, error_x, params),
            _commanded_axis_rate(y, error_y, params),
            _commanded_axis_rate(z, error_z, params),
        ]
    )


@kernel
def _commanded_axis_rate(command: float, error: float, params: PhaseSpaceParams) -> float:
    """Computes one axis's commanded rate, rad/s: the stick's, or that which reduces its attitude error."""
    if command != 0.0:
        return command * params.discrete_rate
    return min(max(-params.hold_gain * error, -params.hold_rate_limit), params.hold_rate_limit)


class Request(NamedTuple):
    """Request of the controller to jet selection.

    Attributes:
        rate_change: dw, rad/s, body axes, shape (3,).
        velocity_change: dv, ft/s or m/s, body axes, shape (3,).
        time_limit_s: longest on-time of a jet, s; infinity where none applies.
        urgency: see `Urgency`.
    """

    rate_change: Array
    velocity_change: Array
    time_limit_s: float
    urgency: Urgency


class TranslationMemory(NamedTuple):
    """Memory of the controller of a translation.

    Attributes:
        command: translational hand controller at the last sample, -1, 0 or 1 per axis, shape (3,).
        velocity_left: part of the velocity change of this horizon still to come, ft/s or m/s,
            shape (3,).
        horizon_left_s: time left of the horizon it was requested for, s.
        since_selection_s: time since the last selection in it, s.
    """

    command: Array
    velocity_left: Array
    horizon_left_s: float
    since_selection_s: float


class Sensed(NamedTuple):
    """Inputs of the controller at a sample.

    Attributes:
        rotation_command, translation_command: hand controllers, -1, 0 or 1 per axis, shape (3,) each.
        attitude_error: rotation vector from the held attitude, rad, shape (3,).
        rate: measured rate, rad/s, shape (3,).
        delivered: velocity change that the jets commanded over the last sample give by the autopilot's
            mass properties, ft/s or m/s, shape (3,).
    """

    rotation_command: Array
    translation_command: Array
    attitude_error: Array
    rate: Array
    delivered: Array


@kernel
def phase_space_request(
    sensed: Sensed, memory: TranslationMemory, params: PhaseSpaceParams
) -> tuple[Request, TranslationMemory]:
    """Computes the request to jet selection at a sample by the phase-space law, and the memory after it.

    Args:
        sensed: at the sample.
        memory: of the sample before.
    """
    translation_command, period_s = sensed.translation_command, params.period_s
    rate_error = commanded_rate(sensed.rotation_command, sensed.attitude_error, params) - sensed.rate
    x, y, z = numbers(np.abs(rate_error), 3)
    largest = max(x, y, z)
    if not has_nonzero(translation_command):
        urgency = Urgency.WHEN_IDLE if largest > params.rate_deadband else Urgency.NONE
        if has_nonzero(memory.command):  # back in detent: what is left of the translation is dropped
            urgency = Urgency.AT_ONCE
        return Request(rate_error, np.zeros(3), np.inf, urgency), TranslationMemory(
            translation_command, np.zeros(3), 0.0, 0.0
        )

    changed = has_nonzero(translation_command - memory.command)
    velocity_left = memory.velocity_left - sensed.delivered
    horizon_left = memory.horizon_left_s - period_s
    since = memory.since_selection_s + period_s
    urgency = Urgency.NONE
    if changed or horizon_left < 0.5 * period_s:
        horizon_left = params.horizon_s
        velocity_left = translation_command * (params.acceleration * horizon_left)
        urgency = Urgency.AT_ONCE
    elif largest > params.resolve_rate and since > params.resolve_after_s - 0.5 * period_s:
        urgency = Urgency.AT_ONCE
    if urgency == Urgency.AT_ONCE:
        since = 0.0
    after = TranslationMemory(translation_command, velocity_left, horizon_left, since)
    return Request(rate_error, velocity_left, horizon_left, urgency), after


class PilotMemory(NamedTuple):
    """Memory of the autopilot between samples."""

    attitude: AttitudeMemory
    translation: TranslationMemory


@kernel
def run_autopilot(
    memory: PilotMemory, rate: Array, controllers: Array, delivered: Array, params: PhaseSpaceParams
) -> tuple[Request, Array, PilotMemory]:
    """Runs the autopilot for a sample; returns request, rotation vector from the held attitude, rad, and memory.

    Args:
        memory: of the sample before.
        rate: reading of the gyro, rad/s, shape (3,).
        controllers: see `hand_controller_rows`, shape (6,).
        delivered: see `Sensed`, shape (3,).
    """
    rotation, translation = controllers[:3], controllers[3:]
    turned = attitude_step(memory.attitude, rate, rotation, params.period_s, params.capture_rate)
    sensed = Sensed(rotation, translation, turned.error, rate, delivered)
    request, moving = phase_space_request(sensed, memory.translation, params)
    attitude = AttitudeMemory(turned.attitude, turned.reference, turned.holding, rate)
    return request, turned.error, PilotMemory(attitude, moving)


def initial_memory() -> PilotMemory:
    """Returns the autopilot's memory before the first reading: at rest, holding attitude."""
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    attitude = AttitudeMemory(upright, upright, np.ones(3), np.full(3, np.nan))
    return PilotMemory(attitude, TranslationMemory(np.zeros(3), np.zeros(3), 0.0, 0.0))
