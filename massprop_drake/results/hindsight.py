"""A run in hindsight: how well it could have shown each parameter, and what its readings contradict, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import hindsight
from massprop_drake.maths.estimation.hindsight import Model, Stretch
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

_ROWS = 1024  # of a stretch
_STRETCHES = 32  # at the most, evenly spread
_PRIOR = 0.3  # of the widest start: nothing known of a vehicle is more wrong
_OPEN_LAG_S = 0.05  # 1-sigma of a lag that the filters do not reckon with


def model(scenario: Scenario) -> Model:
    """What a scenario's filter is told of its vehicle."""
    setup, vehicle = params.setup(scenario), scenario.vehicle_data
    thrust, gyros, accelerometers = setup.thrust, setup.gyros, setup.accelerometers
    joint = scenario.estimation.filter == "joint"
    n_jets, n_kinds, n_accelerometers = len(vehicle.jets), thrust.lag_uncertainty.shape[0], accelerometers.quanta.size
    of_kinds = np.array([thrust.time_constants_s[thrust.kinds == kind].max(initial=0.0) for kind in range(n_kinds)])
    if joint:
        block = scenario.joint
        of_thrust = thrust.uncertainty if block.thrust_uncertainty is None else block.thrust_uncertainty
        of_lag = of_kinds * (thrust.lag_uncertainty if block.lag_uncertainty is None else block.lag_uncertainty)
    else:
        of_thrust = scenario.estimation.thrust_uncertainty
        gated = scenario.estimation.thrust_transient == "gate"
        of_lag = np.full(n_kinds, _OPEN_LAG_S) if gated else of_kinds * thrust.lag_uncertainty
    prior = np.concatenate((setup.nominal, np.zeros(n_jets + n_kinds + 9 + 3 * gyros.quanta.size + 6 * n_accelerometers)))
    sigma = np.zeros_like(prior)
    variances = np.concatenate((setup.gyro_variances, setup.accelerometer_variances))
    made = Model(
        period_s=setup.period_s,
        wrenches=thrust.wrenches,
        flows=thrust.flows,
        time_constants_s=thrust.time_constants_s,
        kinds=thrust.kinds,
        positions=setup.accelerometer_positions,
        variances=variances,
        quanta=np.concatenate((_steps(gyros), _steps(accelerometers))),
        gyros=gyros.quanta.size,
        prior=prior,
        sigma=sigma,
    )
    places = hindsight.columns(made)
    sigma[places.properties] = _PRIOR * setup.widest
    sigma[places.thrust] = of_thrust
    sigma[places.lag] = of_lag
    sigma[places.gyro_bias] = gyros.bias_std.max()
    sigma[places.acceleration_bias] = np.repeat(accelerometers.bias_std, 3)
    return made


def _steps(packages) -> Array:
    return np.where(packages.noise_std >= 0.25 * packages.quanta, 0.0, packages.quanta)


def stretches(scenario: Scenario, signals: Spool, until_s: float = np.inf) -> list[Stretch]:
    """The parts of a run's record that regression takes, in order.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        until_s: rows later than this are left out.
    """
    names = [package.name for package in (*params.gyros(scenario), *params.accelerometers(scenario))]
    limits = [package.limit for package in (*params.gyros(scenario), *params.accelerometers(scenario))]
    wanted = ["time_s", "command", *(name for name in ("gap", "outside_wrench") if name in signals), *names]
    flows, period_s = scenario.vehicle_data.mass_flows, scenario.vehicle_data.sample_period_s
    found: list[Stretch] = []
    before = np.zeros(flows.size)
    used = 0.0
    for block in signals.blocks(*wanted):
        n = block["time_s"].shape[0]
        for first in range(0, n, _ROWS):
            rows = slice(first, min(first + _ROWS + 1, n))
            time_s = block["time_s"][rows]
            commands = block["command"][rows]
            known = np.nan_to_num(commands)
            spent = np.concatenate(([0.0], np.cumsum(known[:-1] @ flows * period_s)))
            readings = np.stack([block[name][rows] for name in names], axis=1).copy()
            for package, limit in enumerate(limits):
                readings[~(np.abs(readings[:, package]) < limit).all(axis=1), package] = np.nan
            outside = block["outside_wrench"][rows] if "outside_wrench" in block else np.zeros((time_s.size, 6))
            broken = np.isnan(commands).any(axis=1)
            if "gap" in block:
                broken |= block["gap"][rows][:, 0] != 0.0
            broken[-1] = False
            if not broken.any() and time_s.size > 2 and time_s[-1] <= until_s:
                found.append(Stretch(time_s, readings, known, before, outside, -(used + spent)))
            used += spent[-1]
            before = known[-2] if time_s.size > 1 else before
    return [one._replace(used_after=one.used_after + used) for one in found]
