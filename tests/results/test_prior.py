"""The end of a run against its start: truths drawn from the start are allowed, and factors of it are named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import Scenario, load_scenario
from massprop_drake.inputs import factors, params
from massprop_drake.maths.linear_algebra import is_positive_definite
from massprop_drake.maths.mass_properties import ELEMENT, perturbed
from massprop_drake.results.prior import contradiction
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]
STATED = 0.3  # relative 1-sigma of mass and moments


def case(name: str) -> Scenario:
    return load_scenario(name, ["estimation.start=nominal", f"estimation.std_fraction={STATED}"])


def known_well(scenario: Scenario, commanded: float = 0.0) -> Spool:
    """Signals of a run that leaves hardly any doubt, with every jet on for some samples."""
    jets = len(scenario.vehicle_data.jets)
    signals = Spool(None, index="time_s")
    deviation = np.full((1, 10), 1e-12)
    signals.append({"time_s": np.zeros(1), "standard_deviation": deviation, "command": np.full((1, jets), commanded)})
    return signals


def _independent(scenario: Scenario, random: np.random.Generator) -> Array:
    start, deviation = params.initial_estimate(scenario), np.sqrt(params.initial_covariance(scenario).diagonal())
    while True:
        truth: Array = start + deviation * random.standard_normal(10)
        if truth[9] > 0.0 and is_positive_definite(truth[:6][ELEMENT]):
            return truth


def _by_factors(scenario: Scenario, random: np.random.Generator) -> Array:
    mass, moments = float(np.exp(STATED * random.standard_normal())), np.exp(STATED * random.standard_normal(3))
    return _body(scenario, mass, moments, np.radians(5.0) * random.standard_normal(3))


def _body(scenario: Scenario, mass: float, moments: Array, turn: Array) -> Array:
    nominal = scenario.vehicle_data.nominal
    body = perturbed(nominal, mass_factor=mass, shift=np.zeros(3), second_moment_factors=moments, rotation=turn)
    return body.vector()


def _in_common(scenario: Scenario, random: np.random.Generator) -> Array:
    factor = float(np.exp(STATED * random.standard_normal()))
    return _body(scenario, factor, np.full(3, factor), np.zeros(3))


@pytest.mark.parametrize("vehicle", ["orbiter_maneuver", "free_flyer_maneuver", "small_satellite_maneuver"])
@pytest.mark.parametrize("drawn", [_independent, _by_factors, _in_common])
def test_truths_drawn_from_the_start_are_allowed(
    vehicle: str, drawn: Callable[[Scenario, np.random.Generator], Array]
) -> None:
    scenario, random = case(vehicle), np.random.default_rng(5)
    signals = known_well(scenario)
    assert [contradiction(scenario, signals, drawn(scenario, random)) for _ in range(100)] == [None] * 100


@pytest.mark.parametrize(
    ("inertia", "mass", "words"),
    [
        (10.0, 10.0, "inertia and mass end at 1/10 times the start, 30 of its sigmas off, as if commands or thrusts"),
        (0.1, 0.1, "commands or thrusts were 10 times what acts"),
        (57.3, 1.0, "inertia alone ends at 1/57.3 times the start"),
        (1.0, 9.80665, "as if accelerometers were 9.807 times what acts; ft/s^2 in place of g"),
    ],
)
def test_a_common_factor_is_named(inertia: float, mass: float, words: str) -> None:
    if "ft/s^2" in words:
        mass = factors.of_velocities("us", 0.08)[1].size
        words = words.replace("9.807", factors.in_words(mass))
    scenario = case("orbiter_maneuver")
    end = params.initial_estimate(scenario) * np.array([*[inertia] * 6, 1.0, 1.0, 1.0, mass])
    found = contradiction(scenario, known_well(scenario), end)
    assert found is not None
    assert found.kind == "factor"
    assert words in found.reason


def test_what_no_factor_explains_is_told_by_the_parameter_that_is_farthest() -> None:
    scenario = case("orbiter_maneuver")
    end = params.initial_estimate(scenario)
    end[7] += 12.0 * np.sqrt(params.initial_covariance(scenario)[7, 7])
    found = contradiction(scenario, known_well(scenario), end)
    assert found is not None
    assert (found.kind, found.reason.partition(";")[0]) == ("start", "y_cm ends 12 of the start's sigmas from it")


def test_a_start_from_zero_claims_nothing() -> None:
    scenario = load_scenario("orbiter_maneuver", ["estimation.start=zero"])
    assert contradiction(scenario, known_well(scenario), 10.0 * scenario.vehicle_data.nominal.vector()) is None


def test_propellant_that_was_used_is_no_contradiction() -> None:
    """A fifth of the mass is used, of which 1 % is stated."""
    scenario = load_scenario("orbiter_maneuver", ["estimation.start=nominal", "estimation.std_fraction=0.01"])
    vehicle = scenario.vehicle_data
    used = 0.2 * vehicle.nominal.mass
    samples = used / (float(vehicle.mass_flows.sum()) * vehicle.sample_period_s)
    end = params.initial_estimate(scenario)
    end[9] = 1.0 / (vehicle.nominal.mass - used)
    assert contradiction(scenario, known_well(scenario), end) is not None
    assert contradiction(scenario, known_well(scenario, samples), end) is None
