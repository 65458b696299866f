"""Flight of the vehicle and its autopilot from sample to sample as one kernel; estimation comes in between.

Of a sample come its readings, then the estimators, see `estimation.whole` and `estimation.cycle`, then the autopilot,
jet selection, which is a linear program that Python solves, and the jets and the body up to the next sample. `fly` goes
from the autopilot to the next readings, and stops on the way where Python has to do something; `fly_and_estimate` has
the cycles of the thesis's filters in between, and goes on from sample to sample until then. What they keep is in
holders; what Python reads and writes is in arrays that both have, see `Desk` and `FlightRows`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.autopilot.jet_selection import delivered_velocity, must_select
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, PilotMemory, initial_memory, run_autopilot
from massprop_drake.maths.autopilot.pulses import Pulses, coming_pulse, pulse_onsets, remaining_after_pulse
from massprop_drake.maths.estimation import whole
from massprop_drake.maths.estimation.whole import ThesisAsked
from massprop_drake.maths.kernels import fill, kernel
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL, is_converged
from massprop_drake.maths.vehicle import vehicle_cycle
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.maths.vehicle.rigid_body import N_STATE, STRUCTURE
from massprop_drake.maths.vehicle.sensing import mask_saturated
from massprop_drake.maths.vehicle.vehicle_cycle import Ahead, Truth, VehicleState

ROW, PHASE, SAMPLE, UNTIL = range(4)  # of what is reached; the row at whose readings to stop
SENSING, PILOTING, JUMPING, STEPPING = range(4)  # phases: what comes next
ON, SELECT, JUMP = range(3)  # why `fly` stops: at the next readings, to select jets, or for a jump of mass properties


class PilotParams(NamedTuple):
    """Parameters of the autopilot.

    Attributes:
        settings: of the phase-space controller.
        forces: of the jets, lbf or N, shape (3, n_jets).
        unit_wrenches: torque about the vehicle origin and force of a unit force along each jet, shape (n_jets, 6).
        mass_reciprocal: nominal.
        adapts: whether estimates are in use once they have converged.
        limits: see `mass_properties.is_converged`, shape (3,).
        pulses: of the jets.
    """

    settings: PhaseSpaceParams
    forces: Array
    unit_wrenches: Array
    mass_reciprocal: float
    adapts: bool
    limits: Array
    pulses: Pulses


class FlightParams(NamedTuple):
    """Constants of a flight.

    Attributes:
        truth: the vehicle.
        pilot: the autopilot; of no meaning where none flies.
        flies: whether the autopilot commands; else commands are prescribed.
        closes: whether manifolds can be closed.
        gyros, accelerometers: places of the estimators' packages among all, the preferred one first.
    """

    truth: Truth
    pilot: PilotParams
    flies: bool
    closes: bool
    gyros: NDArray[np.int_]
    accelerometers: NDArray[np.int_]


class FlightState(NamedTuple):
    """State of a flight between samples.

    Attributes:
        vehicle: see `VehicleState`.
        pilot: see `PilotMemory`.
        command, onset: of the sample that ends, see `on_times`, shape (n_jets,) each.
        delivered: velocity change that it gives by the autopilot's mass properties, ft/s or m/s, shape (3,).
    """

    vehicle: VehicleState
    pilot: PilotMemory
    command: Array
    onset: Array
    delivered: Array


class FlightRows(NamedTuple):
    """Log rows, one per sample; `hand_controllers`, and `command` where it is prescribed, are given.

    Attributes:
        body_state, structure, command, onset, thrust, hand_controllers, attitude_error, request, selection_counts,
        out_of_use: ports of these names.
        readings: of all packages, shape (n, n_packages, 3).
        rates, velocities: those that the estimators use, NaN where saturated, shape (n, s, 3) each.
        told, told_onset: command and onset of the sample that ends, shape (n, n_jets) each.
    """

    body_state: Array
    structure: Array
    command: Array
    onset: Array
    thrust: Array
    hand_controllers: Array
    attitude_error: Array
    request: Array
    selection_counts: Array
    out_of_use: Array
    readings: Array
    rates: Array
    velocities: Array
    told: Array
    told_onset: Array
    propellant: Array


class Desk(NamedTuple):
    """Data that kernel and Python exchange, written in place.

    Attributes:
        remaining: cycles that each jet has still to fire, shape (n_jets,).
        counts, refused, out_of_use, owed: of jet selection, see `systems.autopilot.selector.SelectionState`.
        wrench: known force of failed jets, torque about the vehicle origin first, shape (6,).
        estimate, deviation: the ten parameters as published, and their 1-sigma, shape (10,) each.
        asked: what the detector asks for.
    """

    remaining: Array
    counts: Array
    refused: Array
    out_of_use: Array
    owed: Array
    wrench: Array
    estimate: Array
    deviation: Array
    asked: ThesisAsked


def empty_desk(n_jets: int, detector_requests: ThesisAsked) -> Desk:
    """Makes the zeroed arrays by which the compiled flight and Python exchange requests and estimates.

    Args:
        detector_requests: what the detector asks for.
    """
    remaining, out_of_use, owed = np.zeros((3, n_jets))
    counts, refused, wrench, estimate, deviation = (np.zeros(size) for size in (4, 4, 6, 10, 10))
    return Desk(remaining, counts, refused, out_of_use, owed, wrench, estimate, deviation, detector_requests)


def empty_rows(count: int, sizes: tuple[int, int], params: FlightParams) -> FlightRows:
    """Allocates the zeroed log arrays of a flight, a row per sample.

    Args:
        sizes: numbers of jets and of packages.
    """
    jets, packages = sizes
    used = (packages, params.gyros.size, params.accelerometers.size)
    readings, rates, velocities = (np.zeros((count, number, 3)) for number in used)
    body, structure = np.zeros((count, N_STATE)), np.zeros((count, STRUCTURE.size))
    command, thrust, out_of_use, told = (np.zeros((count, jets)) for _ in range(4))
    onset, told_onset = (level_onsets((count, jets)) for _ in range(2))
    controllers, error, request, counts = (np.zeros((count, size)) for size in (6, 3, 8, 4))
    of_pilot = (controllers, error, request, counts, out_of_use)
    used_up = np.zeros((count, params.truth.tanks.outlets.shape[0]))
    told_of = told, told_onset, used_up
    return FlightRows(body, structure, command, onset, thrust, *of_pilot, readings, rates, velocities, *told_of)


class FlightBlock(NamedTuple):
    """Rows, the random draws of each, and the desk."""

    rows: FlightRows
    coming: Ahead
    desk: Desk


class Together(NamedTuple):
    """Parameters of the flight and of its estimation."""

    flight: Any
    known: Any


def initial_state(vehicle: VehicleState) -> FlightState:
    """Returns the state of vehicle and autopilot before the first sample."""
    jets = vehicle.level.size
    return FlightState(vehicle, initial_memory(), np.zeros(jets), level_onsets(jets), np.zeros(3))


@kernel
def fly(holder: Any, block: Any, progress: NDArray[np.int_], params: Any) -> int:
    """Simulates until the next readings, or until Python must act; returns `ON`, `SELECT` or `JUMP`.

    Args:
        holder: of `FlightState`.
        block: holder of a `FlightBlock`; it ends with the last row's sample, and the next one's readings are the first
            thing of the next block.
        progress: row, phase and number of the sample, shape (3,) or longer.
        params: holder of `FlightParams`.

    Raises:
        OutOfMassError: when the jets use up the vehicle's mass.
        OutOfPropellantError: when they draw more from a tank than is in it.
        SpunUpError: when the vehicle makes more than a turn in a sample.
    """
    return _fly_unwrapped(holder, block.value, progress, params.value)


@kernel
def _fly_unwrapped(holder: Any, block: FlightBlock, progress: NDArray[np.int_], params: FlightParams) -> int:
    """Simulates as `fly` does, block and parameters taken out of their holders."""
    state = holder.value
    rows, draws, exchange = block.rows, block.coming, block.desk
    row = progress[ROW]
    if progress[PHASE] == PILOTING:
        progress[PHASE] = JUMPING
        if params.flies:
            state, selects = _pilot_sample(state, row, rows, exchange, params)
            if selects:
                holder.value = state
                return SELECT
    if progress[PHASE] == JUMPING:
        progress[PHASE] = STEPPING
        if draws.jumps[row]:
            holder.value = state
            return JUMP
    if progress[PHASE] == STEPPING:
        state = _step_sample(state, (row, progress[SAMPLE]), (rows, draws), exchange, params)
        row += 1
        progress[ROW], progress[PHASE] = row, SENSING
        progress[SAMPLE] += 1
    if row < rows.told.shape[0]:
        state = _sense_sample(state, row, rows, draws, params)
        progress[PHASE] = PILOTING
    holder.value = state
    return ON


@kernel
def fly_and_estimate(holder: Any, estimation_holder: Any, block: Any, progress: NDArray[np.int_], params: Any) -> int:
    """Simulates and estimates sample by sample until a row or until Python must act; returns as `fly`.

    Args:
        holder: of `FlightState`.
        estimation_holder: holder of the state of estimation.
        block: holder of the rows of both, a `FlightBlock` and a `whole.ThesisBlock`, see `Together`.
        progress: row, phase and number of the sample, and the row at whose readings to stop, shape (4,).
        params: holder of `FlightParams` and `whole.WholeParams`.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
        OutOfMassError, OutOfPropellantError, SpunUpError: as `fly`.
    """
    rows, given = block.value, params.value
    while progress[ROW] < progress[UNTIL]:
        if progress[PHASE] == PILOTING:
            estimation_holder.value = whole.run_cycle(estimation_holder.value, rows.known, progress[ROW], given.known)
        stop = _fly_unwrapped(holder, rows.flight, progress, given.flight)
        if stop != ON:
            return stop
    return ON


@kernel
def _sense_sample(state: FlightState, row: int, rows: FlightRows, draws: Ahead, params: FlightParams) -> FlightState:
    """Logs a sample's readings, raw and without saturated ones; returns the state, memories updated."""
    vehicle, truth = state.vehicle, params.truth
    readings, memories = vehicle_cycle.sense(vehicle, row, draws, truth)
    rows.body_state[row] = vehicle.body
    rows.structure[row] = vehicle.structure
    rows.propellant[row] = vehicle.fill
    rows.readings[row] = readings
    rows.told[row], rows.told_onset[row] = state.command, state.onset
    for place in range(params.gyros.size):
        package = params.gyros[place]
        rows.rates[row, place] = mask_saturated(readings[package], truth.packages.limits[package])
    for place in range(params.accelerometers.size):
        package = params.accelerometers[place]
        rows.velocities[row, place] = mask_saturated(readings[package], truth.packages.limits[package])
    after = VehicleState(
        vehicle.body,
        vehicle.structure,
        vehicle.constants,
        vehicle.level,
        vehicle.target,
        vehicle.deviation,
        memories,
        vehicle.fill,
    )
    return FlightState(after, state.pilot, state.command, state.onset, state.delivered)


@kernel
def _pilot_sample(
    state: FlightState, row: int, rows: FlightRows, exchange: Desk, params: FlightParams
) -> tuple[FlightState, bool]:
    """Logs the autopilot's request at a sample; returns the state, and whether jets must be selected."""
    pilot, asked = params.pilot, exchange.asked
    rate = rows.readings[row, params.gyros[0]]
    request, error, memory = run_autopilot(
        state.pilot, rate, rows.hand_controllers[row], state.delivered, pilot.settings
    )
    changes = (request.rate_change, request.velocity_change, request.time_limit_s, float(request.urgency.value))
    fill(rows.request[row], changes)
    rows.attitude_error[row] = error
    rows.selection_counts[row] = exchange.counts
    rows.out_of_use[row] = exchange.out_of_use
    exchange.wrench[:] = 0.0
    if has_nonzero(asked.force):
        exchange.wrench[:] = asked.force @ pilot.unit_wrenches
    declared = asked.declared[0] != 0.0
    if declared:
        exchange.remaining[:] = 0.0
    selects = must_select(exchange.remaining, request, exchange.refused, has_nonzero(exchange.wrench), declared)
    return FlightState(state.vehicle, memory, state.command, state.onset, state.delivered), selects


@kernel
def _step_sample(
    state: FlightState,
    row_and_sample: tuple[int, int],
    rows_and_draws: tuple[FlightRows, Ahead],
    exchange: Desk,
    params: FlightParams,
) -> FlightState:
    """Fires the jets and advances the vehicle to the next sample; logs the sample in its row."""
    row, sample = row_and_sample
    rows, draws = rows_and_draws
    vehicle, pilot, delivered = state.vehicle, params.pilot, state.delivered
    if params.flies:
        command = coming_pulse(exchange.remaining, pilot.pulses)
        rows.command[row] = command
        rows.onset[row] = pulse_onsets(command, pilot.pulses, pilot.settings.period_s)
        reciprocal = pilot.mass_reciprocal
        if pilot.adapts and is_converged(exchange.deviation, exchange.estimate, pilot.limits):
            reciprocal = exchange.estimate[MASS_RECIPROCAL]
        delivered = delivered_velocity(command, pilot.forces, reciprocal, pilot.settings.period_s)
        exchange.remaining[:] = remaining_after_pulse(exchange.remaining, command)
    else:
        command = rows.command[row].copy()
    onset = rows.onset[row].copy()
    closed = exchange.asked.closed if params.closes else np.zeros(command.size)
    after, thrust = vehicle_cycle.step(vehicle, (command, onset, closed), sample, (draws, row), params.truth)
    rows.thrust[row] = thrust
    return FlightState(after, state.pilot, command, onset, delivered)
