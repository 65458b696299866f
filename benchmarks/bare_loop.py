"""The sample maneuver's closed loop without Drake: the same functions in one plain loop.

The floor against which the cost of the framework is measured, and an independent wiring of the same
mathematics: the diagram must give the same numbers.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.autopilot import jet_selection, phase_space
from massprop_drake.maths.autopilot.phase_space import AttitudeMemory, Sensed, TranslationMemory, Urgency
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.noise import uniform_phase
from massprop_drake.maths.vehicle import rigid_body, sensing
from massprop_drake.maths.vehicle.thrust import lag_factors, level_after
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram

Array = NDArray[np.float64]


class BareRun(NamedTuple):
    """What the loop leaves behind."""

    estimate: Array
    standard_deviation: Array
    rotation_nis: Array  # time, NIS per used sample
    translation_nis: Array
    rates: Array
    velocity: Array
    commands: Array
    mass: float
    jumps: int
    solve_s: float
    estimator_s: Array


def fly(scenario: Scenario) -> BareRun:  # noqa: PLR0915 (one plain loop is its point)
    """Flies a scenario with hand controllers, nominal activity vectors, thrust as known, nothing failing.

    Sensors are quantized only, and one package of each kind is read.
    """
    vehicle = scenario.vehicle_data
    period = vehicle.sample_period_s
    n = len(vehicle.jets)
    cycles = params.sample_count(scenario)
    # vehicle
    truth = vehicle.nominal
    body = rigid_body.body_of(truth)
    state = rigid_body.initial_state(truth.mass)
    wrenches = np.column_stack([vehicle.wrenches, vehicle.mass_flows if scenario.plant.depletion else np.zeros(n)])
    plant_lag = params.plant_time_constants(scenario)
    constants = tuple(sorted(set(plant_lag[plant_lag > 0.0].tolist())))
    classes = [(plant_lag == c)[:, None] * wrenches for c in constants]
    plant_factors = lag_factors(plant_lag, period)
    thrust_level = np.zeros(n)
    # sensors
    gyro, accelerometer = params.gyro(scenario), params.accelerometers(scenario)[0]
    seeded = scenario.sensors.quantizer_phase == "seeded"
    gyro_phase = uniform_phase(scenario.seed, gyro.name, 3) if seeded else np.zeros(3)
    acc_phase = uniform_phase(scenario.seed, accelerometer.name, 3) if seeded else np.zeros(3)
    acc_position = np.array(accelerometer.position)
    # autopilot
    control = params.phase_space_params(scenario)
    program = JetSelectionProgram(vehicle.mass_flows)
    activity = jet_selection.activity_vectors(vehicle.wrenches, truth.vector())
    selectable = params.selectable(scenario)
    upright = np.array([1.0, 0, 0, 0])
    pointing = AttitudeMemory(upright, upright, np.ones(3), np.full(3, np.nan))
    memory = TranslationMemory(np.zeros(3), np.zeros(3), 0.0, 0.0)
    delivered = np.zeros(3)
    remaining, refused = np.zeros(n), np.zeros(4)
    # estimators
    estimation = params.estimation_params(scenario)
    known, jumps = cycle.initial_state(estimation), 0
    missing = [np.full((len(found(scenario)) - 1, 3), np.nan) for found in (params.gyros, params.accelerometers)]
    u = np.zeros(n)
    rates, velocities, commands, nis_r, nis_t = [], [], [], [], []
    solve_s, estimator_s = 0.0, []

    for k in range(cycles + 1):
        t = k * period
        w_true = state[rigid_body.RATE]
        w = sensing.quantized(w_true, gyro.quantum, gyro_phase)
        v = sensing.quantized(
            sensing.point_velocity(
                state[rigid_body.ORIGIN_VELOCITY], w_true, state[rigid_body.SPIN_INTEGRAL], acc_position
            ),
            accelerometer.quantum,
            acc_phase,
        )
        began = time.perf_counter()
        sample = cycle.Sample(t, np.vstack([w, missing[0]]), np.vstack([v, missing[1]]), u)
        done = cycle.step(known, sample, estimation)
        known, filtered = done.state, done.filtered
        jumps += filtered.rotation.rotation_jump
        if filtered.rotation.rotation_used:
            nis_r.append((t, filtered.rotation.rotation_nis))
            nis_t.append((t, filtered.mass.mass_nis))
        estimator_s.append(time.perf_counter() - began)
        # autopilot
        rhc, thc = np.zeros(3), np.zeros(3)
        for window in scenario.maneuver:
            if window.start_s <= t < window.end_s:
                (rhc if window.controller == "rhc" else thc)["xyz".index(window.axis[1])] = float(window.axis[0] + "1")
        step = phase_space.attitude_step(pointing, w, rhc, period, control.capture_rate)
        pointing = AttitudeMemory(step.attitude, step.reference, step.holding, w)
        sensed = Sensed(rhc, thc, step.error, w, delivered)
        request, memory = phase_space.phase_space_request(sensed, memory, control)
        change = np.abs(request.rate_change - refused[:3]).max()
        idle = not remaining.any() and change >= refused[3]
        if request.urgency == Urgency.AT_ONCE or (request.urgency == Urgency.WHEN_IDLE and idle):
            wanted = np.concatenate([request.rate_change, request.velocity_change])
            began = time.perf_counter()
            selection = program.solve(
                activity,
                wanted,
                np.where(selectable, request.time_limit_s, 0.0),
            )
            solve_s += time.perf_counter() - began
            remaining = jet_selection.burst_cycles(selection.on_times_s, period, vehicle.minimum_on_times_s)
            refused = np.zeros(4)
            if not remaining.any():
                refused = np.append(wanted[:3], jet_selection.least_change(wanted, selection.on_times_s, period))
        u = np.where(remaining > 0, 1.0, 0.0)
        remaining = np.maximum(remaining - 1.0, 0.0)
        delivered = activity[3:] @ u * period
        rates.append(w_true)
        velocities.append(state[rigid_body.VELOCITY])
        commands.append(u)
        # vehicle
        transient = np.array([(thrust_level - u) @ c for c in classes]).reshape(len(classes), 7)
        state = rigid_body.step(state, u @ wrenches, transient, constants, period, body)
        thrust_level = level_after(thrust_level, u, plant_factors.remaining)

    return BareRun(
        estimation.filter.predicted(known.filter),
        np.sqrt(estimation.filter.covariance(known.filter).diagonal()),
        np.array(nis_r),
        np.array(nis_t),
        np.array(rates),
        np.array(velocities),
        np.array(commands),
        float(state[rigid_body.MASS]),
        jumps,
        solve_s,
        np.array(estimator_s),
    )
