"""Forecast of a flight: sigmas, floors, propellant, and how soon a failed jet shows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs import params
from massprop_drake.inputs.asked import declaration_log_odds
from massprop_drake.inputs.estimation_blocks import CglrBlock
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import Dispersion, DisturbanceBlock, PlantBlock
from massprop_drake.maths.estimation import foretold
from massprop_drake.maths.estimation.cycle import EstimationParams, collect_thrust_inputs, initial_state
from massprop_drake.maths.estimation.faults.priors import Priors, log_failure_probability, log_jump_probability
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint.hypotheses import jump_variances
from massprop_drake.maths.estimation.joint.layout import thrust_sigmas
from massprop_drake.maths.estimation.whole import Samples
from massprop_drake.maths.maneuver.aims import (
    FOLLOWED,
    expected_llr_jumps,
    expected_llr_no_failure,
    expected_llr_other_jet,
)
from massprop_drake.maths.mass_properties import INVERSE_INERTIA, MASS_RECIPROCAL
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.maths.vehicle.rigid_body import MASS
from massprop_drake.runners.cycles import IdleCycles, RecordRows, row_sample
from massprop_drake.runners.simulate import needs_diagram, simulate, true_parameters

Array = NDArray[np.float64]

SHARE = 0.05  # of its thrust that a suspect jet leaks


class Suspect(NamedTuple):
    """Suspect jet, with the times after which its leak is noticed and isolated.

    Attributes:
        jet: designation.
        force: that it leaks, lbf or N.
        after_s: until it is told from every other jet, too, s; None: not by the end.
        noticed_s: until it is told from nothing, in the mean over noise, s; None: not by the end.
        alike: the jet that explains it longest; None: noticing takes longest.
    """

    jet: str
    force: float
    after_s: float | None
    noticed_s: float | None
    alike: str | None


class Forecast(NamedTuple):
    """Forecast of a flight.

    Attributes:
        scenario: its name.
        time_s: of the samples, shape (n,).
        properties: the ten parameters at the end, as the flight is foretold about them, shape (10,).
        deviations: their 1-sigma by each sample, shape (n, 10).
        floors: of what no firing of these jets tells, the common scale of their thrusts, shape (10,).
        propellant: that jets use, slug or kg.
        fails_s: from when on a suspect leaks, s.
        suspects: the jets, in the vehicle's order.
    """

    scenario: str
    time_s: Array
    properties: Array
    deviations: Array
    floors: Array
    propellant: float
    fails_s: float
    suspects: tuple[Suspect, ...]


def foretell(
    scenario: Scenario, *, nominal: bool = False, share: float = SHARE, since_s: float | None = None
) -> Forecast:
    """Forecasts 1-sigmas of mass properties, and how soon a jet that leaks a share of its thrust is detected.

    The vehicle flies as stated: no failures, jumps or disturbances, thrusts and sensors as the file has them.

    Args:
        scenario: with hand-controller windows or a jet schedule.
        nominal: whether the vehicle is as its file has it; else as the scenario's plant has it.
        share: of its thrust that a suspect jet leaks, 0 to 1.
        since_s: from when on, s; None: from the middle of the flight.

    Raises:
        InputError: when the vehicle needs the filter for a fixed frame, or a number is out of its range.
    """
    if scenario.vehicle_data.needs_pose_filter:
        raise InputError(
            f"foretell: vehicle '{scenario.vehicle_data.name}' is estimated in a fixed frame, by estimation.filter: "
            "pose; it can be foretold of vehicles that have gyros and no position sensor"
        )
    if not 0.0 < share <= 1.0:
        raise InputError(
            f"foretell: the share of its thrust that a jet leaks must be above 0 and at most 1, not {share:g}"
        )
    fails_s = 0.5 * scenario.duration_s if since_s is None else since_s
    if not 0.0 <= fails_s < scenario.duration_s:
        raise InputError(
            f"foretell: a jet must fail before the end of the flight, {scenario.duration_s:g} s, not at {fails_s:g} s"
        )
    ideal = _undispersed_scenario(scenario, nominal=nominal)
    estimation_params = params.estimation_params(ideal)
    return _forecast(ideal, _fly_scenario(ideal, estimation_params), estimation_params.filter_params, fails_s, share)


def forecast_to_json(forecast: Forecast) -> dict[str, Any]:
    """Converts a forecast to JSON data: arrays as lists, parameters in the order of a summary's covariance."""
    return {
        "scenario": forecast.scenario,
        "properties": forecast.properties.tolist(),
        "floors": forecast.floors.tolist(),
        "standard_deviations": forecast.deviations[-1].tolist(),
        "propellant": forecast.propellant,
        "fails_s": forecast.fails_s,
        "suspects": [suspect._asdict() for suspect in forecast.suspects],
    }


def _undispersed_scenario(scenario: Scenario, *, nominal: bool) -> Scenario:
    """Returns the scenario with the joint filter, without dispersions, disturbance, failures, jumps and detector."""
    plant = scenario.plant
    exact: dict[str, Any] = {"thrust_dispersion": 0.0, "mounting_dispersion": 0.0, "wheel_dispersion": 0.0}
    exact |= {"disturbance": DisturbanceBlock(), "lag_factor": 1.0}
    if isinstance(plant, PlantBlock):
        exact |= {"dispersion": Dispersion(), "engine_errors": {}, "engine_dispersion": 0.0}
        if nominal:
            exact["mass_properties"] = None
    nothing: dict[str, Any] = {"failures": (), "engine_failures": (), "jumps": ()}
    nothing["plant"] = plant.model_copy(update=exact)
    nothing["detector"] = CglrBlock(kind="off")
    nothing["estimation"] = scenario.estimation.model_copy(update={"filter": "joint"})
    return scenario.model_copy(update=nothing)


def _fly_scenario(scenario: Scenario, estimation_params: EstimationParams) -> Mapping[str, Array]:
    """Simulates a flight without estimation; maps names of signals to true states, commands and readings."""
    if needs_diagram(scenario):
        run = simulate(scenario, look_back=False)
        return {"time_s": run.time_s, **{name: run[name] for name in run.signals}}
    from massprop_drake.runners.loop import Loop  # noqa: PLC0415 (each engine loads what it needs)

    loop = Loop(scenario, IdleCycles(estimation_params, initial_state(estimation_params)))
    loop.advance(scenario.duration_s)
    logs = loop.take_logs()
    body = logs["body_state"]
    return {**logs, "truth": true_parameters(body[:, MASS], logs["structure"])}


def _forecast(
    scenario: Scenario,
    logs: Mapping[str, Array],
    filter_params: JointFilterParams,
    fails_s: float,
    leak_fraction: float,
) -> Forecast:
    """Runs the joint filter along the logs of a flight, and returns its 1-sigmas and detection times of leaks.

    Args:
        scenario: as it is foretold.
        logs: see `_fly_scenario`.
        filter_params: parameters of the filter.
        fails_s: from when on a suspect leaks, s.
        leak_fraction: of its thrust.
    """
    vehicle, time_s, record = scenario.vehicle_data, logs["time_s"], _make_record_rows(scenario, logs, filter_params)
    (state, linear), deviations, information = (
        foretold.begin_forecast(logs["truth"][0], filter_params),
        list[Array](),
        list[Array](),
    )
    for row in range(time_s.size):
        sample, failing = row_sample(record, row), bool(time_s[row] > fails_s)
        state = foretold.step(
            state, (sample.rates, sample.velocities), collect_thrust_inputs(sample), linear, failing=failing
        )
        deviations.append(np.sqrt(np.diagonal(state.filter.covariance)))
        if failing:
            information.append(state.shown)
    seconds = logs["thrust"].sum(axis=0) / np.linalg.norm(vehicle.thrusts, axis=1) * vehicle.sample_period_s
    properties = logs["truth"][-1]
    return Forecast(
        scenario.name,
        time_s,
        properties,
        np.array(deviations),
        _scale_floors(properties, logs["command"], filter_params),
        float(seconds @ vehicle.mass_flows),
        fails_s,
        tuple(
            _leak_times(
                scenario, time_s[time_s > fails_s] - fails_s, np.array(information), leak_fraction, filter_params
            )
        ),
    )


def _make_record_rows(scenario: Scenario, logs: Mapping[str, Array], filter_params: JointFilterParams) -> RecordRows:
    """Makes the rows of samples that the filter takes, from the logs of a simulated flight."""
    vehicle, time_s, commands = scenario.vehicle_data, logs["time_s"], logs["command"]
    n, jets = time_s.size, filter_params.joint.places.jets
    rates, velocities = (
        np.stack([logs[sensor.name] for sensor in sensors], axis=1) if sensors else np.zeros((n, 0, 3))
        for sensors in (vehicle.gyros, vehicle.accelerometers)
    )
    commands_before = np.vstack((np.zeros(jets), commands[:-1]))
    samples = Samples(time_s, rates, velocities, commands_before, np.zeros((n, 6)))
    tracked = [logs[sensor.name].reshape(n, -1) for sensor in vehicle.tracked if sensor.name in logs]
    onsets_s = logs.get("command_onset")
    if onsets_s is not None:
        onsets_s = np.vstack((level_onsets(jets), onsets_s))
    return RecordRows(samples, None, commands, np.hstack(tracked) if tracked else None, onsets_s)


def _scale_floors(properties: Array, commands: Array, filter_params: JointFilterParams) -> Array:
    """Computes the least 1-sigmas of the ten parameters that the common error of all thrusts allows, shape (10,).

    More thrust of all by the same share and as much more inertia and mass change no reading; wheels, whose inertias are
    known absolutely, show the scale as well as these are known.
    """
    joint, fires = filter_params.joint, (commands > 0.0).any(axis=0)
    floors = np.zeros(10)
    if joint.places.n_thrust == 0 or not fires.any():
        return floors
    wheels = joint.prior_sigma[joint.places.wheel - joint.places.thrust :][: joint.places.n_wheel]
    sigmas = np.append(thrust_sigmas(joint)[fires], joint.wheels.sigma * wheels)
    floor = float(np.sum(sigmas**-2.0)) ** -0.5
    scaled = np.zeros(10, dtype=bool)
    scaled[INVERSE_INERTIA], scaled[MASS_RECIPROCAL] = True, joint.places.accelerometers > 0
    floors[scaled] = floor * np.abs(properties[scaled])
    return floors


def _leak_times(
    scenario: Scenario, since_s: Array, information: Array, leak_fraction: float, filter_params: JointFilterParams
) -> Iterator[Suspect]:
    """Yields each jet with the times after which its leak is noticed and isolated, s.

    Args:
        scenario: for the vehicle, and how likely faults are.
        since_s: of the samples since a jet leaks, s, shape (n,).
        information: see `Foretelling`, by each of them, shape (n, p, p).
        leak_fraction: of its thrust that it leaks.
        filter_params: of the filter.
    """
    vehicle, priors, threshold = (
        scenario.vehicle_data,
        Priors.stated(scenario.faults),
        declaration_log_odds(scenario.faults),
    )
    thrusts, n = np.linalg.norm(vehicle.thrusts, axis=1), len(vehicle.jets)
    forces = leak_fraction * thrusts
    own, jets = np.diagonal(information, axis1=1, axis2=2), np.arange(n)
    times_s, variances = since_s.tolist(), jump_variances(filter_params.joint)
    jumped = [
        log_jump_probability(one, priors) + expected_llr_jumps(each, jets, forces, variances)
        for one, each in zip(times_s, information, strict=True)
    ]
    fails = np.array(
        [log_failure_probability(leak_fraction, 1.0, one, priors, is_loss=False) for one in times_s]
    )  # alike for all jets
    otherwise = np.logaddexp(0.0, np.array(jumped))
    counts = np.arange(1, since_s.size + 1) >= FOLLOWED
    for jet in range(n):
        others = np.delete(np.arange(2 * n), (jet, n + jet))
        force, thrust = float(forces[jet]), float(thrusts[jet])
        led = fails + expected_llr_no_failure(own[:, jet], force, thrust) - otherwise[:, jet]
        apart = (
            expected_llr_other_jet(own[:, jet, None], information[:, jet, others], own[:, others], force) >= threshold
        )
        noticed = _first_time(since_s, counts & (led >= threshold))
        each = np.array(
            [_first_time(since_s, counts & (led >= threshold) & apart[:, place]) for place in range(others.size)]
        )
        longest = int(np.argmax(each)) if others.size else -1
        alike = longest >= 0 and each[longest] > noticed
        told = float(each[longest]) if alike else noticed
        after_s, noticed_s = (one if math.isfinite(one) else None for one in (told, noticed))
        name = vehicle.designations[others[longest] % n] if alike else None
        yield Suspect(vehicle.designations[jet], force, after_s, noticed_s, name)


def _first_time(since_s: Array, condition: NDArray[np.bool_]) -> float:
    """Returns the first time at which a condition holds, s; infinity: it never does."""
    indices = np.flatnonzero(condition)
    return float(since_s[indices[0]]) if indices.size else math.inf
