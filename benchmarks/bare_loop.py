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
from massprop_drake.maths.estimation import impulses
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detectors import cglr as detection
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassState, Rotation
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.rotation_filter import RotationState
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
    attitude = reference = np.array([1.0, 0, 0, 0])
    holding = np.ones(3)
    memory = phase_space.TranslationMemory(np.zeros(3), np.zeros(3), 0.0, 0.0)
    delivered = np.zeros(3)
    remaining, refused = np.zeros(n), np.zeros(4)
    # estimators
    rotation, mass = params.rotation_params(scenario), params.mass_params(scenario)
    start, prior = params.initial_estimate(scenario), params.initial_covariance(scenario)
    x = RotationState(start[:9], prior[:9, :9])
    inverse_mass = MassState(float(start[9]), float(prior[9, 9]), empty_window(mass.jump_window))
    impulse_per_level = vehicle.wrenches * period
    factors = lag_factors(params.estimator_time_constants(scenario), period)
    level, u, u_before = np.zeros(n), np.zeros(n), np.zeros(n)
    hybrid, jumps = False, 0
    detector = None if scenario.detector.kind == "off" else params.detector_params(scenario)
    suspicion, limits = detection.initial_state(n), params.convergence_limits(scenario)
    rate_reading = velocity_reading = None
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
        if k > 0:
            imp = impulses.interval_impulses(u, u_before, level, impulse_per_level, factors)
            level = imp.level
            turning = rotation_filter.measure(
                x,
                rate_reading[None],
                hybrid,
                w[None],
                None,
                imp.angular_impulse,
                imp.linear_impulse,
                imp.firing,
                rotation,
            )
            sample = turning.sample
            motion = Rotation(sample.increment, sample.rate, sample.gyro_variance, x.estimate[6:], x.covariance[6:, 6:])
            moving = mass_filter.measure(
                inverse_mass, velocity_reading[None], v[None], None, motion, imp.linear_impulse, mass
            )
            adaptation = NO_ADAPTATION
            if detector is not None:
                judged = detection.judged(
                    suspicion,
                    t,
                    u,
                    imp.usable,
                    imp.firing,
                    moving.innovation.innovation,
                    turning.innovation.innovation,
                    moving.innovation.covariance,
                    turning.innovation.covariance,
                    x.estimate,
                    x.covariance,
                    np.array(inverse_mass[:2]),
                    limits,
                    detector,
                )
                suspicion, adaptation = judged.state, judged.adaptation
            turned = rotation_filter.finish(x, turning, imp.usable and imp.firing, adaptation, rotation)
            weighed = mass_filter.finish(inverse_mass, moving, imp.usable, imp.firing, adaptation, mass)
            x, inverse_mass, hybrid = turned.state, weighed.state, turning.innovation.subtract_coupling
            jumps += turned.jumped
            if turned.used:
                nis_r.append((t, turning.innovation.nis))
                nis_t.append((t, moving.innovation.nis))
        estimator_s.append(time.perf_counter() - began)
        # autopilot
        rhc, thc = np.zeros(3), np.zeros(3)
        for window in scenario.maneuver:
            if window.start_s <= t < window.end_s:
                (rhc if window.controller == "rhc" else thc)["xyz".index(window.axis[1])] = float(window.axis[0] + "1")
        step = phase_space.attitude_step(
            attitude, reference, holding, rate_reading if k else w, w, rhc, period if k else 0.0, control.capture_rate
        )
        attitude, reference, holding = step.attitude, step.reference, step.holding
        request, memory = phase_space.phase_space_request(rhc, thc, step.error, w, delivered, memory, period, control)
        change = np.abs(request.rate_change - refused[:3]).max()
        idle = not remaining.any() and change >= refused[3]
        if request.urgency == phase_space.Urgency.AT_ONCE or (request.urgency == phase_space.Urgency.WHEN_IDLE and idle):
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
        u_before, u = u, np.where(remaining > 0, 1.0, 0.0)
        remaining = np.maximum(remaining - 1.0, 0.0)
        delivered = activity[3:] @ u * period
        rates.append(w_true)
        velocities.append(state[rigid_body.VELOCITY])
        commands.append(u)
        rate_reading, velocity_reading = w, v
        # vehicle
        transient = np.array([(thrust_level - u) @ c for c in classes]).reshape(len(classes), 7)
        state = rigid_body.step(state, u @ wrenches, transient, constants, period, body)
        thrust_level = level_after(thrust_level, u, plant_factors.remaining)

    return BareRun(
        np.append(x.estimate, inverse_mass.mass_reciprocal),
        np.sqrt(np.append(np.diag(x.covariance), inverse_mass.variance)),
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
