"""One table of flights: what is named, when, and whether errors and readings are as the estimates say."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from pose_probe import again
from vehicle_flights import pulses, quick, small_pulses, windows

from massprop_drake import Estimator, InputError, Run, Scenario, load_scenario, simulate
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_parts import Disturbance

LOOP = "execution.engine=loop"
NEAR = (
    "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
    "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
)
TURNS = windows(("rhc", "+x", 0.5, 2.5), ("rhc", "+y", 3.5, 5.5), ("rhc", "+z", 6.5, 8.5), ("thc", "+x", 11.0, 13.0))
PUSHED = {"disturbance": {"torque_std": [0.01] * 3, "force_std": [0.02] * 3, "correlation_time_s": 30.0}}
STATED = Disturbance(torque_std=0.01, force_std=0.02, time_constant_s=30.0)
HARDLY = Disturbance(torque_std=0.005, force_std=0.001, time_constant_s=1000.0)
LEAK = {"kind": "leak", "jet": "ZP1", "start_s": 6.0, "force": 0.25}


def _pushed(stated: Disturbance | None, plant: dict[str, Any] | None = None, **more: Any) -> Scenario:
    """Nine seconds of pulses while a torque and a force push that change slowly."""
    vehicle = again(quick("small_satellite", "hydrazine"), disturbance=stated)
    return small_pulses(9.0, vehicle, plant=plant or PUSHED, seed=5, **more)


def _mounted(share: float) -> Scenario:
    """Jets that do not point where the drawing has them; the vehicle states a share of it."""
    vehicle = quick("small_satellite", "hydrazine", direction_std=0.02 * share, position_std=0.01 * share)
    plant = {"mounting_dispersion": 1.0 / share}
    return small_pulses(12.0, vehicle, plant=plant, seed=1, detector={"kind": "off"})


def _followed() -> Scenario:
    vehicle = quick("tracked_flyer", "cold_gas", command_delay_s=0.0, command_delay_std_s=0.005)
    failure = {"kind": "stuck_off", "jet": "T5", "start_s": 6.0}
    drawn = {"plant": {"dispersion": {}, "thrust_dispersion": 0.01}, "jet_schedule": pulses(vehicle, 14.0, seed=2)}
    return resolve_scenario({"vehicle": vehicle, "duration_s": 14.0, "seed": 2, "failures": [failure]} | drawn)


def _lag(factor: float, **failure: Any) -> Scenario:
    """Lag of nothing or of three times the stated one; thrusts are off by 1 %, as stated."""
    none = ("plant.thrust_transient=none", "joint.thrust_transient=vehicle")
    lag = (f"plant.lag_factor={factor}",) if factor else none
    told = ("estimation.start=nominal", "joint={}", "plant.thrust_dispersion=0.01")
    failures = f"failures={json.dumps([{**failure, 'start_s': 10.5}])}"
    return load_scenario("orbiter_maneuver", [LOOP, *told, TURNS, "duration_s=13", "seed=3", *lag, failures])


def _sooner(name: str, *overrides: str) -> Scenario:
    """A bundled scenario from near the truth, its failures forty-three seconds sooner."""
    failures = [one.model_dump(exclude_none=True) for one in load_scenario(name).failures]
    for one in failures:
        one.update({key: one[key] - 43.0 for key in ("start_s", "end_s") if key in one})
    return load_scenario(name, [LOOP, *NEAR, f"failures={json.dumps(failures)}", *overrides])


def _disturbance_is_sized(run: Run) -> None:
    first = next(one for one in run.summary["events"] if one["kind"] == "disturbance")
    assert run.summary["fault_probability"]["unknown"] > 0.99  # something pushes that is no jet
    assert 0.0005 < first["torque_std"] < 0.05
    assert 0.001 < first["force_std"] < 0.1


def _disturbance_is_estimated(run: Run) -> None:
    dut = Estimator(run.scenario.vehicle_data, run.scenario)
    dut.restore(run.state)
    assert dut.disturbance is not None
    value, deviation = dut.disturbance
    rest = np.array([0.01] * 3 + [0.02] * 3)
    assert (deviation < 0.6 * rest).all()
    assert (np.abs(value) < 4.0 * rest).all()
    assert np.abs(value).max() > 3.0 * deviation.min()


def _lag_is_said(run: Run) -> None:
    assert run.summary["consistency"]["reasons"][0].startswith("lag wrong: primary jets build up with ")
    (injected,) = run.summary["injected"]
    assert injected["outcome"] == "named"


def _is_half_a_percent(run: Run) -> None:
    (said,) = run.results.detections
    assert (said.kind, said.mode) == ("jet_on", "leak")
    assert abs((said.magnitude or 0.0) - 5.0) < 4.0 * (said.magnitude_std or 0.0) < 1.0


def _is_weighed(run: Run) -> None:
    (said,) = run.results.detections
    assert (said.kind, said.jets, said.isolated_to) == ("mass_property_jump", (), None)
    assert said.mass_std is not None
    assert said.mass_std < 50.0
    assert abs((said.mass or 0.0) - 500.0) < 4.0 * said.mass_std


def _is_consistent_to_the_last_digit(run: Run) -> None:
    """NIS is on the scale 3 sum(e^2) / sum(1 - v), whose expectation is 3.

    Readings without noise are believed with care: the floor of a prediction and the half of a variance that a cell
    leaves make a sigma up to 1.3 times too large, and so NIS as little as 3 / 1.3^2. The mean of chi-square scatters
    by 3 sqrt(2 / sum(1 - v)), of which 4 are allowed.
    """
    error = run["estimate"][-1] - run["truth"][-1]
    assert (np.abs(error[:3] / run["truth"][-1, :3]) < 5e-5).all()
    assert run["converged"][-1, 0] == run["settled"][-1, 0] == 1.0
    found = run.summary["consistency"]
    for filtered, components in (("rotation", "gyro_components"), ("translation", "accelerometer_components")):
        degrees = float(np.nansum(run[components]))
        scatter, mean = 4.0 * np.sqrt(2.0 / degrees), found[f"{filtered}_nis_mean"]
        assert degrees > 60.0
        assert 3.0 / 1.3**2 * (1.0 - scatter) < mean < 3.0 * (1.0 + scatter)


class Flight(NamedTuple):
    """A flight, and what must come of it.

    Attributes:
        scenario: makes it.
        named: jets that are declared.
        by_s: when the last of them is, s.
        verdict: of its consistency; None: any.
        sigmas: largest error of the ten parameters, in their 1-sigma.
        also: what else holds.
    """

    scenario: Callable[[], Scenario]
    named: tuple[str, ...] = ()
    by_s: float = np.inf
    verdict: str | None = "consistent"
    sigmas: float = 4.0
    also: Callable[[Run], None] = lambda _: None


DRAW = {"disturbance": {"torque": [0.011, -0.011, 0.0]}}  # 2.2 sigma about two axes: one draw of what is stated
DOCK = "jumps=[{kind: dock, time_s: 5, mass: 500, position: [60, 0, -3]}]"
DOCKED = windows(("rhc", "+x", 1.0, 2.0), ("rhc", "+y", 3.0, 4.0), ("thc", "+x", 6.0, 8.0), ("thc", "+y", 9.0, 11.0))
OFF = {"detector": {"kind": "off"}}
FLIGHTS = {
    "a stated disturbance": Flight(
        lambda: _pushed(STATED, failures=[LEAK]), ("ZP1",), 8.0, also=_disturbance_is_estimated
    ),
    "an untold disturbance": Flight(
        lambda: _pushed(None, failures=[LEAK]), ("ZP1",), verdict="inconsistent", also=_disturbance_is_sized
    ),
    "a torque that hardly changes": Flight(lambda: _pushed(HARDLY, DRAW, **OFF)),
    "jets mounted as stated": Flight(lambda: _mounted(1.0), sigmas=3.5),
    "pulses of milliseconds": Flight(lambda: small_pulses(8.0, failures=[LEAK | {"start_s": 6.03}]), ("ZP1",), 7.5),
    "followed in a fixed frame": Flight(_followed, ("T5",), verdict=None),
    "no lag": Flight(lambda: _lag(0.0, kind="leak", jet="L5D", force=10.0), ("L5D",), 12.5, None, 3.5, _lag_is_said),
    "three times the lag": Flight(
        lambda: _lag(3.0, kind="stuck_off", jet="L1A"), ("L1A",), 12.5, None, 3.5, _lag_is_said
    ),
    "a leak of half a percent": Flight(
        lambda: _sooner("leak_small", "duration_s=8"), ("L4D",), 8.0, None, also=_is_half_a_percent
    ),
    "two leaks at once": Flight(lambda: _sooner("two_at_once", "duration_s=7"), ("F2F", "R4R"), verdict=None),
    "a payload that docks": Flight(
        lambda: load_scenario("payload_docking", ["duration_s=11.5", LOOP, *NEAR, DOCKED, DOCK]),
        (),
        11.5,
        None,
        4.5,
        _is_weighed,
    ),
    "the joint filter's maneuver": Flight(
        lambda: load_scenario("orbiter_maneuver", ["duration_s=28", "seed=5", LOOP]),
        verdict=None,
        also=_is_consistent_to_the_last_digit,
    ),
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_flights_end_as_they_must(name: str) -> None:
    flight = FLIGHTS[name]
    run = simulate(flight.scenario(), look_back=flight.also in (_lag_is_said, _disturbance_is_sized))
    declared = run.results.detections
    assert tuple(sorted(jet for one in declared for jet in one.jets)) == flight.named
    assert all(one.withdrawn_s is None and one.time_s <= flight.by_s for one in declared)
    errors = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(errors).max() < flight.sigmas
    assert flight.verdict in (run.summary["consistency"]["verdict"], None)
    flight.also(run)


def test_jets_mounted_otherwise_than_stated_bias_the_estimates() -> None:
    run = simulate(_mounted(0.1), look_back=False)
    assert np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]).max() > 4.0
    assert run.summary["consistency"]["verdict"] == "inconsistent"
    with pytest.raises(InputError, match="mounting_dispersion"):
        load_scenario("small_satellite_leak", ["plant.mounting_dispersion=-1"])


def test_every_pulse_gives_what_it_lasts() -> None:
    """Without lag the impulse is thrust times on-time, to the last digits, and so is what the body gains."""
    vehicle = quick("small_satellite", "hydrazine", time_constant_s=0.0)
    told = [("XP1", 0.5, 0.535), ("XP2", 0.5, 0.535), ("XN1", 1.02, 1.055), ("XN1", 1.5, 2.01)]
    schedule = [dict(zip(("jet", "start_s", "end_s"), one, strict=True)) for one in told]
    run = simulate(resolve_scenario({"vehicle": vehicle, "duration_s": 3.0, "jet_schedule": schedule}))
    thrust = {jet.designation: jet.thrust for jet in vehicle.jets}
    given = dict(zip(vehicle.designations, run["thrust"][:-1].sum(axis=0) * vehicle.sample_period_s, strict=True))
    for name in ("XP1", "XP2", "XN1"):
        lasts_s = sum(end_s - start_s for jet, start_s, end_s in told if jet == name)
        np.testing.assert_allclose(given[name], thrust[name] * lasts_s, rtol=1e-12)


def test_a_jet_must_open_and_close_within_its_sample() -> None:
    dut = Estimator(quick("small_satellite", "hydrazine"))
    half = np.full(12, 0.5)
    with pytest.raises(ValueError, match=r"onsets_s: a jet must open and close within the sample period of 0\.1 s"):
        dut.step(0.0, None, None, half, onsets_s=np.full_like(half, 0.06))
