"""The bundled vehicles beside the orbiter: possible bodies, and estimates that are as good as they claim."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from massprop_drake import load_scenario, load_vehicle, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.vehicle_file import bundled_vehicles
from massprop_drake.maths.mass_properties import could_be_inertia
from massprop_drake.results.run import Run

TRACKED = [name for name in bundled_vehicles() if load_vehicle(name).needs_pose_filter]
VEHICLES = [name for name in bundled_vehicles() if name not in ("orbiter", *TRACKED)]
RIGID = [
    name for name in VEHICLES if name not in ("servicer", "servicer_on_wheels", "cubesat")
]  # of joints, and without autopilot


@pytest.fixture(scope="module", params=RIGID)
def run(request: pytest.FixtureRequest) -> Run:
    """The vehicle's maneuver, with a seed that played no part in choosing it."""
    return simulate(load_scenario(f"{request.param}_maneuver", ["seed=1983", "execution.engine=loop"]), look_back=False)


def test_the_vehicles_are_those_that_are_promised() -> None:
    assert VEHICLES == ["cubesat", "free_flyer", "lander", "servicer", "servicer_on_wheels", "small_satellite"]
    assert TRACKED == ["air_bearing", "tracked_flyer"]


@pytest.mark.parametrize("name", VEHICLES)
def test_vehicle_is_a_possible_body_with_plausible_parts(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.units == "si"
    assert could_be_inertia(vehicle.nominal.inertia)
    # jets lie within a few radii of gyration, sensors among them
    gyration = math.sqrt(np.trace(vehicle.nominal.inertia) / 2.0 / vehicle.nominal.mass)
    assert 0.3 * gyration < vehicle.rms_arm < 3.0 * gyration
    for package in vehicle.accelerometers:
        assert np.linalg.norm(np.array(package.position) - vehicle.nominal.center_of_mass) < 2.0 * vehicle.rms_arm
    for sensor in vehicle.sensors:  # white noise is the better part of the error, as the filters take it
        assert 0.0 < sensor.quantum <= sensor.noise_std
    for kind in vehicle.jet_kinds.values():
        assert kind.time_constant_s < vehicle.sample_period_s
        assert vehicle.sample_period_s <= kind.minimum_on_time_s or kind.on_time_quantum_s > 0.0
        assert 30.0 < kind.specific_impulse_s < 320.0


@pytest.mark.parametrize("name", VEHICLES)
def test_jets_of_a_cluster_fire_along_nearly_the_same_line_or_the_same_way(name: str) -> None:
    vehicle = load_vehicle(name)
    clusters = np.array([jet.cluster for jet in vehicle.jets])
    directions = vehicle.thrusts / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]
    for cluster in set(clusters.tolist()):
        members = np.flatnonzero(clusters == cluster)
        assert members.size == 2
        first, second = members
        if directions[first] @ directions[second] < 0.0:
            apart = vehicle.positions[second] - vehicle.positions[first]
            np.testing.assert_allclose(np.cross(apart, directions[first]), 0.0, atol=1e-12)
        else:
            np.testing.assert_allclose(directions[first], directions[second], atol=1e-12)


@pytest.mark.parametrize("name", RIGID)
def test_the_truth_is_well_off_the_nominal_values(name: str) -> None:
    scenario = load_scenario(f"{name}_maneuver")
    vehicle, truth = scenario.vehicle_data, params.true_properties(scenario)
    assert 0.1 < abs(truth.mass / vehicle.nominal.mass - 1.0) < 0.25
    products = np.abs(truth.inertia[[1, 0, 0], [2, 2, 1]])
    assert (products > 0.01 * truth.inertia.diagonal().max()).all()
    assert (np.abs(truth.center_of_mass - vehicle.nominal.center_of_mass) > 0.02 * vehicle.rms_arm).all()


def test_estimates_converge_and_are_as_good_as_they_claim(run: Run) -> None:
    assert run["converged"][-1, 0] == 1.0
    start, end = run["standard_deviation"][0], run["standard_deviation"][-1]
    assert (end < 0.5 * start).all()  # all ten show
    error = run["estimate"][-1] - run["truth"][-1]
    scale = np.sqrt(run.covariance.diagonal())
    correlation = run.covariance / np.outer(scale, scale)
    nees = float(error / scale @ np.linalg.solve(correlation, error / scale))
    # far too small would be as wrong; 1e-3 either way
    assert chi2.ppf(1e-3, 10) < nees < chi2.ppf(1.0 - 1e-3, 10)


@pytest.mark.parametrize("name", ["rotation", "mass"])
def test_innovations_are_as_large_as_the_filters_expect(run: Run, name: str) -> None:
    used = run[f"{name}_used"][:, 0] == 1.0
    samples = int(used.sum())
    assert samples > 25
    mean = run[f"{name}_nis"][used, 0].mean()
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 3 * samples) / samples
    # differences of white noise are correlated from sample to sample, so that the sum of squares scatters more, by
    # sqrt(1 + 2 (1/2)^2) = 1.22 times
    assert 3.0 - 1.22 * (3.0 - low) < mean < 3.0 + 1.22 * (high - 3.0)


def test_nothing_is_found_to_have_failed(run: Run) -> None:
    assert run.summary["detections"] == []
    assert run.summary["autopilot"]["lp_infeasible"] == 0
    assert not run["mass_jump"].any()


@pytest.mark.parametrize(
    ("name", "kind", "jet", "start_s", "isolated"),
    [
        ("small_satellite", "stuck_on", "YP1", 33.05, ["YP1"]),
        ("small_satellite", "stuck_off", "XP1", 30.0, ["XP1"]),
        # the one that opposes it looks the same
        ("lander", "stuck_off", "1U", 30.0, ["1U", "1D"]),
    ],
)
def test_a_failed_thruster_is_found(name: str, kind: str, jet: str, start_s: float, isolated: list[str]) -> None:
    failure = f"failures=[{{kind: {kind}, jet: {jet}, start_s: {start_s}}}]"
    result = simulate(
        load_scenario(f"{name}_maneuver", [failure, "duration_s=48", "execution.engine=loop"]), look_back=False
    )
    (found,) = result.summary["detections"]
    vehicle = load_vehicle(name)
    index = vehicle.jet_index(jet)
    assert found["kind"] == ("jet_on" if kind == "stuck_on" else "jet_off")
    assert found["cluster"] == vehicle.jets[index].cluster
    assert found["jet"] == (jet if isolated == [jet] else None)
    assert abs(found["magnitude"]) == pytest.approx(vehicle.jets[index].thrust, rel=0.1)
    assert result.summary["autopilot"]["jets_out_of_use"] == isolated
