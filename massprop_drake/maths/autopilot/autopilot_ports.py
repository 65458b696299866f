"""Kernels of the autopilot's systems: from vectors of their ports and states to such vectors.

Each is called by one system of a diagram, with what does not change in a `kernels.Holder`. They pack and unpack; what
they do with it stands in the other files here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.autopilot.jet_selection import delivered_velocity, must_select
from massprop_drake.maths.autopilot.phase_space import (
    AttitudeMemory,
    PhaseSpaceParams,
    Request,
    Sensed,
    TranslationMemory,
    attitude_step,
    phase_space_request,
)
from massprop_drake.maths.autopilot.pulses import Pulses, coming_pulse, remaining_after_pulse
from massprop_drake.maths.kernels import fill, kernel, read_bundle
from massprop_drake.maths.linear_algebra import Array, has_nonzero

HAND_CONTROLLERS = Layout("hand_controllers", rotation=3, translation=3)
ATTITUDE_MEMORY = Layout("attitude_memory", attitude=4, reference=4, holding=3, rate=3)
TRANSLATION_MEMORY = Layout(
    "translation_memory", command=3, velocity_left=3, horizon_left_s=NUMBER, since_selection_s=NUMBER
)
REQUEST = Layout("request", rate_change=3, velocity_change=3, time_limit_s=NUMBER, urgency=NUMBER)
RECONFIGURATION = Layout("reconfiguration", declared=FLAG, known_wrench=6, removed="jets")
_ROTATION, _TRANSLATION = HAND_CONTROLLERS.slice("rotation"), HAND_CONTROLLERS.slice("translation")
_REQUEST = REQUEST.size
_DECLARED = RECONFIGURATION.sized(jets=0).slice("declared").start
_KNOWN_WRENCH = RECONFIGURATION.sized(jets=0).slice("known_wrench")


class Reference(NamedTuple):
    """Parameters of the attitude reference.

    Attributes:
        period_s: sample period, s.
        capture_rate: see `PhaseSpaceParams`.
        memory: before the first sample.
    """

    period_s: float
    capture_rate: float
    memory: AttitudeMemory


@kernel
def attitude(memory: Array, rate: Array, controllers: Array, holder: Any) -> Array:
    """Computes the attitude error, rad, and the attitude memory after a sample, in one vector.

    Args:
        memory: packed as `ATTITUDE_MEMORY`.
        rate: reading of the gyro, rad/s, shape (3,).
        controllers: packed as `HAND_CONTROLLERS`.
        holder: holder of `Reference`.
    """
    given = holder.value
    before = read_bundle(memory, given.memory)
    step = attitude_step(before, rate, controllers[_ROTATION], given.period_s, given.capture_rate)
    row = np.empty(3 + memory.size)
    fill(row, (step.error, step.attitude, step.reference, step.holding, rate))
    return row


class Control(NamedTuple):
    """Parameters of the control law.

    Attributes:
        settings: see `PhaseSpaceParams`.
        memory: before the first sample.
    """

    settings: PhaseSpaceParams
    memory: TranslationMemory


@kernel
def request(memory: Array, controllers: Array, error: Array, rate: Array, delivered: Array, holder: Any) -> Array:
    """Computes the autopilot's request to jet selection, and its memory after a sample, in one vector.

    Args:
        memory: packed as `TRANSLATION_MEMORY`.
        controllers: packed as `HAND_CONTROLLERS`.
        error: of the attitude, rad, shape (3,).
        rate, delivered: see `Sensed`.
        holder: holder of `Control`.
    """
    given = holder.value
    sensed = Sensed(controllers[_ROTATION], controllers[_TRANSLATION], error, rate, delivered)
    asked, after = phase_space_request(sensed, read_bundle(memory, given.memory), given.settings)
    row = np.empty(_REQUEST + memory.size)
    changes = (asked.rate_change, asked.velocity_change, asked.time_limit_s, float(asked.urgency.value))
    fill(row[:_REQUEST], changes)
    fill(row[_REQUEST:], after)
    return row


class Burning(NamedTuple):
    """Parameters of a burst in progress.

    Attributes:
        forces: of the jets, shape (3, n_jets).
        period_s: control period, s.
        request: any.
        pulses: of the jets.
    """

    forces: Array
    period_s: float
    request: Request
    pulses: Pulses


@kernel
def select_or_fire(
    remaining: Array,
    packed_request: Array,
    refused_request: Array,
    reconfiguration: Array,
    mass_reciprocal: float,
    holder: Any,
) -> Array:
    """Decides on a new jet selection (1, else 0), then computes the burst's sample as `fire_sample`, valid with 0.

    Args:
        remaining, mass_reciprocal, holder: as in `fire_sample`.
        packed_request: packed as `REQUEST`.
        refused_request: see `must_select`.
        reconfiguration: by the detector, packed as `RECONFIGURATION`.
    """
    request_fields, declared = read_bundle(packed_request, holder.value.request), reconfiguration[_DECLARED] != 0.0
    row = np.empty(2 * remaining.size + 4)
    row[0] = must_select(
        remaining, request_fields, refused_request, has_nonzero(reconfiguration[_KNOWN_WRENCH]), declared
    )
    row[1:] = fire_sample(remaining, mass_reciprocal, holder)
    return row


@kernel
def fire_sample(remaining: Array, mass_reciprocal: float, holder: Any) -> Array:
    """Computes a burst's sample, shape (2 n_jets + 3,): cycles left, jet command, and its velocity change.

    Args:
        remaining: cycles that each jet has still to fire, this one included, shape (n_jets,).
        mass_reciprocal: 1/slug or 1/kg.
        holder: holder of `Burning`.
    """
    given = holder.value
    command = coming_pulse(remaining, given.pulses)
    delivered = delivered_velocity(command, given.forces, mass_reciprocal, given.period_s)
    row = np.empty(2 * remaining.size + 3)
    fill(row, (remaining_after_pulse(remaining, command), command, delivered))
    return row
