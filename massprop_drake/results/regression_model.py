"""Model of a scenario's vehicle for the batch regression, and the names in its words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.filter import Setup
from massprop_drake.maths.estimation.filters.joint import undithered_quanta
from massprop_drake.maths.estimation.joint.burns import Burn, engine_impulse
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE
from massprop_drake.maths.estimation.joint.process_noise import propellant_drift
from massprop_drake.maths.estimation.offline import flight_model, record_kernels
from massprop_drake.maths.estimation.offline.flight_model import FlightModel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS
from massprop_drake.maths.vehicle.mounting import EXACT

_DRIFTED = 0.01  # of the mass, used: inertia and center of mass then have a walk's 1-sigma, of one that is stated by it
_GATHERS_S = 60.0  # seconds: noise that gathers to less than a reading's 1-sigma by then is left out
_PRIOR = 0.3  # of the widest start: nothing known of a vehicle is more wrong
_OPEN_LAG_S = 0.05  # 1-sigma of a lag that the filters do not reckon with


class Names(NamedTuple):
    """Names of jets, sensors and units in words."""

    jets: Sequence[str]
    kinds: Sequence[str]
    gyros: Sequence[str]
    accelerometers: Sequence[str]
    torque: str
    acceleration: str
    wheels: Sequence[str] = ()
    engines: Sequence[str] = ()
    length: str = ""


def vehicle_names(scenario: Scenario) -> Names:
    """Returns the names of jets, sensors and units of a scenario's vehicle."""
    vehicle = scenario.vehicle_data
    units = vehicle.unit_names
    return Names(
        vehicle.designations,
        list(vehicle.jet_kinds),
        [package.name for package in params.gyros(scenario)],
        [package.name for package in params.accelerometers(scenario)],
        f"{units['length']}-{units['force']}",
        f"{units['length']}/s^2",
        [wheel.name for wheel in vehicle.wheels],
        [engine.name for engine in vehicle.engines],
        units["length"],
    )


def make_model(scenario: Scenario) -> FlightModel:
    """Makes the flight model of the batch regression, with prior and 1-sigma, from a scenario's filter settings."""
    setup, vehicle = params.filter_setup(scenario), scenario.vehicle_data
    thrust, gyros, accelerometers = setup.thrust, setup.gyros, setup.accelerometers
    joint = scenario.estimation.filter == "joint"
    n_jets, n_kinds, n_accelerometers = len(vehicle.jets), thrust.lag_uncertainty.shape[0], accelerometers.quanta.size
    mounting = thrust.mounting if joint else EXACT
    counts_of_others = setup.engine_sigmas.size, mounting.jets.size, setup.modes.sigmas.size, 2 * len(vehicle.tanks), 9
    n_others = 12 + 3 * gyros.quanta.size + 6 * n_accelerometers + len(vehicle.wheels) + sum(counts_of_others)
    of_kinds = np.array([thrust.time_constants_s[thrust.kinds == kind].max(initial=0.0) for kind in range(n_kinds)])
    if joint:
        block = scenario.joint
        of_thrust = thrust.uncertainty if block.thrust_uncertainty is None else block.thrust_uncertainty
        of_lag = of_kinds * (thrust.lag_uncertainty if block.lag_uncertainty is None else block.lag_uncertainty)
    else:
        of_thrust = scenario.estimation.thrust_uncertainty
        gated = scenario.estimation.thrust_transient == "gate"
        of_lag = np.full(n_kinds, _OPEN_LAG_S) if gated else of_kinds * thrust.lag_uncertainty
    prior = np.concatenate((setup.nominal, np.zeros(n_jets + n_kinds + n_others)))
    sigma = np.zeros_like(prior)
    momentum_std = setup.wheels.inertias * setup.wheels.speed_std  # moves the rate that is compared with a gyro's
    rate_variances = (momentum_std * (np.linalg.inv(vehicle.nominal.inertia) @ setup.wheels.axes.T)) ** 2
    of_wheels = float(rate_variances.sum(axis=1).max())
    variances = np.concatenate((setup.gyro_variances + of_wheels, setup.accelerometer_variances))
    model = FlightModel(
        period_s=setup.period_s,
        wrenches=thrust.wrenches,
        flows=thrust.flows,
        time_constants_s=thrust.time_constants_s,
        kinds=thrust.kinds,
        positions=setup.accelerometer_positions,
        variances=variances,
        quanta=np.concatenate((undithered_quanta(gyros), undithered_quanta(accelerometers))),
        gyros=gyros.quanta.size,
        prior=prior,
        sigma=sigma,
        compute=record_kernels.choose_kernels(compiled=scenario.execution.compiled),
        at_stamps=(scenario.joint.switching == "stamps" or params.steps_by_readings(scenario)) if joint else None,
        walks=_random_walks(scenario, setup) if joint else (0.0, 0.0),
        disturbance=setup.disturbance if joint else NO_DISTURBANCE,
        wheels=setup.wheels,
        engines=setup.engines,
        own_times=params.steps_by_readings(scenario),
        tanks=setup.tanks,
        mounting=mounting,
        modes=setup.modes,
    )
    places = flight_model.columns(model)
    sigma[places.properties] = _PRIOR * setup.widest
    sigma[places.thrust] = of_thrust
    sigma[places.lag] = of_lag
    sigma[places.gyro_bias] = gyros.bias_std.max(initial=0.0)
    sigma[places.acceleration_bias] = np.repeat(accelerometers.bias_std, 3)
    sigma[places.wheel] = setup.wheel_uncertainty
    sigma[places.engine] = setup.engine_sigmas
    sigma[places.mount] = 1.0
    sigma[places.moving] = (setup.modes.sigmas > 0.0).astype(np.float64).ravel()
    sigma[places.fill], sigma[places.flow] = setup.tanks.fill_sigma, setup.tanks.flow_sigma
    fed = setup.tanks.feeds.sum(axis=0)  # of each jet 1 or 0
    if (thrust.flows * (1.0 - fed)).any():  # one way, by as much as what drifts has become once so much has been used
        share = setup.nominal[9] / _DRIFTED
        sigma[places.shift] = np.sqrt(propellant_variances(scenario, setup.nominal)[:9] * share)
    return model


def _random_walks(scenario: Scenario, setup: Setup) -> tuple[float, float]:
    """Computes random walks of rate and velocity, 1-sigma after 1 s: stated ones, and engine reading errors.

    A flight with engines may drift by this much all through, though it does so only while they burn.
    """
    full_burn = np.zeros((setup.engines.thrusts.size, 3, N_CHANNELS))
    full_burn[:, :, 0] = 1.0
    full = engine_impulse(
        Burn(full_burn, setup.engines.read_std), np.zeros(setup.engine_sigmas.size), setup.period_s, setup.engines
    )
    walks = motion_sigma(full.noise, scenario.vehicle_data.nominal) / math.sqrt(setup.period_s)
    least = (setup.gyro_variances, setup.accelerometer_variances)
    for index, variances in enumerate(least):
        if walks[index] * math.sqrt(_GATHERS_S) < math.sqrt(variances.min(initial=math.inf)):
            walks[index] = 0.0
    rate, velocity = np.hypot((scenario.joint.rate_walk, scenario.joint.velocity_walk), walks).tolist()
    return rate, velocity


def motion_sigma(impulses: Array, body: MassProperties) -> Array:
    """Computes 1-sigma of a body's rate and velocity changes by independent impulses, largest axis, shape (2,).

    Args:
        impulses: about the vehicle origin, angular and linear, 1-sigma, shape (k, 6).
        body: its mass properties.
    """
    moments = impulses[:, :3] + np.cross(impulses[:, 3:], body.center_of_mass)
    rates = np.linalg.solve(np.asarray(body.inertia), moments.T).T
    return np.array([math.sqrt((each**2).sum(axis=0).max()) for each in (rates, impulses[:, 3:] / body.mass)])


def without_shifts(model: FlightModel) -> FlightModel:
    """Returns the model with the systematic change of center of mass and inertia per propellant fixed to zero."""
    sigma = model.sigma.copy()
    sigma[flight_model.columns(model).shift] = 0.0
    return model._replace(sigma=sigma)


def propellant_variances(scenario: Scenario, parameters: Array) -> Array:
    """Computes the ten parameters' variances per unit of propellant, (10,); 0 unless the filter adds them."""
    joint, vehicle = scenario.joint, scenario.vehicle_data
    fed = any(vehicle.jets_of(tank).any() for tank in vehicle.tanks)
    if scenario.estimation.filter != "joint" or (fed and vehicle.tank_geometry.feeds.sum(axis=0).all()):
        return np.zeros(10)
    fraction = vehicle.tank_fraction if joint.tank_fraction is None else joint.tank_fraction
    return propellant_drift(parameters, 1.0, fraction, vehicle.rms_arm)
