"""The end of a run against its start: truths drawn from the start are allowed, and factors of it are named."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake import Scenario, load_scenario
from massprop_drake.inputs import factors, params
from massprop_drake.maths.mass_properties import perturb_body
from massprop_drake.results.prior import find_contradiction
from massprop_drake.results.spool import Spool

STATED = 0.3  # relative 1-sigma of mass and moments


def case(name: str, std_fraction: float = STATED) -> Scenario:
    return load_scenario(name, ["estimation.start=nominal", f"estimation.std_fraction={std_fraction}"])


def known_well(scenario: Scenario, *shares: float) -> Spool:
    """Signals of a run that leaves hardly any doubt, with every jet on for a share of each sample but the last."""
    rows, signals = len(shares) + 1, Spool(None, index="time_s")
    command = np.repeat([[*shares, 9.0]], len(scenario.vehicle_data.jets), axis=0).T
    time_s = scenario.vehicle_data.sample_period_s * np.array([0.0, 1.0, 2.0, 3.0, 5.0])[:rows]
    signals.append({"time_s": time_s, "standard_deviation": np.full((rows, 10), 1e-12), "command": command})
    return signals


@pytest.mark.parametrize("vehicle", ["orbiter_maneuver", "free_flyer_maneuver", "small_satellite_maneuver"])
@pytest.mark.parametrize("common", [False, True])
def test_truths_drawn_from_the_start_are_allowed(vehicle: str, common: bool) -> None:
    scenario, random = case(vehicle), np.random.default_rng(5)
    signals, nominal = known_well(scenario), scenario.vehicle_data.nominal
    for _ in range(100):
        mass, *moments = np.exp(STATED * random.standard_normal(4))
        turn = np.radians(5.0) * random.standard_normal(3)
        moments, turn = (np.full(3, mass), 0.0 * turn) if common else (np.array(moments), turn)
        body = perturb_body(nominal, mass_factor=mass, shift=np.zeros(3), second_moment_factors=moments, rotation=turn)
        assert find_contradiction(scenario, signals, body.vector()) is None


@pytest.mark.parametrize(
    ("inertia", "mass", "words"),
    [
        (10.0, 10.0, "inertia and mass end at 1/10 times the start, 30 of its sigmas off, as if commands or thrusts"),
        (0.1, 0.1, "commands or thrusts were 10 times what acts"),
        (57.3, 1.0, "inertia alone ends at 1/57.3 times the start"),
        (1.0, None, "as if accelerometers were {} times what acts; ft/s^2 in place of g"),
    ],
)
def test_a_common_factor_is_named(inertia: float, mass: float | None, words: str) -> None:
    if mass is None:
        mass = factors.velocity_factors("us", 0.08)[1].size
        words = words.format(factors.format_factor(mass))
    scenario = case("orbiter_maneuver")
    end = params.initial_estimate(scenario) * np.array([*[inertia] * 6, 1.0, 1.0, 1.0, mass])
    found = find_contradiction(scenario, known_well(scenario), end)
    assert found is not None
    assert found.kind == "factor"
    assert words in found.reason


def test_what_no_factor_explains_is_told_by_the_parameter_that_is_farthest() -> None:
    scenario = case("orbiter_maneuver")
    end = params.initial_estimate(scenario)
    end[7] += 12.0 * np.sqrt(params.initial_covariance(scenario)[7, 7])
    found = find_contradiction(scenario, known_well(scenario), end)
    assert found is not None
    assert (found.kind, found.reason.partition(";")[0]) == ("start", "y_cm ends 12 of the start's sigmas from it")
    zero = load_scenario("orbiter_maneuver", ["estimation.start=zero"])  # claims nothing
    assert find_contradiction(zero, known_well(zero), 10.0 * zero.vehicle_data.nominal.vector()) is None


def test_propellant_that_was_used_is_no_contradiction(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fifth of the mass is used, of which 1 % is stated."""
    scenario = case("orbiter_maneuver", 0.01)
    vehicle = scenario.vehicle_data
    used = 0.2 * vehicle.nominal.mass
    samples = used / (float(vehicle.mass_flows.sum()) * vehicle.sample_period_s)
    end = params.initial_estimate(scenario)
    end[9] = 1.0 / (vehicle.nominal.mass - used)
    assert find_contradiction(scenario, known_well(scenario), end) is not None
    assert find_contradiction(scenario, known_well(scenario, samples), end) is None
    # where sensors have their own rates, a command lasts until the next row
    monkeypatch.setattr(params, "steps_by_readings", lambda _: True)
    signals = known_well(scenario, 0.0, 0.0, 0.5 * samples, 0.25 * samples)
    assert find_contradiction(scenario, signals, end) is None
