"""The disturbance as a system: what it adds, for which sample, and to which body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.inputs import true_params
from massprop_drake.inputs.scenario import Scenario, load_scenario
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel
from massprop_drake.runners.simulate import simulate
from massprop_drake.systems.layouts import STRUCTURE
from massprop_drake.systems.vehicle.disturbance_source import Disturbance

MEAN = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 3.0])
MODEL = DisturbanceModel(MEAN, np.ones(6), 0.6, np.full(6, 0.5))
SHAKEN = [
    "duration_s=8",
    "plant.disturbance={torque: [50, 0, 20], torque_std: [100, 200, 50], force: [1, 2, 3], force_std: [5, 5, 5], "
    "correlation_time_s: 2}",
]


def _disturbance(*, stepped: bool, n_lags: int = 0) -> tuple[Disturbance, Any]:
    dut = Disturbance(MODEL, period_s=PERIOD_S, stepped=stepped, n_lags=n_lags)
    context = dut.CreateDefaultContext()
    dut.GetInputPort("jets").FixValue(context, np.arange(7.0 * (1 + n_lags)))
    structure = STRUCTURE.pack((np.ones(6), np.array([1.0, 0.0, 0.0])))
    dut.GetInputPort("structure").FixValue(context, structure)
    dut.GetInputPort("noise").FixValue(context, np.ones(6))
    return dut, context


@pytest.mark.parametrize("stepped", [False, True])
def test_topology(*, stepped: bool) -> None:
    dut, context = _disturbance(stepped=stepped, n_lags=2)
    assert inputs(dut) == {"jets": 21, "structure": 9, "noise": 6, "seed": 1}
    assert outputs(dut) == {"wrench": 21}
    assert feedthrough(dut) == {"wrench": {"jets", "structure", "seed", *(["noise"] if stepped else [])}}
    assert context.num_continuous_states() == 0
    assert not context.get_discrete_state(0).CopyToVector().any()


def test_a_stepped_body_gets_that_of_the_coming_sample_and_a_continuous_one_that_of_the_running_one() -> None:
    # 0.6 x 0.5 + 0.8 = 1.1, then 0.6 x 1.1 + 0.8 = 1.46; mean force 3 along z, at 1 ahead of the origin
    def added(deviation: float) -> np.ndarray:
        torque = np.array([1.0, 0.0, 0.0]) + deviation
        force = np.array([0.0, 0.0, 3.0]) + deviation
        return np.concatenate([torque + np.cross([1.0, 0.0, 0.0], force), force, [0.0]])

    jets = np.arange(7.0)
    stepped, context = _disturbance(stepped=True)
    np.testing.assert_allclose(stepped.GetOutputPort("wrench").Eval(context), jets + added(1.1), rtol=1e-14)
    advance(stepped, context)
    np.testing.assert_allclose(stepped.GetOutputPort("wrench").Eval(context), jets + added(1.46), rtol=1e-14)
    continuous, context = _disturbance(stepped=False)
    advance(continuous, context)  # the update at the sample, and then the sample runs
    np.testing.assert_allclose(continuous.GetOutputPort("wrench").Eval(context), jets + added(1.1), rtol=1e-14)


def test_it_starts_as_a_seed_draws() -> None:
    drawn = Disturbance(MODEL, period_s=PERIOD_S, stepped=False, seed=4)
    context = drawn.CreateDefaultContext()
    for name, value in (("jets", np.zeros(7)), ("structure", np.ones(9)), ("noise", np.zeros(6))):
        drawn.GetInputPort(name).FixValue(context, value)
    force = drawn.GetOutputPort("wrench").Eval(context)[3:6]
    np.testing.assert_array_equal(force, (MEAN + normal_sample(4, "disturbance before the start", 0, 6))[3:])
    drawn.parameters.set(context, std_force_x=0.0, mean_force_y=7.0)
    force = drawn.GetOutputPort("wrench").Eval(context)[3:6]
    assert force[0] == MEAN[3]
    drawn.GetInputPort("seed").FixValue(context, [0.5])
    assert drawn.GetOutputPort("wrench").Eval(context)[4] != force[1]


def test_what_dies_away_is_passed_on_as_it_is() -> None:
    dut, context = _disturbance(stepped=True, n_lags=2)
    np.testing.assert_array_equal(dut.GetOutputPort("wrench").Eval(context)[6:], np.arange(6.0, 21.0))


def _flown(*overrides: str) -> Any:
    return simulate(load_scenario("sample_maneuver", [*SHAKEN, *overrides]))


def test_a_stepped_and_a_continuous_body_are_pushed_alike() -> None:
    stepped, continuous = _flown(), _flown("plant.time_step=0", "duration_s=4")
    rows = len(continuous.time_s)
    # rates of 1e-3 rad/s; the integrator is asked for 1e-10 of that
    np.testing.assert_allclose(continuous["rate"], stepped["rate"][:rows], rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(continuous["truth"][:, :9], stepped["truth"][:rows, :9])


def test_it_is_the_seed_alone_that_chooses_it() -> None:
    first, again, other = _flown("duration_s=1"), _flown("duration_s=1"), _flown("duration_s=1", "seed=1")
    np.testing.assert_array_equal(first["rate"], again["rate"])
    assert np.abs(first["rate"] - other["rate"]).max() > 1e-6


def test_drifting_without_jets_it_gives_the_change_of_momentum_it_should() -> None:
    # a constant torque about the center of mass turns and does not push; force pushes and does not turn
    scenario = load_scenario(
        "sample_maneuver",
        ["maneuver=[]", "jet_schedule=[{jet: F1F, start_s: 9, end_s: 9.1}]", "duration_s=2",
         "plant.disturbance={torque: [100, 0, 0], force: [0, 10, 0]}"],
    )  # fmt: skip
    run = simulate(scenario)
    nominal = scenario.vehicle_data.nominal
    momentum = nominal.inertia @ run["rate"][-1]
    np.testing.assert_allclose(momentum, [200.0, 0.0, 0.0], rtol=0.0, atol=1e-2)  # turns by 2e-4 rad meanwhile
    np.testing.assert_allclose(
        run["velocity"][-1], [0.0, 20.0 / nominal.mass, 0.0], rtol=0.0, atol=1e-3 * 20.0 / nominal.mass
    )


def test_params_begin_with_a_draw_of_the_stated_size() -> None:
    scenario: Scenario = load_scenario("sample_maneuver", SHAKEN)
    model = true_params.disturbance(scenario)
    assert model is not None
    np.testing.assert_array_equal(model.mean, [50.0, 0.0, 20.0, 1.0, 2.0, 3.0])
    drawn = normal_sample(scenario.seed, "disturbance before the start", 0, 6)
    np.testing.assert_array_equal(model.before, np.array([100.0, 200.0, 50.0, 5.0, 5.0, 5.0]) * drawn)
    assert model.kept == pytest.approx(np.exp(-0.08 / 2.0))
    assert true_params.disturbance(load_scenario("sample_maneuver")) is None
