"""A disturbance: how large it is and how long it remembers, what it adds to which body, and for which sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from systems_probe import PERIOD_S, advance, feedthrough, give, inputs, output, outputs

from massprop_drake import load_scenario
from massprop_drake.inputs import true_params
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, decay_factor, next_deviation
from massprop_drake.systems import Disturbance

MEAN = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 3.0])
MODEL = DisturbanceModel(MEAN, np.ones(6), 0.6, np.full(6, 0.5))
SHAKEN = (
    "plant.disturbance={torque: [50, 0, 20], torque_std: [100, 200, 50], force: [1, 2, 3], force_std: [5, 5, 5], "
    "correlation_time_s: 2}"
)


def made(*, stepped: bool, **given: Any) -> tuple[Any, Any]:
    dut = Disturbance(MODEL, period_s=PERIOD_S, stepped=stepped, n_lags=2, **given)
    context = dut.CreateDefaultContext()
    give(dut, context, jets=np.arange(21.0), structure=[*np.ones(6), 1.0, 0.0, 0.0], noise=np.ones(6))
    return dut, context


@pytest.mark.parametrize("stepped", [False, True])
def test_topology(*, stepped: bool) -> None:
    dut, context = made(stepped=stepped)
    assert inputs(dut) == {"jets": 21, "structure": 9, "noise": 6, "seed": 1}
    assert outputs(dut) == {"wrench": 21}
    assert feedthrough(dut) == {"wrench": {"jets", "structure", "seed", *(["noise"] if stepped else [])}}
    assert context.num_continuous_states() == 0


def test_a_stepped_body_gets_that_of_the_coming_sample_and_a_continuous_one_that_of_the_running_one() -> None:
    # 0.6 x 0.5 + 0.8 = 1.1, then 0.6 x 1.1 + 0.8 = 1.46; mean force 3 along z, at 1 ahead of the origin
    def added(deviation: float) -> np.ndarray:
        torque, force = np.array([1.0, 0.0, 0.0]) + deviation, np.array([0.0, 0.0, 3.0]) + deviation
        return np.concatenate([torque + np.cross([1.0, 0.0, 0.0], force), force, np.zeros(15)])

    for stepped, deviations in ((True, (1.1, 1.46)), (False, (0.5, 1.1))):  # what dies away is passed on as it is
        dut, context = made(stepped=stepped)
        for deviation in deviations:
            assert_allclose(output(dut, context, "wrench"), np.arange(21.0) + added(deviation), rtol=1e-14)
            advance(dut, context)  # the update at the sample, and then the sample runs


def test_it_starts_as_a_seed_draws_with_the_parameters_of_the_context() -> None:
    dut, context = made(stepped=False, seed=4)
    drawn = MEAN + normal_sample(4, "disturbance before the start", 0, 6)
    assert_array_equal(output(dut, context, "wrench", jets=np.zeros(21))[3:6], drawn[3:])
    dut.parameters.set(context, std_force_x=0.0, mean_force_y=7.0)
    force = output(dut, context, "wrench")[3:6]
    assert_array_equal(force, [MEAN[3], drawn[4] + 7.0, drawn[5]])
    assert output(dut, context, "wrench", seed=[0.5])[4] != force[1]


def test_params_begin_with_a_draw_of_the_stated_size() -> None:
    scenario = load_scenario("sample_maneuver", [SHAKEN])
    model, drawn = true_params.disturbance(scenario), normal_sample(scenario.seed, "disturbance before the start", 0, 6)
    assert model is not None
    assert_array_equal(model.mean, [50.0, 0.0, 20.0, 1.0, 2.0, 3.0])
    assert_array_equal(model.before, np.array([100.0, 200.0, 50.0, 5.0, 5.0, 5.0]) * drawn)
    assert model.kept == pytest.approx(np.exp(-0.08 / 2.0))
    assert true_params.disturbance(load_scenario("sample_maneuver")) is None


def test_size_and_memory_over_a_long_time() -> None:
    assert decay_factor(100.0, 0.08) ** (100.0 / 0.08) == pytest.approx(np.exp(-1.0), rel=1e-12)
    rng, std, kept, n = np.random.default_rng(1), np.array([2.0, 0.0, 3.0, 1.0, 0.5, 4.0]), 0.9, 20_000
    model = DisturbanceModel(np.zeros(6), std, kept, np.zeros(6))
    deviation, values = std * rng.standard_normal(6), np.empty((n, 6))
    for row in range(n):
        values[row] = deviation = next_deviation(deviation, rng.standard_normal(6), model)
    # (1 + 0.9) / (1 - 0.9) = 19 samples count as one: 1000 independent ones, of which a sigma is known to 2 %
    assert_allclose(values.std(axis=0), std, rtol=0.08)
    for lag in (1, 5, 20):
        correlation = (values[lag:] * values[:-lag]).mean(axis=0)
        assert_allclose(correlation[std > 0.0] / std[std > 0.0] ** 2, kept**lag, rtol=0.0, atol=0.15)
